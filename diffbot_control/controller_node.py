"""The node ``controller``: it turns poses and a goal or path into cmd_vel."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool

from diffbot_control.goals.record import CANCELLED, NOT_REACHED
from diffbot_control.goals.states import STALE, WAITING, WITH_GOAL
from diffbot_control.goals.supervisor import Supervisor
from diffbot_control.law.law import CONTACT, CONTACT_UNKNOWN, NO_CONTACT
from diffbot_control.law.registry import resolve_law
from diffbot_control.ros.controller_publishers import BEYOND_LIMITS, LEVELS, STATE_LOG_PERIOD, ControllerPublishers
from diffbot_control.ros.goals.actions import ActionServers, Nav2Actions, serve
from diffbot_control.ros.goals.server import GoalServer
from diffbot_control.ros.messages.fields import pose_from
from diffbot_control.ros.parameters.controller import ControllerNodeConfig, parameter_set_of
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import STOP
from diffbot_core.ros.graph import publisher_names
from diffbot_core.ros.managed_node import ManagedNode
from diffbot_core.ros.qos import LATCHED, sensor_qos
from diffbot_core.ros.run import run
from diffbot_core.shared_parameters import robot_frame
from diffbot_core.stamps import NS_PER_S
from diffbot_core.uncertainty import Uncertainty

_STATUS_PERIOD = 0.5
_HAS_POWER = {
    BatteryState.POWER_SUPPLY_STATUS_CHARGING: True,
    BatteryState.POWER_SUPPLY_STATUS_FULL: True,
    BatteryState.POWER_SUPPLY_STATUS_DISCHARGING: False,
    BatteryState.POWER_SUPPLY_STATUS_NOT_CHARGING: False,
}
"""True if a charger supplies the robot in this state of the battery. The other states say nothing about a charger."""
_MIN_TICK_PERIOD, _MAX_TICK_PERIOD = 1e-3, 0.05
"""[s] bounds of the period of the timer that checks for missing poses and waiting goals"""
_RECENT = 2.0
"""[s] If poses have arrived within this time, but none of them could be used, their stamps are wrong."""


class PosePublisherWatch:
    """Finds out why poses are missing or unusable, from the ROS graph and ~/status of the publishing node."""

    def __init__(self, node: ControllerNode, topic: str) -> None:
        """Store the controller, and the topic of the pose before remapping."""
        self._node, self._topic = node, topic
        self._name = self._status = self._fault = ""
        """name of the publishing node, its newest status, and the fault of its inputs while it publishes poses"""
        self._subscription: Any = None

    def problem(self) -> str:
        """Return why poses are missing or unusable. Call this twice a second while the controller waits for a pose."""
        if text := self._node.input_problem(self._topic):
            return text
        topic, before = self._node.resolve_topic_name(self._topic), self._name
        if not self._follow(topic):
            return f"nothing publishes {topic}: start its source, or remap {topic}"
        if self._name != before:
            return ""  # the latched status arrives before the next call
        if time.monotonic() - self._node.health.last_received.get(self._topic, 0.0) <= _RECENT:
            return f"poses arrive on {topic}, but late or without advancing stamps: compare the clocks"
        return f"{self._name}: {self._status}" if self._status else f"{self._name} publishes nothing on {topic}"

    def fault(self) -> str:
        """Return the fault of its inputs that the publishing node reports although it publishes poses; empty for none.

        Call this twice a second while the robot drives.
        """
        is_published = self._follow(self._node.resolve_topic_name(self._topic))
        return f"{self._name}: {self._fault}" if is_published and self._fault else ""

    def _follow(self, topic: str) -> bool:
        """Subscribe to the status of the node that publishes ``topic``; return False if no node publishes it."""
        # With several publishers, DDS may report them in another order at each call.
        name = min((name for name in publisher_names(self._node, topic) if name.startswith("/")), default="")
        if name and name != self._name:
            if self._subscription is not None:
                self._node.destroy_subscription(self._subscription)
            self._name, self._status, self._fault, status = name, "", "", f"{name}/status"
            self._subscription = self._node.create_subscription(DiagnosticStatus, status, self._on_status, LATCHED)
        return bool(name)

    def _on_status(self, message: DiagnosticStatus) -> None:
        if message.name == self._name:
            reason = next((pair.value for pair in message.values if pair.key == "reason"), "")
            self._status = ": ".join(filter(None, (message.message, reason)))
            self._fault = reason if message.level == DiagnosticStatus.WARN else ""


class ControllerNode(ManagedNode[ControllerNodeConfig]):
    """Answers every pose with one command while the robot drives to a goal or holds its goal."""

    moves_the_robot = True
    actions: type[ActionServers] = Nav2Actions
    """class of the action servers"""

    def __init__(self, **node_options: Any) -> None:
        """Create the node; it is active afterwards if the parameter ``autostart`` is true."""
        super().__init__("controller", ControllerNodeConfig, **node_options)

    def configure(self) -> None:
        """Create publishers, subscriptions, services and the timers for missing poses and the status."""
        config = self.config
        self.supervisor = Supervisor(config.supervisor, resolve_law(config.law))
        self._robot_frame = robot_frame(config)
        self.outputs = ControllerPublishers(self)
        self.goals = GoalServer(self)
        self._switch: bool | None = None
        self._has_power = False
        """newest state of the contact switch, None before the first message; True if a charger supplies the robot"""
        self.subscribe(Bool, "dock_contact", self._on_switch)
        self.subscribe(BatteryState, "battery_state", self._on_battery, sensor_qos(config.reliable_inputs))
        self._pose_topic = "pose" if config.pose_source == "pose" else "odometry/filtered"
        self._receive_poses(self._pose_topic)
        self._pose_publisher = PosePublisherWatch(self, self._pose_topic)
        self.publisher_watch.watch("cmd_vel", "drive the robot", config.commands.max_cmd_vel_publishers)
        self.publisher_watch.watch(self._pose_topic, "estimate the pose")
        self._tick_timer = self.create_timer(self._tick_period(), self._on_tick, clock=self.steady_clock)
        self.create_timer(_STATUS_PERIOD, self._on_status_tick, clock=self.steady_clock)
        # Last, because only cleanup() destroys the servers.
        self._actions = serve(self.actions, self)

    def activate(self) -> None:
        """Start without a goal."""
        self._reset()
        # Subscribers use this message to tell old goals from new ones.
        self.goals.publish_changes(force=True)
        self.outputs.publish_status(self.supervisor)

    def _reset(self) -> None:
        """Replace the supervisor by a new one, which keeps the records of the goals and the contact."""
        before, self.supervisor = self.supervisor, Supervisor(self.config.supervisor, self.supervisor.law)
        # The ends of earlier goals may not be published yet, and a switch may report only changes.
        self.supervisor.goals, self.supervisor.contact = before.goals, before.contact

    def deactivate(self) -> None:
        """Stop the robot, cancel the goal and stop publishing cmd_vel."""
        self.outputs.commands.deliver(STOP)  # first, because the rest may fail
        reason = "by the deactivation of the controller"
        self.goals.drop_waiting(CANCELLED, reason)
        self.supervisor.on_stop(reason)
        self.outputs.publish_status(self.supervisor)
        self.goals.publish_changes()

    def halt(self) -> None:
        """Stop the robot after an error, and end the goal as not reached; the robot rests until the next goal."""
        if not self.is_active:
            return
        self.outputs.commands.send(STOP)  # first, because the rest may fail
        reason, supervisor = self.faults.newest, self.supervisor
        had_goal = supervisor.state in WITH_GOAL or supervisor.goals.present is not None
        had_goal = self.goals.drop_waiting(NOT_REACHED, reason) or had_goal
        supervisor.goals.close(NOT_REACHED, reason, supervisor.elapsed)
        # After the error, the supervisor may be in an inconsistent state.
        self._reset()
        if had_goal:
            self.supervisor.on_fault(reason)
        self.outputs.publish_status(self.supervisor)
        self.goals.publish_changes(force=True)

    def cleanup(self) -> None:
        """Destroy the action servers."""
        if self._actions is not None:
            self._actions.destroy()

    def _receive_poses(self, topic: str) -> None:
        """Subscribe to the topic of the pose."""
        qos = sensor_qos(self.config.reliable_inputs)
        self.subscribe(PoseWithCovarianceStamped if topic == "pose" else Odometry, topic, self._on_pose, qos)

    def parameter_set(
        self, config_type: type[ControllerNodeConfig], overrides: Mapping[str, Any]
    ) -> tuple[type[ControllerNodeConfig], Mapping[str, ControllerNodeConfig] | None]:
        """Return the parameters of the node, with the parameters of the law that the overrides select."""
        return parameter_set_of(overrides)

    def on_config(self, config: ControllerNodeConfig) -> None:
        """Use changed parameters from the next pose on."""
        self.supervisor.config = config.supervisor
        self._tick_timer.timer_period_ns = int(self._tick_period() * NS_PER_S)

    def health_level(self) -> tuple[int, str]:
        """Return level and text for /diagnostics; the text begins with the state of the controller."""
        level, text = super().health_level()
        problem = (self._clock_problem() or self.supervisor.problem) if self.is_configured else ""
        text = text if problem in text else f"{problem}; {text}"
        level = max(level, DiagnosticStatus.WARN[0] if problem else 0, LEVELS.get(self.supervisor.status, 0))
        return level, f"{self.supervisor.status}; {text}"

    def _tick_period(self) -> float:
        # The end of pose_timeout, or a clock that stands still, is detected up to one period late.
        return min(max(0.125 * self.config.supervisor.pose_timeout, _MIN_TICK_PERIOD), _MAX_TICK_PERIOD)

    def _clock_problem(self) -> str:
        """Return why the clock is unreliable; empty if the robot may drive."""
        clock, supervisor = self.clock_watch, self.config.supervisor
        if clock.is_unreliable:
            return clock.problem or "time on /clock jumped back"
        # In lock-step the plant waits for the command, and time stands still until the command arrives.
        stands = not supervisor.publish_when_idle and clock.standstill() > supervisor.pose_timeout
        return (clock.problem or "time on /clock stands still") if stands else ""

    def _on_switch(self, message: Bool) -> None:
        self._switch = message.data
        self._set_contact()

    def _on_battery(self, message: BatteryState) -> None:
        self._has_power = _HAS_POWER.get(message.power_supply_status, self._has_power)
        self._set_contact()

    def _set_contact(self) -> None:
        """Set the contact for the law.

        A closed switch means contact even if the battery does not charge, because a charger may pause.
        """
        if self._switch or self._has_power:
            self.supervisor.contact = CONTACT
        else:
            self.supervisor.contact = CONTACT_UNKNOWN if self._switch is None else NO_CONTACT

    def _on_pose(self, message: PoseWithCovarianceStamped | Odometry) -> None:
        stamp, pose, uncertainty = pose_from(message, self.config.map_frame, self._robot_frame)
        self._answer(stamp, pose, self._fallback() if uncertainty is None else uncertainty)

    def take_pose(self, stamp: int, pose: Pose, uncertainty: Uncertainty) -> None:
        """Handle an estimate of an ekf in the same process as if it had arrived in a message.

        Args:
            stamp: [ns] time to which the pose belongs.
            pose: pose in ``map_frame``.
            uncertainty: uncertainty of the pose.
        """
        if self._answer(stamp, pose, uncertainty):
            self.health.accept(self._pose_topic, time.monotonic())

    def _answer(self, stamp: int, pose: Pose, uncertainty: Uncertainty) -> bool:
        """Answer a pose with a command; return True if the stamp of the pose advanced."""
        if not self.is_active:
            return True
        supervisor = self.supervisor
        self.goals.take_waiting()
        supervisor.clock.is_simulated = self.clock_watch.is_simulated
        if self._clock_problem():
            self._on_tick()
            return True
        command = supervisor.on_pose(stamp, self.clock_watch.now(), pose, uncertainty, time.monotonic())
        if not supervisor.clock.advances:
            self.health.counted[f"{self._pose_topic} without a later stamp"] += 1
        if command is not None:
            self.outputs.commands.send(command, stamp)
            if command != STOP and not self.outputs.commands.is_open:
                supervisor.stop_at_once()
            if supervisor.is_beyond_limits:
                self.health.counted["commands beyond lowered limits"] += 1
                self.get_logger().warning(BEYOND_LIMITS, throttle_duration_sec=STATE_LOG_PERIOD)
        self.outputs.publish_navigation(stamp, supervisor)
        self._publish_changes()
        return supervisor.clock.advances

    def _fallback(self) -> Uncertainty:
        """Return the uncertainty for a pose without covariance; count the pose, and log the first one."""
        note = f"{self._pose_topic} with the covariance of the parameters"
        self.health.counted[note] += 1
        fallback = self.config.pose_fallback
        if self.health.counted[note] == 1:
            self.get_logger().warning(
                f"{self._pose_topic}: covariance is all zero, i.e. unknown: assuming pose_sigma_xy = "
                f"{fallback.pose_sigma_xy:g} m, pose_sigma_yaw = {fallback.pose_sigma_yaw:g} rad "
                "(logged once; see /diagnostics)"
            )
        return Uncertainty(fallback.pose_sigma_xy, fallback.pose_sigma_yaw)

    def _on_tick(self) -> None:
        if not self.is_active:
            return
        self.goals.take_waiting()
        supervisor = self.supervisor
        supervisor.clock.is_simulated = self.clock_watch.is_simulated
        command = supervisor.on_tick(self.clock_watch.now(), time.monotonic(), bool(self._clock_problem()))
        if command is not None:
            self.outputs.commands.send(command)
        self._publish_changes()

    def _publish_changes(self) -> None:
        self.outputs.publish_status(self.supervisor, only_changes=True)
        self.goals.publish_changes()

    def _on_status_tick(self) -> None:
        if self.is_active:
            supervisor, commands = self.supervisor, self.outputs.commands
            commands.check(supervisor.state in WITH_GOAL)
            waits = supervisor.status in (STALE, WAITING)
            pose_problem = (self._clock_problem() or self._pose_publisher.problem()) if waits else ""
            supervisor.problem = "; ".join(filter(None, (pose_problem, commands.problem)))
            has_poses = supervisor.goals.present is not None and not waits
            supervisor.pose_fault = self._pose_publisher.fault() if has_poses else ""
        self.outputs.publish_status(self.supervisor)


def main(args: list[str] | None = None) -> int:
    """Run the node; return the exit status of the process."""
    return run(ControllerNode, args, shared_memory=False)


if __name__ == "__main__":
    raise SystemExit(main())
