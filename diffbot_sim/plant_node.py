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
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from diffbot_control.ros.messages.fields import stamp_ns, twist_from
from diffbot_core.kinematics import Twist
from diffbot_core.ros.clock_watch import CLOCK_TOPIC
from diffbot_core.ros.node import DiffbotNode, run
from diffbot_core.ros.qos import SENSOR
from diffbot_core.units import NS_PER_S
from diffbot_sim.lockstep import LockStep
from diffbot_sim.ros.foreign_clock import ForeignClock
from diffbot_sim.ros.graph_plant import GraphPlant
from diffbot_sim.ros.pacing import LOCKSTEP, WALL, ClockPace
from diffbot_sim.ros.parameters import PlantNodeConfig

_POLL_PERIOD = 0.02
"""[s] between two polls of the lock-step"""
_STOP = Twist(0.0, 0.0)


class PlantNode(DiffbotNode[PlantNodeConfig]):
    """The simulated robot in the graph."""

    def __init__(self, **node_options: Any) -> None:
        """Create publishers, the command's subscription, the pace, and the services ~/reset and ~/pause."""
        super().__init__("plant", PlantNodeConfig, **node_options)
        config = self.config
        self.paused = config.start_paused
        self._command, self._command_step = _STOP, 0
        self._started = False
        start = round(config.start_time * NS_PER_S) or time.time_ns()
        self._plant = GraphPlant(self, start, self._subscribe_to_commands())
        self.publisher_watch.watch("cmd_vel", "drive the robot", config.commands.max_cmd_vel_publishers)
        self._warn_of_idle_rates()
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/pause", self._on_pause)
        factor = 1.0 if config.clock == WALL else config.real_time_factor
        period = config.world.plant.sampling_time / factor
        self._pace = ClockPace(period, self._now(), skips=config.clock != WALL)
        self._lockstep = LockStep(self._plant, paused=self.paused) if config.clock == LOCKSTEP else None
        self._foreign_clock = ForeignClock(self._plant.world.period) if config.follows_time() else None
        if self._foreign_clock is not None:
            self.subscribe(Clock, CLOCK_TOPIC, self._on_clock, SENSOR)
        elif self._lockstep is not None:
            self.create_timer(config.lockstep_timeout, self._lockstep.on_stall_check, clock=self.steady_clock)
            self._plant.poll = self.create_timer(_POLL_PERIOD, self._lockstep.on_poll, clock=self.steady_clock)
        else:
            self.create_timer(period, self._on_clock_tick, clock=self.steady_clock)

    def on_config(self, config: PlantNodeConfig) -> None:
        """Take over changed noise, faults and rates; a changed start counts from the next reset."""
        self._plant.world.configure(config.simulated())
        self._warn_of_idle_rates()

    def halt(self) -> None:
        """Stand still until the next command."""
        self._command = _STOP

    def _warn_of_idle_rates(self) -> None:
        """Warn of a sensor that has a rate, but nothing to measure."""
        world = self.config.world
        if world.sensors.landmark_rate > 0.0 and not world.landmarks.landmark_ids:
            rate = world.sensors.landmark_rate
            self.get_logger().warning(f"landmark_rate = {rate:g} Hz, but landmark_ids is empty: no landmarks are sent")

    def health_level(self) -> tuple[int, str]:
        """Add the pace to /diagnostics."""
        level, text = super().health_level()
        skipped = self._pace.skipped + (self._foreign_clock.skipped if self._foreign_clock else 0)
        self.health.notes = {
            "steps": str(self._plant.step),
            "steps skipped": str(skipped),
            "steps sent again": str(self._lockstep.repeats if self._lockstep else 0),
        }
        return level, f"{'paused' if self.paused else 'running'}; {text}"

    def _now(self) -> float:
        return float(self.steady_clock.now().nanoseconds / NS_PER_S)

    def _subscribe_to_commands(self) -> Any:
        qos = QoSProfile(depth=1)
        if self.config.enable_stamped_cmd_vel:
            return self.subscribe(TwistStamped, "cmd_vel", lambda message: self._on_command(message.twist), qos)
        return self.subscribe(TwistMessage, "cmd_vel", self._on_command, qos)

    def _on_command(self, message: TwistMessage) -> None:
        command = twist_from(message)
        if self._lockstep is not None:
            self._lockstep.on_command(command)
        else:
            self._command, self._command_step = command, self._plant.step

    def _on_clock_tick(self) -> None:
        if self.paused:
            return
        if not self._started:
            self._started = True
            self._catch_up_with_wall_time()
            self._pace.restart(self._now())
            self._plant.publish()
        self._take_steps(self._pace.due(self._now()))

    def _take_steps(self, count: int) -> None:
        for _ in range(count):
            config = self.config.world.plant
            silence = (self._plant.step - self._command_step) * config.sampling_time
            self._plant.advance(self._command if silence < config.cmd_vel_timeout else _STOP)
            self._plant.publish()

    def _on_clock(self, message: Clock) -> None:
        """Take the steps that are due by the clock of another plant."""
        if self._foreign_clock is None or self.paused:
            return
        stamp = stamp_ns(message.clock)
        due = self._foreign_clock.on_clock(stamp)
        if due is None:
            self._plant.world.start_stamp += stamp - self._plant.world.stamp
            self._plant.publish()
        else:
            self._take_steps(due)

    def _catch_up_with_wall_time(self) -> None:
        """Stamp the present step with the time of day after a pause; simulated time stands still in one."""
        if self.config.clock == WALL and self.config.start_time == 0.0:
            self._plant.world.start_stamp += time.time_ns() - self._plant.world.stamp

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._plant.reset()
        self._command, self._command_step = _STOP, 0
        self.health.reset()
        if self._foreign_clock is not None:
            self._foreign_clock.restart()
        if self._lockstep is not None:
            self._lockstep.reset()
        response.success, response.message = True, "back at the start pose, noise from its first number on"
        return response

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        resumed = self.paused and not request.data
        self.paused = request.data
        response.success, response.message = True, "paused" if self.paused else "running"
        if resumed:
            self._pace.restart(self._now())
            if self._foreign_clock is not None:
                self._foreign_clock.restart()
            if self._started:
                self._catch_up_with_wall_time()
        if self._lockstep is not None:
            self._lockstep.set_paused(self.paused)
        return response


def main(args: list[str] | None = None) -> int:
    """Run the node; the exit status of the process."""
    return run(PlantNode, args, shared_memory=False)
