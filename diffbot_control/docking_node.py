"""The nodes ``dock_ekf`` and ``dock_controller`` in one process: filter and controller in the frame of the dock.

They run beside the nodes ekf and controller, which drive to goals in the frame map. The filter turns detected_dock_pose
and odom into dock/pose. The controller turns dock/pose and a goal (dock/goal_pose, ``diffbot dock`` or the action
dock_robot) into cmd_vel.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

from action_msgs.msg import GoalStatus, GoalStatusArray
from std_srvs.srv import Trigger

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.law.docking import Docking
from diffbot_control.law.docking_axis import MAX_UNCERTAINTY
from diffbot_control.robot_node import RobotControllerNode
from diffbot_control.ros.goals.actions import DockActions
from diffbot_control.ros.parameters.dock import DockEkfConfig
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_core.ros.qos import LATCHED
from diffbot_core.ros.run import run
from diffbot_core.schema import variant
from diffbot_core.uncertainty import Uncertainty

EKF, CONTROLLER = "dock_ekf", "dock_controller"
_IN_MAP = (
    *("pose", "odometry/filtered", "global_pose", "heading", "landmarks", "initialpose"),
    *("goal_pose", "goal_update", "path"),
)
"""Topics that the nodes in map also use. The nodes of the dock add the prefix ``dock/`` to their names."""
CONTROLLER_DEFAULTS = MappingProxyType(
    {
        "law": Docking.name,
        "map_frame": "dock",
        "hold_goal": False,
        "goal_timeout": 120.0,
        "pose_lost_timeout": 5.0,
        # The controller in map is the second publisher.
        "max_cmd_vel_publishers": 2,
    }
)
"""Defaults that differ from the defaults of the controller in map."""

_CHECK_PERIOD = 0.05
"""[s] period of the checks for a new goal while there are no poses"""
_RELEASE_TIME = 0.5
"""[s] time for the controller in map to drop its goal when it is cancelled; a goal after this time is a new goal"""
_UNDER_WAY = GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING


def remappings(name: str) -> list[str]:
    """Return the ROS arguments that set the name of the node and add the prefix ``dock/`` to its topics."""
    rules = [f"__node:={name}", *(f"{topic}:=dock/{topic}" for topic in _IN_MAP)]
    return ["--ros-args", *(word for rule in rules for word in ("-r", rule))]


class DockEkfNode(EkfNode):
    """The filter in the frame of the dock."""

    def parameter_set(self, config_type: type[EkfNodeConfig], overrides: Any) -> tuple[type[EkfNodeConfig], None]:
        """Return the parameters of an ekf in the frame of a dock."""
        return DockEkfConfig, None


class DockControllerNode(RobotControllerNode):
    """The controller in the frame of the dock. It drives while its goal is newer than that of ``controller``."""

    actions = DockActions

    def parameter_set(
        self, config_type: type[Any], overrides: Mapping[str, Any]
    ) -> tuple[type[Any], Mapping[str, Any] | None]:
        """Return the parameters of a controller with the law ``docking`` and CONTROLLER_DEFAULTS.

        Raises:
            InvalidValueError: if another law is given.
        """
        if overrides.get("law", Docking.name) != Docking.name:
            raise InvalidValueError("law", overrides["law"], Docking.name)
        config_type, presets = super().parameter_set(config_type, {**overrides, "law": Docking.name})
        return variant(config_type, {}, values=CONTROLLER_DEFAULTS), presets

    def configure(self) -> None:
        """Also subscribe to the goals of the controller in map."""
        super().configure()
        self._accepted, self._goal_time = 0, -math.inf
        """number of accepted goals at the last check; [s] steady time of the check that found the newest goal"""
        self._in_map: GoalStatus | None = None
        self._before: GoalStatus | None = None
        """newest goal of the controller in map: now, and at ``_goal_time``"""
        self._must_cancel = False
        """True until the controller in map is asked to drop its goal, which it may hold"""
        self._cancel_in_map = self.create_client(Trigger, "controller/cancel")
        self.create_subscription(GoalStatusArray, "controller/goal_status", self._on_goals_in_map, LATCHED)
        self.create_timer(_CHECK_PERIOD, self._check_goals, clock=self.steady_clock)

    def take_pose(self, stamp: int, pose: Pose, uncertainty: Uncertainty) -> None:
        """Check for new goals, then handle the estimate."""
        self._check_goals()
        super().take_pose(stamp, pose, uncertainty)

    def _check_goals(self) -> None:
        """Cancel the older goal if both this controller and the controller in map have one."""
        if self.supervisor.accepted != self._accepted:
            self._accepted, self._goal_time = self.supervisor.accepted, time.monotonic()
            self._before, self._must_cancel = self._in_map, True
            if self._ekf.is_configured:
                self._restart_filter_if_lost()
        elif (
            self._has_goal_in_map()
            and self.supervisor.goal is not None
            and time.monotonic() - self._goal_time > _RELEASE_TIME
        ):
            self.goals.cancel("by a new goal of the controller in map")
            self._must_cancel = False
        # If the new goal has already ended, a goal in map may be newer. The service may not be discovered yet.
        self._must_cancel = self._must_cancel and self.supervisor.goals.present is not None
        if self._must_cancel and self._cancel_in_map.service_is_ready():
            self._must_cancel = False
            self._cancel_in_map.call_async(Trigger.Request())

    def _restart_filter_if_lost(self) -> None:
        """Restart the filter if its estimate is useless: too uncertain, or contradicted by the detections.

        Otherwise keep the estimate, because a docked robot may not detect its dock.
        """
        ekf = self._ekf.localization
        if ekf.contradiction.cause or (ekf.initialised and uncertainty_of(ekf.estimate().P).xy > MAX_UNCERTAINTY):
            self.get_logger().info("the estimate is useless: the filter restarts with the next detection of the dock")
            self._ekf.restart()

    def _has_goal_in_map(self) -> bool:
        """Return True if the controller in map drives to a goal, or has reached a new goal and may hold it."""
        if self._in_map is None or self._before is None:
            return False
        is_new = self._in_map.goal_info.goal_id != self._before.goal_info.goal_id
        return self._in_map.status in _UNDER_WAY or (is_new and self._in_map.status == GoalStatus.STATUS_SUCCEEDED)

    def _on_goals_in_map(self, message: GoalStatusArray) -> None:
        # The newest goal is the last one. After a restart of the controller in map, the list is empty.
        self._in_map = message.status_list[-1] if message.status_list else GoalStatus()
        # The first message is latched: its goal is older than a docking that has begun before the message arrives.
        if self._before is None:
            self._before = self._in_map


def make_nodes() -> Iterator[EkfNode | ControllerNode]:
    """Create the filter, then the controller."""
    ekf = DockEkfNode(cli_args=remappings(EKF))
    yield ekf
    yield DockControllerNode(ekf, cli_args=remappings(CONTROLLER))


def main(args: list[str] | None = None) -> int:
    """Run both nodes on one executor; return the exit status of the process."""
    return run(make_nodes, args, shared_memory=False)


if __name__ == "__main__":
    raise SystemExit(main())
