"""The messages that the node ``controller`` publishes: cmd_vel, ~/navigation, ~/status, and the states of its goals."""

from __future__ import annotations

import time
from array import array
from typing import TYPE_CHECKING, Any

from action_msgs.msg import GoalInfo, GoalStatus, GoalStatusArray
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist as TwistMessage
from geometry_msgs.msg import TwistStamped
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from diffbot_control.goals import record as goal_record
from diffbot_control.goals import states
from diffbot_control.goals.record import GoalBook, GoalRecord
from diffbot_control.goals.supervisor import Supervisor
from diffbot_control.law.goal_checker import smallest_tolerance
from diffbot_control.law.regions import REGION_NAMES
from diffbot_control.ros.messages.fields import fill_twist, set_stamp
from diffbot_core.endpoints import (
    AUTO,
    TWIST,
    TWIST_STAMPED,
    TYPE_WORDS,
    Endpoint,
    bases,
    command_problem,
    followed_type,
)
from diffbot_core.health import Throttle
from diffbot_core.kinematics import Twist
from diffbot_core.ros.graph import bases_elsewhere, publishers_of, subscriptions_of
from diffbot_core.ros.managed_node import INACTIVE, ManagedNode
from diffbot_core.ros.node import status_message
from diffbot_core.ros.qos import LATCHED, QUEUE, STATUS, deliver
from diffbot_core.shared_parameters import robot_frame
from diffbot_core.stamps import NS_PER_S

if TYPE_CHECKING:
    from diffbot_control.ros.goals.server import GoalFeedback
    from diffbot_control.ros.parameters.controller import ControllerNodeConfig

NAVIGATION_LABELS = ("stamp", "rho", "alpha", "beta", "theta", "eps_P", "region", "V")
LEVELS = {
    states.STALE: DiagnosticStatus.ERROR[0],
    states.WAITING: DiagnosticStatus.WARN[0],
    states.UNCERTAIN: DiagnosticStatus.WARN[0],
    states.NOT_AT_GOAL: DiagnosticStatus.ERROR[0],
}
"""Levels of the status texts; OK for the other texts."""
BEYOND_LIMITS = "the command exceeds limits that were lowered: braking as fast as the accelerations allow"
STATE_LOG_PERIOD = 2.0
"""[s] log throttle for one state and goal, so that alternating states do not fill the log"""
_ENDS = {
    goal_record.REACHED: GoalStatus.STATUS_SUCCEEDED,
    goal_record.CANCELLED: GoalStatus.STATUS_CANCELED,
}
"""Status of a goal for its end; STATUS_ABORTED for the other ends, as in Nav2."""


class CommandOutput:
    """Publishes cmd_vel, with the type to which the base subscribes or that the parameter cmd_vel_type sets.

    While the type is unknown, nothing is published: a recorder takes the type of a topic from its first publisher, and
    a process can use a topic with one type only.
    """

    def __init__(self, node: ManagedNode[ControllerNodeConfig]) -> None:
        """Create the publisher if a parameter sets its type."""
        self._node = node
        self.newest = Twist(0.0, 0.0)
        self.problem = self._found = ""
        """why no base receives the commands, once two consecutive checks agree; result of the newest check"""
        self._topic, self._next = node.resolve_topic_name("cmd_vel"), ""
        """full name of cmd_vel; message type to which the next check changes, empty for no change"""
        self._is_automatic = node.config.cmd_vel_type == AUTO
        self._publisher: Any = None
        self._type = TWIST_STAMPED if node.config.cmd_vel_type == TYPE_WORDS[TWIST_STAMPED] else TWIST
        if not self._is_automatic:
            self._open(self._type)

    @property
    def is_open(self) -> bool:
        """False while nothing is published, because the type is unknown."""
        return self._publisher is not None

    def _open(self, kind: str) -> None:
        self._command = TwistStamped() if kind == TWIST_STAMPED else TwistMessage()
        if isinstance(self._command, TwistStamped):
            self._command.header.frame_id = robot_frame(self._node.config)
        self._publisher = self._node.create_publisher(type(self._command), "cmd_vel", QoSProfile(depth=1))
        self._type = kind

    def send(self, command: Twist, stamp: int | None = None) -> None:
        """Publish a command; ``stamp`` [ns] is the stamp of the answered pose, by default the current time."""
        self.newest = command
        if self._publisher is None and not self._next:
            self._open_for_base(subscriptions_of(self._node, self._topic))
        if self._publisher is None:
            return
        if isinstance(self._command, TwistStamped):
            now = self._node.get_clock().now().nanoseconds if stamp is None else stamp
            set_stamp(self._command.header.stamp, now)
            fill_twist(self._command.twist, command)
        else:
            fill_twist(self._command, command)
        self._publisher.publish(self._command)
        self._node.health.sent["cmd_vel"] += 1

    def deliver(self, command: Twist) -> None:
        """Publish a command and wait until all subscribers have confirmed it; log a warning if one has not."""
        if self._publisher is not None and not deliver(self._node, self._publisher, lambda: self.send(command)):
            text = "a subscriber of cmd_vel has not confirmed the last command, which may be lost"
            self._node.get_logger().warning(text)

    def check(self, has_goal: bool) -> None:
        """Check the subscriptions to cmd_vel twice a second, and follow their type unless a parameter sets the type.

        Args:
            has_goal: True if the robot has a goal, so that a missing base is a problem.
        """
        if self._next:
            self._change()
        subscriptions = subscriptions_of(self._node, self._topic)
        if self._publisher is None:
            self._open_for_base(subscriptions)
        elif self._is_automatic and (kind := followed_type(self._type, subscriptions)) != self._type:
            # rclpy destroys the publisher only after this callback, and a process can use a topic with one type only.
            self._node.destroy_publisher(self._publisher)
            self._publisher, self._next = None, kind
            return
        is_alone, name = not bases(subscriptions), self._node.get_fully_qualified_name()
        own = [one for one in publishers_of(self._node, self._topic) if one.node == name and one.type == self._type]
        before, self._found = self._found, ""
        if (own or is_alone) and (has_goal or not is_alone):
            elsewhere = bases_elsewhere(self._node, self._topic) if is_alone else ()
            self._found = command_problem(
                self._topic, own[0] if own else Endpoint(name, self._type), subscriptions, elsewhere
            )
        if self._found == before:  # DDS reports the name of a node shortly after its subscriptions
            self.problem = self._found

    def _open_for_base(self, subscriptions: list[Endpoint]) -> None:
        """Open the publisher if a base subscribes."""
        if bases(subscriptions):
            self._next = followed_type(self._type, subscriptions)
            self._change()

    def _change(self) -> None:
        kind, before, self._next = self._next, self._type, ""
        try:
            self._open(kind)
        except RuntimeError:  # another node of this process uses the topic with the other type
            self._open(TWIST if kind == TWIST_STAMPED else TWIST_STAMPED)
            self._is_automatic = False
        else:
            if kind != before:
                name = kind.rpartition("/")[2]
                self._node.get_logger().info(f"cmd_vel: publishing {name}, the type to which the base subscribes")


class ControllerPublishers:
    """Publishes commands, variables of the law, the state, and the progress and results of goals."""

    def __init__(self, node: ManagedNode[ControllerNodeConfig]) -> None:
        """Create the publishers."""
        self._node = node
        self.commands = CommandOutput(node)
        self._statuses = node.create_publisher(DiagnosticStatus, "~/status", STATUS)
        self._navigations = node.create_publisher(Float64MultiArray, "~/navigation", QoSProfile(depth=10))
        self._goal_states = node.create_publisher(GoalStatusArray, "~/goal_status", LATCHED)
        self._results = node.create_publisher(DiagnosticArray, "~/goal_results", LATCHED)
        self._feedbacks = node.create_publisher(DiagnosticStatus, "~/goal_feedback", QUEUE)
        self._navigation = Float64MultiArray()
        self._navigation.layout.dim = [MultiArrayDimension(label=one, size=1, stride=1) for one in NAVIGATION_LABELS]
        self._last_status, self._last_problem = ("", 0), ""
        self._state_log = Throttle(STATE_LOG_PERIOD)

    def publish_navigation(self, stamp: int, supervisor: Supervisor) -> None:
        """Publish the variables of the law for the pose with ``stamp`` [ns], if the topic has a subscription."""
        report = supervisor.report
        if report is None or not self._navigations.get_subscription_count():
            return
        variables = (report.rho, report.alpha, report.beta, report.theta, report.eps_P, report.region, report.lyapunov)
        self._navigation.data = array("d", (stamp / NS_PER_S, *variables))
        self._navigations.publish(self._navigation)

    def publish_status(self, supervisor: Supervisor, only_changes: bool = False) -> None:
        """Publish the state and log its changes; if ``only_changes``, only after a change of state or waypoint."""
        state = supervisor.status if self._node.is_active else INACTIVE
        if only_changes and (supervisor.status, supervisor.waypoint) == self._last_status:
            return
        logger = self._node.get_logger()
        if supervisor.has_failed and state != self._last_status[0]:
            logger.error(f"{state}: {supervisor.reason}")
        elif state != self._last_status[0] and self._state_log.is_due((state, supervisor.goal), time.monotonic()):
            logger.info(f"{state}: {supervisor.reason}" if supervisor.reason else state)
        if supervisor.problem and supervisor.problem != self._last_problem:
            logger.warning(supervisor.problem)
        self._last_problem = supervisor.problem
        self._last_status = (state, supervisor.waypoint)
        name, values = self._node.get_fully_qualified_name(), _status_values(supervisor)
        self._statuses.publish(status_message(name, LEVELS.get(state, 0), state, values))

    def publish_goals(self, book: GoalBook, news: list[GoalRecord]) -> None:
        """Publish the states of all goals, and the results if a goal has ended since the last call (``news``)."""
        ended = [record for record in book.ended if record.request.id]
        if news:
            message = DiagnosticArray(status=[_result_message(record) for record in ended])
            message.header.stamp = self._node.get_clock().now().to_msg()
            self._results.publish(message)
        accepted = [record for record in ended if record.end != goal_record.REFUSED]
        if book.present is not None and book.present.request.id:
            accepted.append(book.present)
        self._goal_states.publish(GoalStatusArray(status_list=[_status_of(record) for record in accepted]))

    def publish_feedback(self, feedback: GoalFeedback) -> None:
        """Publish the progress towards the current goal, if the topic has a subscription."""
        if not self._feedbacks.get_subscription_count():
            return
        values = {
            "distance remaining [m]": f"{feedback.distance:.4f}",
            "elapsed time [s]": f"{feedback.elapsed:.3f}",
            "estimated time remaining [s]": f"{feedback.remaining:.3f}",
            "poses remaining": str(feedback.poses),
            "pose": " ".join(f"{number:.6g}" for number in feedback.pose),
        }
        self._feedbacks.publish(status_message(feedback.id, 0, feedback.state, values))


def goal_info(record: GoalRecord) -> GoalInfo:
    """Return id and time of acceptance of a goal."""
    info = GoalInfo()
    info.goal_id.uuid = list(bytes.fromhex(record.request.id))
    set_stamp(info.stamp, round(record.request.time * NS_PER_S))
    return info


def _status_of(record: GoalRecord) -> GoalStatus:
    if record.end:
        status = _ENDS.get(record.end, GoalStatus.STATUS_ABORTED)
    else:
        status = GoalStatus.STATUS_CANCELING if record.is_cancelling else GoalStatus.STATUS_EXECUTING
    return GoalStatus(goal_info=goal_info(record), status=status)


def _result_message(record: GoalRecord) -> DiagnosticStatus:
    level = 0 if record.end == goal_record.REACHED else DiagnosticStatus.WARN[0]
    values = {
        "reason": record.reason,
        "source": record.request.source,
        "elapsed time [s]": f"{record.elapsed:.3f}",
    }
    return status_message(record.request.id, level, record.end, values)


def _status_values(supervisor: Supervisor) -> dict[str, str]:
    """Return the key-value pairs of ~/status."""
    report, book = supervisor.report, supervisor.goals
    values = {"law": supervisor.law.name, **supervisor.description()}
    values["goals reached"] = str(supervisor.goals_reached)
    if supervisor.goal is not None:
        values["goal"] = " ".join(f"{number:.6g}" for number in supervisor.goal)
        if book.newest is not None and book.newest.request.id:
            values["goal id"] = book.newest.request.id
        if book.present is not None:
            values["timeout [s]"] = f"{supervisor.timeout:.6g}"
    if supervisor.updates:
        values["goal updates"] = str(supervisor.updates)
    if report is not None:
        values["region"] = REGION_NAMES[report.region == 1]
        values["distance [m]"] = f"{report.rho:.4f}"
        values["heading error [rad]"] = f"{report.theta:.4f}"
        values["eps_P [m]"] = f"{report.eps_P:.4f}"
        xy, theta = smallest_tolerance(supervisor.tolerance, supervisor.uncertainty)
        values |= {"smallest tolerance [m]": f"{xy:.4f}", "smallest tolerance [rad]": f"{theta:.4f}"}
    if supervisor.waypoints:
        values["waypoint"] = f"{supervisor.waypoint}/{supervisor.waypoints}"
    if supervisor.is_beyond_limits:
        values["limits"] = BEYOND_LIMITS
    if supervisor.reason:
        values["reason"] = supervisor.reason
    if supervisor.problem:
        values["problem"] = supervisor.problem
    return values
