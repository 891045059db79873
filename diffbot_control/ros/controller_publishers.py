"""What the node ``controller`` publishes besides the state of goals: cmd_vel, ~/navigation, ~/status."""

from __future__ import annotations

import time
from array import array
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist as TwistMessage
from geometry_msgs.msg import TwistStamped
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray

from diffbot_control.goals.protocol import Law
from diffbot_control.goals.supervisor import Supervisor
from diffbot_control.ros.controller_status import LEVELS, status_values
from diffbot_control.ros.frames import robot_frame
from diffbot_control.ros.messages.conversions import labelled_array, twist_message
from diffbot_control.ros.messages.fields import fill_twist, set_stamp
from diffbot_core.health import Throttle
from diffbot_core.kinematics import Twist
from diffbot_core.ros.delivery import deliver
from diffbot_core.ros.managed_node import INACTIVE, ManagedNode
from diffbot_core.ros.node import status_message
from diffbot_core.ros.qos import STATUS
from diffbot_core.units import NS_PER_S

if TYPE_CHECKING:
    from diffbot_control.ros.parameters.controller import ControllerNodeConfig

NAVIGATION_LABELS = ("stamp", "rho", "alpha", "beta", "theta", "eps_P", "region", "V")
STATE_LOG_PERIOD = 2.0
"""[s] a state is logged again, for one goal, only after so long: two that alternate take a line a second"""


class ControllerPublishers:
    """Publishes commands, the variables of the law, and the state."""

    def __init__(self, node: ManagedNode[ControllerNodeConfig]) -> None:
        """Create the publishers in the types that the node's configuration asks for."""
        self._node = node
        config = node.config
        self._command = twist_message(config.enable_stamped_cmd_vel, robot_frame(config))
        command_type = TwistStamped if config.enable_stamped_cmd_vel else TwistMessage
        self._commands = node.create_publisher(command_type, "cmd_vel", QoSProfile(depth=1))
        self._statuses = node.create_publisher(DiagnosticStatus, "~/status", STATUS)
        self._navigations = node.create_publisher(Float64MultiArray, "~/navigation", QoSProfile(depth=10))
        self._navigation = labelled_array(NAVIGATION_LABELS)
        self._last_status = ("", 0)
        self._state_log = Throttle(STATE_LOG_PERIOD)

    def send(self, command: Twist, stamp: int | None = None) -> None:
        """Publish a command; ``stamp`` [ns] of a TwistStamped is that of the pose it answers, without one the time."""
        if isinstance(self._command, TwistStamped):
            now = self._node.get_clock().now().nanoseconds if stamp is None else stamp
            set_stamp(self._command.header.stamp, now)
            fill_twist(self._command.twist, command)
        else:
            fill_twist(self._command, command)
        self._commands.publish(self._command)
        self._node.health.sent["cmd_vel"] += 1

    def deliver(self, command: Twist) -> None:
        """Publish a command until every subscriber has it; a warning names the topic if one has not confirmed it."""
        if not deliver(self._node, self._commands, lambda: self.send(command)):
            text = "not every subscriber of cmd_vel has confirmed the last command"
            self._node.get_logger().warning(text)

    def publish_navigation(self, stamp: int, supervisor: Supervisor) -> None:
        """Publish the law's variables of the pose with ``stamp`` [ns], if anybody listens."""
        report = supervisor.report
        if report is None or not self._navigations.get_subscription_count():
            return
        variables = (report.rho, report.alpha, report.beta, report.theta, report.eps_P, report.region, report.lyapunov)
        self._navigation.data = array("d", (stamp / NS_PER_S, *variables))
        self._navigations.publish(self._navigation)

    def publish_status(self, supervisor: Supervisor, law: Law, only_changes: bool = False) -> None:
        """Publish the state and log a change of it; with ``only_changes``, nothing unless it or the waypoint is new."""
        state = supervisor.status if self._node.is_active else INACTIVE
        if only_changes and (supervisor.status, supervisor.waypoint) == self._last_status:
            return
        logger = self._node.get_logger()
        if supervisor.has_failed and state != self._last_status[0]:
            logger.error(f"{state}: {supervisor.reason}")
        elif state != self._last_status[0] and self._state_log.is_due((state, supervisor.goal), time.monotonic()):
            logger.info(f"{state}: {supervisor.reason}" if supervisor.reason else state)
        self._last_status = (state, supervisor.waypoint)
        name, values = self._node.get_fully_qualified_name(), status_values(supervisor, law)
        self._statuses.publish(status_message(name, LEVELS.get(state, 0), state, values))
