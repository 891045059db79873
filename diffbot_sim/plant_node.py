"""The node ``plant``: cmd_vel -> odom, joint_states, sensors, ground_truth, and the simulation's clock."""

from __future__ import annotations

if __name__ == "__main__":  # before the imports that take long: see launcher
    from diffbot_core.launcher import launch

    raise SystemExit(launch("diffbot_sim.plant_node"))

import time
from typing import Any

from geometry_msgs.msg import Twist as TwistMessage
from geometry_msgs.msg import TwistStamped
from rclpy.qos import QoSProfile
from std_srvs.srv import SetBool, Trigger

from diffbot_control.ros.messages import twist_from
from diffbot_core.kinematics import Twist
from diffbot_core.ros.node import DiffbotNode, run
from diffbot_core.units import NS_PER_S
from diffbot_sim.model.simulator import Arrivals, World
from diffbot_sim.ros.pacing import LOCKSTEP, WALL, ClockPace, LockStep
from diffbot_sim.ros.parameters import PlantNodeConfig
from diffbot_sim.ros.publishers import PlantTopics

_POLL = 0.02
"""[s] between two looks at the graph before the first lock-step, and between two questions of a step in doubt."""
_KNOWN_POLLS = 10
"""Polls in a row that find the same neighbours: what one side of a connection knows the other learns later."""
_FIRST_STEPS, _STEPS_A_POLL = 1000, 5
"""Steps for which a first fix is waited for that is late or lost, and so many of them a poll."""
_SILENT = ("headings", "landmarks")
"""Arrivals whose first message may be missed by the filter unnoticed; without the first fix it gives no answer."""


class PlantNode(DiffbotNode[PlantNodeConfig]):
    """The simulated robot in the graph."""

    def __init__(self, **node_options: Any) -> None:
        """Create publishers, the command's subscription, the pace, and the services ~/reset and ~/pause."""
        super().__init__("plant", PlantNodeConfig, **node_options)
        config = self.config
        start = round(config.start_time * NS_PER_S) or time.time_ns()
        self.world = World(config.world, start)
        self.paused = config.start_paused
        self._topics = PlantTopics(self)
        self._command = Twist(0.0, 0.0)
        self._command_step = 0
        self._arrivals: Arrivals | None = None
        command_type, heard = (
            (TwistStamped, lambda message: self._on_command(message.twist))
            if config.enable_stamped_cmd_vel
            else (TwistMessage, self._on_command)
        )
        self._commands = self.subscribe(command_type, "cmd_vel", heard, QoSProfile(depth=1))
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/pause", self._on_pause)
        self._sent_first = False
        self._neighbours: list[int] = []
        self._known_polls = 0
        self._sent_once: set[str] = set()
        self._progress = 0
        self._lockstep = LockStep()
        factor = 1.0 if config.clock == WALL else config.real_time_factor
        period = config.world.plant.sampling_time / factor
        self._pace = ClockPace(period, self._now())
        if config.clock == LOCKSTEP:
            self.create_timer(config.lockstep_timeout, self._on_stall_check, clock=self.steady_clock)
            self._poll = self.create_timer(_POLL, self._on_poll, clock=self.steady_clock)
        else:
            self.create_timer(period, self._on_clock_tick, clock=self.steady_clock)

    def on_config(self, config: PlantNodeConfig) -> None:
        """Take over changed noise, faults and rates; a changed start counts from the next reset."""
        self.world.configure(config.world)

    def health_level(self) -> tuple[int, str]:
        """Add the pace to /diagnostics."""
        level, text = super().health_level()
        self.health.notes = {
            "steps": str(self.world.state.step),
            "steps skipped": str(self._pace.skipped),
            "steps sent again": str(self._lockstep.repeats),
        }
        return level, f"{'paused' if self.paused else 'running'}; {text}"

    def _now(self) -> float:
        return float(self.steady_clock.now().nanoseconds / NS_PER_S)

    def _on_command(self, message: TwistMessage) -> None:
        self._command = twist_from(message)
        self._command_step = self.world.state.step
        if self.config.clock == LOCKSTEP:
            self._progress += 1
            self._lockstep.answer()
            self._lock_step_if_sure()

    def _on_poll(self) -> None:
        """Look for the filter before the first step; later ask a step in doubt again."""
        if not self._sent_first:
            self._count_known_polls()
        if self.paused:
            return
        if not self._sent_first:
            self._wait_for_first_step()
        elif self._lockstep.complete:
            if self._lockstep.ask_once_more():
                self._ask()
            else:
                self._poll.cancel()
                self._lock_step()

    def _fixes_wanted(self) -> bool:
        return self.config.world.sensors.fix_rate > 0.0

    def _count_known_polls(self) -> None:
        before = self._neighbours
        self._neighbours = [*self._topics.filters(), self._commands.get_publisher_count()]
        found = all(sender.get_subscription_count() for sender in self._topics.first_heard(self._fixes_wanted()))
        self._known_polls = self._known_polls + 1 if found and self._neighbours == before else 0

    def _wait_for_first_step(self) -> None:
        """Take it once the filter hears and has a fix to begin with: a lost one would make another run of this one.

        While the first fix is late or lost only time passes. The filter gets no odometry: it has no pose to answer
        with, and heard after the fix the answer would be taken for that to another step.
        """
        if self._known_polls < _KNOWN_POLLS:
            topics = " and ".join(publisher.topic_name for publisher in self._topics.first_heard(self._fixes_wanted()))
            self.get_logger().info(f"waiting for a filter on {topics}", throttle_duration_sec=5.0)
            return
        for _ in range(_STEPS_A_POLL):
            no_fix = self._fixes_wanted() and not self._sense().fixes
            if no_fix and self.world.state.step < _FIRST_STEPS:
                self._topics.publish_truth(self.world)
                self._advance(Twist(0.0, 0.0))
                continue
            if no_fix:
                self.get_logger().error(
                    f"no fix in the first {_FIRST_STEPS} steps (see fix_delay and fix_dropout):"
                    " the filter cannot answer before it has one, or an initialpose"
                )
            self._poll.cancel()
            self._sent_first = True
            self._begin_step()
            return

    def _on_stall_check(self) -> None:
        moved, self._progress = self._progress, 0
        if moved or self.paused or not self._sent_first:
            return
        if self._lockstep.stalled():
            self._lock_step_if_sure()
            return
        self.get_logger().warning(
            "no command on cmd_vel: the step's messages are sent again (is the controller's publish_when_idle set?)",
            throttle_duration_sec=10.0,
        )
        self._poll.reset()
        self._ask()
        self._progress = 0

    def _ask(self) -> None:
        self._progress += 1
        self._lockstep.ask()
        self._topics.publish(self.world, self._sense())

    def _lock_step_if_sure(self) -> None:
        """Go on if the step is answered; one in doubt is left to the polls."""
        if self._lockstep.complete and not self._lockstep.doubts and not self.paused:
            self._lock_step()

    def _lock_step(self) -> None:
        self._advance(self._command)
        self._begin_step()

    def _begin_step(self) -> None:
        self._lockstep.next_step()
        arrivals = self._sense()
        news = {name for name in _SILENT if getattr(arrivals, name)} - self._sent_once
        if news:
            self._sent_once |= news
            self._lockstep.doubt()
            self._poll.reset()
        self._ask()

    def _advance(self, command: Twist) -> None:
        self.world.advance(command)
        self._arrivals = None

    def _sense(self) -> Arrivals:
        """Measurements of the present step: the same ones whenever its messages are sent again."""
        if self._arrivals is None:
            self._arrivals = self.world.sense()
        return self._arrivals

    def _on_clock_tick(self) -> None:
        if self.paused:
            return
        if not self._sent_first:
            self._sent_first = True
            self._catch_up_with_the_wall()
            self._pace.restart(self._now())
            self._topics.publish(self.world, self._sense())
        for _ in range(self._pace.due(self._now())):
            plant = self.config.world.plant
            silence = (self.world.state.step - self._command_step) * plant.sampling_time
            self._advance(self._command if silence < plant.cmd_vel_timeout else Twist(0.0, 0.0))
            self._topics.publish(self.world, self._sense())

    def _catch_up_with_the_wall(self) -> None:
        """Let the present step be now, after a time in which nothing moved; simulated time stands still in a pause."""
        if self.config.clock == WALL and self.config.start_time == 0.0:
            self.world.start_stamp += time.time_ns() - self.world.stamp

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        # Time goes on: messages stamped in the past would upset everyone who listens.
        self.world = World(self.config.world, self.world.stamp + self.world.period)
        self._command, self._command_step = Twist(0.0, 0.0), 0
        self._arrivals = None
        response.success, response.message = (
            True,
            "back at the start pose, noise from its first number on",
        )
        if self.config.clock == LOCKSTEP:
            self._lockstep.next_step()
            # What was asked before is answered while the polls count anew.
            self._sent_first, self._known_polls = False, 0
            self._sent_once.clear()
            self._poll.reset()
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        resumed = self.paused and not request.data
        self.paused = request.data
        response.success, response.message = True, "paused" if self.paused else "running"
        if resumed:
            self._pace.restart(self._now())
            if self._sent_first:
                self._catch_up_with_the_wall()
            self._lock_step_if_sure()
        return response


def main(args: list[str] | None = None) -> int:
    """Run the node; the exit status of the process."""
    return run(PlantNode, args)
