"""The node ``controller``: pose or odometry/filtered, and goal_pose or path -> cmd_vel."""

from __future__ import annotations

if __name__ == "__main__":  # before the imports that take long: see launcher
    from diffbot_core.launcher import launch

    raise SystemExit(launch("diffbot_control.controller_node"))

from array import array
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import (
    PoseStamped,
    PoseWithCovarianceStamped,
    TwistStamped,
)
from geometry_msgs.msg import (
    Twist as TwistMessage,
)
from nav_msgs.msg import Odometry, Path
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from diffbot_control.law import supervisor
from diffbot_control.law.controller import SwitchingLaw
from diffbot_control.law.loop_check import unstable_gains
from diffbot_control.law.supervisor import Supervisor
from diffbot_control.ros.controller_parameters import (
    CONTROLLER_PRESETS,
    ControllerNodeConfig,
    law_of,
    parameter_set_of,
)
from diffbot_control.ros.controller_status import status_values
from diffbot_control.ros.goal_server import GoalServer
from diffbot_control.ros.message_fields import fill_twist, set_stamp
from diffbot_control.ros.messages import (
    labelled_array,
    pose_from,
    twist_message,
)
from diffbot_control.ros.nav2_actions import serve_nav2_actions
from diffbot_core.kinematics import Twist
from diffbot_core.ros.node import LATCHED, DiffbotNode, run, status_message
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
_STOP_DELIVERY = Duration(seconds=0.2)
"""Time allowed at shutdown for the delivery of the stop command."""
_MIN_WATCH_PERIOD = 1e-3
"""[s] a timer with a period of 0 would use a whole processor."""


class ControllerNode(DiffbotNode[ControllerNodeConfig]):
    """Answers every pose with one command while a goal is driven to or held."""

    def __init__(self, **node_options: Any) -> None:
        """Create publishers, subscriptions, the timer for missing poses and the service ~/cancel."""
        super().__init__("controller", ControllerNodeConfig, CONTROLLER_PRESETS, **node_options)
        config = self.config
        self.law = law_of(config.law)
        self.supervisor = Supervisor(config.supervisor, self.law)
        self._command = twist_message(config.enable_stamped_cmd_vel, config.base_link_frame)
        command_type = TwistStamped if config.enable_stamped_cmd_vel else TwistMessage
        self._commands = self.create_publisher(command_type, "cmd_vel", QoSProfile(depth=1))
        self._statuses = self.create_publisher(DiagnosticStatus, "~/status", LATCHED)
        self._navigations = self.create_publisher(Float64MultiArray, "~/navigation", QoSProfile(depth=10))
        self._navigation = labelled_array(NAVIGATION_LABELS)
        self._last_status = ("", 0)
        self._pose_stamp: int | None = None
        self._gains_checked = False
        self.goals = GoalServer(self, self.supervisor, self._now, self.cancel, self._publish_status)
        self._actions = serve_nav2_actions(self, self.goals)
        self.subscribe(PoseStamped, "goal_pose", self._on_goal)
        self.subscribe(Path, "path", self._on_path)
        self._pose_topic = "pose" if config.pose_source == "pose" else "odometry/filtered"
        pose_type = PoseWithCovarianceStamped if config.pose_source == "pose" else Odometry
        self.subscribe(pose_type, self._pose_topic, self._on_pose)
        self.create_service(Trigger, "~/cancel", self._on_cancel)
        self._watch = self.create_timer(self._watch_period(), self._on_tick, clock=self.steady_clock)
        self.create_timer(_STATUS_PERIOD, self._publish_status, clock=self.steady_clock)
        self._publish_status()

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

    def before_shutdown(self) -> None:
        """Stop the robot."""
        self._send(Twist(0.0, 0.0))
        # The publisher is destroyed with the node, and with it what it has not delivered.
        self._commands.wait_for_all_acked(_STOP_DELIVERY)

    def health_level(self) -> tuple[int, str]:
        """Report the controller's state in /diagnostics."""
        level, text = super().health_level()
        return max(level, _LEVELS.get(self.supervisor.state, 0)), f"{self.supervisor.state}; {text}"

    def _watch_period(self) -> float:
        return min(max(0.25 * self.config.supervisor.pose_timeout, _MIN_WATCH_PERIOD), 0.1)

    def _now(self) -> float:
        return float(self.get_clock().now().nanoseconds / NS_PER_S)

    def _on_goal(self, message: PoseStamped) -> None:
        self.goals.accept(message, "goal_pose")

    def _on_path(self, message: Path) -> None:
        self.goals.accept(message, "path")

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
        stamp, pose, uncertainty = pose_from(message, self.config.map_frame, self.config.base_link_frame)
        if uncertainty is None:
            uncertainty = self._fallback()
        self._check_gains(stamp)
        command = self.supervisor.on_pose(stamp, self._now(), pose, uncertainty)
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
        command = self.supervisor.on_tick(self._now())
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
        state = self.supervisor.state
        values = status_values(self.supervisor, self.law)
        if self.supervisor.has_failed and state != self._last_status[0]:
            self.get_logger().error(f"{state}: {self.supervisor.reason}")
        elif state != self._last_status[0]:
            self.get_logger().info(f"{state}: {self.supervisor.reason}" if self.supervisor.reason else state)
        self._last_status = (state, self.supervisor.waypoint)
        self._statuses.publish(status_message("controller", _LEVELS.get(state, 0), state, values))


def main(args: list[str] | None = None) -> int:
    """Run the node; return the exit status of the process."""
    return run(ControllerNode, args)
