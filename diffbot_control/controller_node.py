"""The node ``controller``: pose or odometry/filtered, and goal_pose or path -> cmd_vel."""

from __future__ import annotations

if __name__ == "__main__":  # before the imports that take long: see launcher
    from diffbot_core.launcher import launch

    raise SystemExit(launch("diffbot_control.controller_node"))

import time
from array import array
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TwistStamped
from geometry_msgs.msg import Twist as TwistMessage
from nav_msgs.msg import Odometry, Path
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from diffbot_control.law import supervisor
from diffbot_control.law.controller import SwitchingLaw
from diffbot_control.law.driver import STOP
from diffbot_control.law.loop_check import unstable_gains
from diffbot_control.law.supervisor import Supervisor
from diffbot_control.ros.controller_parameters import (
    CONTROLLER_PRESETS,
    ControllerNodeConfig,
    law_of,
    parameter_set_of,
)
from diffbot_control.ros.controller_status import status_values
from diffbot_control.ros.frames import robot_frame
from diffbot_control.ros.goal_server import GoalServer
from diffbot_control.ros.message_bytes import read_pose
from diffbot_control.ros.message_fields import fill_twist, set_stamp
from diffbot_control.ros.messages import goal_from, labelled_array, path_from, pose_from, twist_message
from diffbot_control.ros.nav2_actions import serve_nav2_actions
from diffbot_control.ros.pose_watch import PoseWatch
from diffbot_control.ros.tf import transforms_of
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.health import Throttle
from diffbot_core.kinematics import Twist
from diffbot_core.ros.managed_node import INACTIVE, ManagedNode
from diffbot_core.ros.node import LATCHED, run, status_message
from diffbot_core.ros.qos import sensor_qos
from diffbot_core.uncertainty import Uncertainty
from diffbot_core.units import NS_PER_S

NAVIGATION_LABELS = ("stamp", "rho", "alpha", "beta", "theta", "eps_P", "region", "V")
_LEVELS = {
    supervisor.STALE: DiagnosticStatus.ERROR[0],
    supervisor.WAITING: DiagnosticStatus.WARN[0],
    supervisor.UNCERTAIN: DiagnosticStatus.WARN[0],
    supervisor.NOT_REACHED: DiagnosticStatus.ERROR[0],
}
_STATUS_PERIOD = 0.5
_STATE_LOG_PERIOD = 2.0
"""[s] a state is logged again, for one goal, only after so long: two that alternate take a line a second"""
_STOP_DELIVERY = Duration(seconds=0.2)
"""Time allowed for the delivery of the stop command."""
_MIN_WATCH_PERIOD = 1e-3
"""[s] a timer with a period of 0 would use a whole processor."""


class ControllerNode(ManagedNode[ControllerNodeConfig]):
    """Answers every pose with one command while a goal is driven to or held."""

    def __init__(self, **node_options: Any) -> None:
        """Create the node, and with ``autostart`` start it."""
        super().__init__("controller", ControllerNodeConfig, CONTROLLER_PRESETS, **node_options)

    def configure(self) -> None:
        """Create publishers, subscriptions, the timer for missing poses and the service ~/cancel."""
        config = self.config
        self.law = law_of(config.law)
        self.supervisor = Supervisor(config.supervisor, self.law)
        self._robot_frame = robot_frame(config)
        self._command = twist_message(config.enable_stamped_cmd_vel, self._robot_frame)
        command_type = TwistStamped if config.enable_stamped_cmd_vel else TwistMessage
        self._commands = self.create_publisher(command_type, "cmd_vel", QoSProfile(depth=1))
        self._statuses = self.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        self._navigations = self.create_publisher(Float64MultiArray, "~/navigation", QoSProfile(depth=10))
        self._navigation = labelled_array(NAVIGATION_LABELS)
        self._last_status = ("", 0)
        self._state_log = Throttle(_STATE_LOG_PERIOD)
        self._transforms = transforms_of(self, config.transform_tolerance)
        self._pose_stamp: int | None = None
        self._pose_watch = PoseWatch(self.clock_watch)
        self._gains_checked = False
        now = self.clock_watch.now
        self.goals = GoalServer(self, self.supervisor, self._goals_of, now, self.cancel, self._publish_status)
        self._actions = serve_nav2_actions(self, self.goals)
        self.subscribe(PoseStamped, "goal_pose", lambda message: self.goals.accept(message, "goal_pose"))
        self.subscribe(Path, "path", lambda message: self.goals.accept(message, "path"))
        self._pose_topic = "pose" if config.pose_source == "pose" else "odometry/filtered"
        self._receive_poses(self._pose_topic)
        self.create_service(Trigger, "~/cancel", self._on_cancel)
        self._watch = self.create_timer(self._watch_period(), self._on_tick, clock=self.steady_clock)
        self.create_timer(_STATUS_PERIOD, self._publish_status, clock=self.steady_clock)

    def activate(self) -> None:
        """Start idle."""
        book = self.supervisor.goals
        self.supervisor = self.goals.supervisor = Supervisor(self.config.supervisor, self.law)
        # How earlier goals ended is still to be answered.
        self.supervisor.goals = book
        self._publish_status()

    def deactivate(self) -> None:
        """Stop the robot and leave cmd_vel to others; the goal is cancelled."""
        self.supervisor.on_cancel()
        self.supervisor.goals.close_cancelled()
        self._send(STOP)
        # Before the publisher may be destroyed, and with it what it has not delivered.
        self._commands.wait_for_all_acked(_STOP_DELIVERY)
        self._publish_status()
        self.goals.publish_changes()

    def halt(self) -> None:
        """Stop the robot and cancel the goal; it stands until the next one."""
        if self.is_active:
            self._send(STOP)  # first: what follows may fail, too
            self.deactivate()
            self.activate()

    def cleanup(self) -> None:
        """Take the actions out of service."""
        if self._actions is not None:
            self._actions.destroy()

    def _receive_poses(self, topic: str) -> None:
        """Subscribe to the pose's topic."""
        qos = sensor_qos(self.config.reliable_inputs)
        if topic == "pose":
            self.subscribe(PoseWithCovarianceStamped, topic, lambda data: self._on_pose(read_pose(data)), qos, raw=True)
        else:
            self.subscribe(Odometry, topic, self._on_pose, qos)

    def parameter_set(
        self,
        config_type: type[ControllerNodeConfig],
        presets: Mapping[str, ControllerNodeConfig] | None,
        overrides: Mapping[str, Any],
    ) -> tuple[type[ControllerNodeConfig], Mapping[str, ControllerNodeConfig] | None]:
        """Return the parameters for the law among the overrides."""
        return parameter_set_of(overrides)

    def on_config(self, config: ControllerNodeConfig) -> None:
        """Use changed gains, limits and tolerances from the next pose on."""
        self.supervisor.config = config.supervisor
        self._gains_checked = False
        self._watch.timer_period_ns = int(self._watch_period() * NS_PER_S)

    def health_level(self) -> tuple[int, str]:
        """Report the controller's state in /diagnostics."""
        level, text = super().health_level()
        problem = self._pose_watch.clock_problem(self.config) if self.is_configured else ""
        text = text if problem in text else f"{problem}; {text}"
        return max(level, _LEVELS.get(self.supervisor.state, 0)), f"{self.supervisor.state}; {text}"

    def _watch_period(self) -> float:
        return min(max(0.25 * self.config.supervisor.pose_timeout, _MIN_WATCH_PERIOD), 0.1)

    def _goals_of(self, message: PoseStamped | Path) -> list[Pose]:
        """Return the goals of a message in ``map_frame``.

        Raises:
            BadMessageError: if it cannot be used, or the node is inactive.
        """
        if not self.is_active:
            raise BadMessageError("the controller is inactive")
        self._pose_watch.on_goal()
        frame = self.config.map_frame
        if isinstance(message, Path):
            return path_from(message, frame, self._transforms)
        return [goal_from(message, frame, self._transforms)]

    def _check_gains(self, stamp: int) -> None:
        """Warn once of gains that cannot be stable at the rate of the poses."""
        before, self._pose_stamp = self._pose_stamp, stamp
        if self._gains_checked or before is None or stamp <= before or self.law is not SwitchingLaw:
            return
        self._gains_checked = True
        warning = unstable_gains(self.config.supervisor.controller, (stamp - before) / NS_PER_S)
        if warning:
            self.get_logger().warning(warning)

    def _on_pose(self, message: PoseWithCovarianceStamped | Odometry) -> None:
        stamp, pose, uncertainty = pose_from(message, self.config.map_frame, self._robot_frame)
        self._answer(stamp, pose, self._fallback() if uncertainty is None else uncertainty)

    def take_pose(self, stamp: int, pose: Pose, uncertainty: Uncertainty) -> None:
        """Answer an estimate handed over in this process, as if it had come as a message.

        Args:
            stamp: [ns] time the pose belongs to.
            pose: in ``map_frame``.
            uncertainty: of the pose; it has to be known.
        """
        self._answer(stamp, pose, uncertainty)
        self.health.accept(self._pose_topic, time.monotonic())

    def _answer(self, stamp: int, pose: Pose, uncertainty: Uncertainty) -> None:
        if not self.is_active:
            return
        self._pose_watch.on_pose()
        self._check_gains(stamp)
        if self._pose_watch.clock_problem(self.config):
            self._on_tick()
            return
        command = self.supervisor.on_pose(stamp, self.clock_watch.now(), pose, uncertainty)
        if command is not None:
            self._send(command, stamp)
        if self.supervisor.report is not None:
            self._publish_navigation(stamp)
        self._publish_changes()

    def _fallback(self) -> Uncertainty:
        """Return the uncertainty of a pose without covariance; counted, and logged once."""
        note = f"{self._pose_topic} with the covariance of the parameters"
        self.health.counted[note] += 1
        fallback = self.config.pose_fallback
        if self.health.counted[note] == 1:
            self.get_logger().warning(
                f"{self._pose_topic}: covariance is all zero, i.e. unknown: assuming pose_sigma_xy = "
                f"{fallback.pose_sigma_xy:g} m, pose_sigma_yaw = {fallback.pose_sigma_yaw:g} rad "
                "(logged once; see /diagnostics)"
            )
        return fallback.uncertainty()

    def _on_tick(self) -> None:
        if not self.is_active:
            return
        watch = self._pose_watch
        command = self.supervisor.on_tick(self.clock_watch.now(), watch.silence(), watch.is_stale(self.config))
        if command is not None:
            self._send(command)
        self._publish_changes()

    def _on_cancel(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self.cancel()
        response.message = "cancelled" if response.success else "there was no goal"
        return response

    def cancel(self) -> bool:
        """Drop the goal and start to come to rest; return whether there was one."""
        had_goal = self.supervisor.goal is not None
        command = self.supervisor.on_cancel()
        if command is not None:
            self._send(command)
        self._publish_status()
        self.goals.publish_changes(force=had_goal)
        return had_goal

    def _send(self, command: Twist, stamp: int | None = None) -> None:
        if isinstance(self._command, TwistStamped):
            set_stamp(
                self._command.header.stamp,
                self.get_clock().now().nanoseconds if stamp is None else stamp,
            )
            fill_twist(self._command.twist, command)
        else:
            fill_twist(self._command, command)
        self._commands.publish(self._command)
        self.health.sent["cmd_vel"] += 1

    def _publish_navigation(self, stamp: int) -> None:
        report = self.supervisor.report
        if report is None or not self._navigations.get_subscription_count():
            return
        variables = (report.rho, report.alpha, report.beta, report.theta, report.eps_P, report.region, report.lyapunov)
        self._navigation.data = array("d", (stamp / NS_PER_S, *variables))
        self._navigations.publish(self._navigation)

    def _publish_changes(self) -> None:
        if (self.supervisor.state, self.supervisor.waypoint) != self._last_status:
            self._publish_status()
        self.goals.publish_changes()

    def _publish_status(self) -> None:
        state = self.supervisor.state if self.is_active else INACTIVE
        values = status_values(self.supervisor, self.law)
        if self.supervisor.has_failed and state != self._last_status[0]:
            self.get_logger().error(f"{state}: {self.supervisor.reason}")
        elif state != self._last_status[0] and self._state_log.is_due((state, self.supervisor.goal), time.monotonic()):
            self.get_logger().info(f"{state}: {self.supervisor.reason}" if self.supervisor.reason else state)
        self._last_status = (state, self.supervisor.waypoint)
        self._statuses.publish(status_message(self.get_fully_qualified_name(), _LEVELS.get(state, 0), state, values))


def main(args: list[str] | None = None) -> int:
    """Run the node; return the exit status of the process."""
    return run(ControllerNode, args)
