"""The node ``plant``: simulates a robot that receives cmd_vel and sends odom, sensors, ground_truth and the clock."""

from __future__ import annotations

import math
import time
from typing import Any

from geometry_msgs.msg import Twist as TwistMessage
from geometry_msgs.msg import TwistStamped
from rclpy.qos import QoSProfile
from std_srvs.srv import SetBool, Trigger

from diffbot_control.ros.messages.fields import stamp_ns, twist_from
from diffbot_core.endpoints import AUTO, TWIST_STAMPED, TYPE_WORDS
from diffbot_core.errors import InvalidValueError
from diffbot_core.kinematics import STOP, Twist
from diffbot_core.ros.node import DiffbotNode
from diffbot_core.ros.run import run
from diffbot_core.stamps import NS_PER_S
from diffbot_sim.lockstep import MAX_STEPS_WITHOUT_FIX, NO_COMMAND, NO_FILTER, NO_FIX, LockStep
from diffbot_sim.parameters import LOCKSTEP, WALL, PlantNodeConfig
from diffbot_sim.topics import PlantTopics
from diffbot_sim.world import Arrivals, World

_POLL_PERIOD, _STALL_PERIOD = 0.02, 1.0
"""[s] periods of the timers of the lock-step: polls before the first step, and checks for a missing answer"""
_MAX_STEPS_AT_ONCE = 5
"""Largest number of steps in one call of a late timer. Clock ``wall`` makes the remaining steps in the next calls,
clock ``scaled`` skips them."""
_EARLY = 0.1
"""Share of the period by which a timer may fire early. Otherwise jitter would postpone a step by a whole period."""


class PlantNode(DiffbotNode[PlantNodeConfig]):
    """The simulated robot as a ROS node. It implements :class:`diffbot_sim.lockstep.Plant`."""

    def __init__(self, **node_options: Any) -> None:
        """Create publishers, subscription, services ~/reset and ~/pause, and the timers.

        Raises:
            InvalidValueError: if a parameter is not allowed, or for lock-step with commands of type Twist.
        """
        super().__init__("plant", PlantNodeConfig, **node_options)
        config = self.config
        word, stamped = config.cmd_vel_type, TYPE_WORDS[TWIST_STAMPED]
        if config.clock == LOCKSTEP and word not in (AUTO, stamped):
            self.destroy_node()
            text = (
                f"{stamped} or {AUTO} with clock: lockstep, since a command names the pose that it answers by its stamp"
            )
            raise InvalidValueError("cmd_vel_type", word, text)
        self.paused, self._started = config.start_paused, False
        self._command, self._command_step, self._skipped = STOP, 0, 0
        self.world = World(config.world, round(config.start_time * NS_PER_S) or time.time_ns())
        self._arrivals: Arrivals | None = None
        self._topics = PlantTopics(self)
        self._is_stamped = word == stamped or (word == AUTO and config.clock == LOCKSTEP)
        kind = TwistStamped if self._is_stamped else TwistMessage
        try:
            self._commands = self.subscribe(kind, "cmd_vel", self._on_command, QoSProfile(depth=1))
        except RuntimeError:  # all endpoints of a topic in one process must have the same type
            self.destroy_node()
            text = "the type that the controller in the same process publishes; set the same cmd_vel_type in both nodes"
            raise InvalidValueError("cmd_vel_type", word, text) from None
        self.publisher_watch.watch("cmd_vel", "drive the robot", config.commands.max_cmd_vel_publishers)
        self._warn_of_idle_rates()
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self._lockstep = LockStep(self, paused=self.paused) if config.clock == LOCKSTEP else None
        factor = 1.0 if config.clock == WALL else config.real_time_factor
        self._period = config.world.plant.sampling_time / factor
        self._next_step = self._now() + self._period
        if self._lockstep is not None:
            self.create_timer(_STALL_PERIOD, self._lockstep.on_stall_check, clock=self.steady_clock)
            self._poll = self.create_timer(_POLL_PERIOD, self._on_poll, clock=self.steady_clock)
        else:
            self.create_timer(self._period, self._on_clock_tick, clock=self.steady_clock)

    def on_config(self, config: PlantNodeConfig) -> None:
        """Apply changed noise, faults and rates. A changed start pose applies at the next reset."""
        self.world.configure(config.world)
        self._warn_of_idle_rates()

    def halt(self) -> None:
        """Stop until the next command."""
        self._command = STOP

    def _warn_of_idle_rates(self) -> None:
        """Warn if landmark_rate is set for a map without landmarks."""
        world = self.config.world
        if world.sensors.landmark_rate > 0.0 and not world.landmarks.landmark_ids:
            rate = world.sensors.landmark_rate
            self.get_logger().warning(f"landmark_rate = {rate:g} Hz, but landmark_ids is empty: no landmarks are sent")

    def health_level(self) -> tuple[int, str]:
        """Add paused or running to the status in /diagnostics."""
        level, text = super().health_level()
        return level, f"{'paused' if self.paused else 'running'}; {text}"

    def details(self) -> dict[str, str]:
        """Add the numbers of steps to /diagnostics."""
        return {
            "steps": str(self.step),
            "steps skipped": str(self._skipped),
            "steps without an answer": str(self._lockstep.unanswered if self._lockstep else 0),
        }

    @property
    def step(self) -> int:
        """Return the number of the present step."""
        return self.world.state.step

    @property
    def stamp(self) -> int:
        """Return the time [ns] of the present step."""
        return self.world.stamp

    def advance(self, command: Twist) -> None:
        """Hold ``command`` for one step."""
        self.world.advance(command)
        self._arrivals = None

    def publish(self) -> None:
        """Send all messages of the present step."""
        self._topics.publish(self.world, self._sense())

    def publish_truth(self) -> None:
        """Send time and true state of the present step."""
        self._topics.publish_truth(self.world)

    def awaits_first_fix(self) -> bool:
        """Return True if the plant sends fixes, but no fix arrives at the present step."""
        return self._has_fixes() and not self._sense().fixes

    def connections(self) -> tuple[int, ...] | None:
        """Return the number of connections of each topic; None until a filter is connected to all topics it needs."""
        if not all(one.get_subscription_count() for one in self._topics.required(self._has_fixes())):
            return None
        return (*self._topics.subscription_counts(), self._commands.get_publisher_count())

    def _on_poll(self) -> None:
        if self._lockstep is not None:
            self._lockstep.on_poll()
            if self._lockstep.is_started:
                self._poll.cancel()

    def report(self, event: str) -> None:
        """Log an event of the lock-step."""
        logger: Any = self.get_logger()
        if event == NO_FILTER:
            topics = " and ".join(publisher.topic_name for publisher in self._topics.required(self._has_fixes()))
            logger.info(f"waiting until a filter subscribes to {topics}", throttle_duration_sec=5.0)
        elif event == NO_FIX:
            logger.error(
                f"no fix arrived in the first {MAX_STEPS_WITHOUT_FIX} steps (see fix_delay and fix_dropout);"
                " the filter cannot answer before it has a fix or an initialpose"
            )
        elif event == NO_COMMAND:
            logger.warning(
                "no answer on cmd_vel: moving on with zero command; check that the controller has cmd_vel_type"
                " twist_stamped and publish_when_idle true, and that the filter has a pose",
                throttle_duration_sec=10.0,
            )

    def _has_fixes(self) -> bool:
        return self.config.world.sensors.fix_rate > 0.0

    def _sense(self) -> Arrivals:
        """Return the measurements of the present step."""
        if self._arrivals is None:
            self._arrivals = self.world.sense()
        return self._arrivals

    def _now(self) -> float:
        return float(self.steady_clock.now().nanoseconds / NS_PER_S)

    def _on_command(self, message: Any) -> None:
        command = twist_from(message.twist if self._is_stamped else message)
        if self._lockstep is not None:
            self._lockstep.on_command(command, stamp_ns(message.header.stamp))
        else:
            self._command, self._command_step = command, self.step

    def _on_clock_tick(self) -> None:
        if self.paused:
            return
        if not self._started:
            self._started = True
            self._catch_up_with_wall_time()
            self._next_step = self._now() + self._period
            self.publish()
        due = max(math.floor((self._now() - self._next_step) / self._period + _EARLY) + 1, 0)
        count = min(due, _MAX_STEPS_AT_ONCE)
        if self.config.clock != WALL:
            self._skipped += due - count
            self._next_step += (due - count) * self._period
        self._next_step += count * self._period
        for _ in range(count):
            plant = self.config.world.plant
            silence = (self.step - self._command_step) * plant.sampling_time
            self.advance(self._command if silence < plant.cmd_vel_timeout else STOP)
            self.publish()

    def _catch_up_with_wall_time(self) -> None:
        """With clock ``wall``, set the stamp of the present step to the present time, since stamps stop in a pause."""
        if self.config.clock == WALL and self.config.start_time == 0.0:
            self.world.start_stamp += time.time_ns() - self.world.stamp

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        # The clock is not reset, since nodes do not expect time to jump backwards.
        self.world = World(self.config.world, self.world.stamp + self.world.period)
        self._arrivals = None
        self._command, self._command_step, self._skipped = STOP, 0, 0
        self.health.reset()
        if self._lockstep is not None:
            self._lockstep.reset()
            self._poll.reset()
        response.success, response.message = True, "the robot is at its start pose, and the noise starts again"
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        resumed = self.paused and not request.data
        self.paused = request.data
        response.success, response.message = True, "paused" if self.paused else "running"
        if resumed:
            self._next_step = self._now() + self._period
            if self._started:
                self._catch_up_with_wall_time()
        if self._lockstep is not None:
            self._lockstep.set_paused(self.paused)
        return response


def main(args: list[str] | None = None) -> int:
    """Run the node; return the exit status of the process."""
    return run(PlantNode, args, shared_memory=False)


if __name__ == "__main__":
    raise SystemExit(main())
