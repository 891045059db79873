"""The nodes ``dock_ekf`` and ``dock_controller`` in one process: a robot's filter and law in the frame of its dock.

They are the nodes ekf and controller, beside those that drive to goals in map: detected_dock_pose and odom ->
dock/pose, and with dock/goal_pose, ``diffbot dock`` or the action dock_robot -> cmd_vel.
"""

from __future__ import annotations

if __name__ == "__main__":  # before the imports that take long: see launcher
    from diffbot_core.launcher import launch

    raise SystemExit(launch("diffbot_control.docking_node"))

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
from diffbot_control.ros.goals.dock_actions import serve_dock_actions
from diffbot_control.ros.parameters.dock import NO_DOCK, POSE_WITH_COVARIANCE
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_core.ros.node import LATCHED, run_together
from diffbot_core.schema import variant
from diffbot_core.uncertainty import Uncertainty

EKF, CONTROLLER = "dock_ekf", "dock_controller"
_IN_MAP = (
    *("pose", "odometry/filtered", "global_pose", "heading", "landmarks", "initialpose"),
    *("goal_pose", "goal_update", "path", "navigate_to_pose", "navigate_through_poses"),
)
"""Topics and actions of the robot's own filter and controller, here of those in the dock's frame."""


EKF_DEFAULTS = MappingProxyType(
    {
        "map_frame": "dock",
        "publish_tf": False,
        "dock_detection": POSE_WITH_COVARIANCE,
        # A dock stands where it stands: detections that contradict the estimate are outliers, or of another dock.
        "relocation_fixes": 1_000_000,
        "relocation_timeout": 3600.0,
        # The last way is driven by odometry alone, so the wheels' errors matter.
        "wheels_as_configured": 0.0,
        "wheel_radius_sigma": 0.02,
    }
)
"""Where the filter differs from an ekf in map."""
CONTROLLER_DEFAULTS = MappingProxyType(
    {
        "law": Docking.name,
        "map_frame": "dock",
        "hold_goal": False,
        "goal_timeout": 120.0,
        "pose_lost_timeout": 5.0,
        # This one, and the controller in map.
        "max_cmd_vel_publishers": 2,
    }
)
"""Where the controller differs from one in map."""


def remappings(name: str) -> list[str]:
    """Return the arguments of a node that keep it apart from the one that it is a second copy of."""
    rules = [f"__node:={name}", *(f"{topic}:=dock/{topic}" for topic in _IN_MAP)]
    return ["--ros-args", *(word for rule in rules for word in ("-r", rule))]


_LOOK_PERIOD = 0.05
"""[s] between two looks for a new goal while there are no poses"""
_RELEASE_TIME = 0.5
"""[s] within which the controller in map lets go; a goal that it then has is a newer one"""
_UNDER_WAY = GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING


class DockEkfNode(EkfNode):
    """The filter in the frame of the dock."""

    def parameter_set(
        self, config_type: type[EkfNodeConfig], presets: Mapping[str, EkfNodeConfig] | None, overrides: Any
    ) -> tuple[type[EkfNodeConfig], Mapping[str, EkfNodeConfig] | None]:
        """Return the parameters of an ekf with the defaults of this one."""
        return variant(config_type, {}, values=EKF_DEFAULTS), presets


class DockControllerNode(RobotControllerNode):
    """The controller in the frame of the dock. Of its goals and those of the controller in map the newest wins."""

    def parameter_set(
        self, config_type: type[Any], presets: Mapping[str, Any] | None, overrides: Mapping[str, Any]
    ) -> tuple[type[Any], Mapping[str, Any] | None]:
        """Return the parameters of a controller by the law of docking, with the defaults of this one.

        Raises:
            InvalidValueError: for another law.
        """
        if overrides.get("law", Docking.name) != Docking.name:
            raise InvalidValueError("law", overrides["law"], Docking.name)
        config_type, presets = super().parameter_set(config_type, presets, {**overrides, "law": Docking.name})
        return variant(config_type, {}, values=CONTROLLER_DEFAULTS), presets

    def configure(self) -> None:
        """Watch the controller in map, too, and serve the actions of docking."""
        super().configure()
        self._dock_actions = serve_dock_actions(self, self.goals)
        self._accepted, self._began = 0, -math.inf
        """number of goals so far, and when [s] on the steady clock the newest was noticed"""
        self._in_map: GoalStatus | None = None
        self._before: GoalStatus | None = None
        """newest goal of the controller in map: now, and when the newest goal of this one was noticed"""
        self._release = self.create_client(Trigger, "controller/cancel")
        self.create_subscription(GoalStatusArray, "controller/goal_status", self._on_goals_in_map, LATCHED)
        self.create_timer(_LOOK_PERIOD, self._look_at_goals, clock=self.steady_clock)

    def cleanup(self) -> None:
        """Take the actions out of service."""
        if self._dock_actions is not None:
            self._dock_actions.destroy()
        super().cleanup()

    def take_pose(self, stamp: int, pose: Pose, uncertainty: Uncertainty) -> None:
        """Answer an estimate."""
        self._look_at_goals()
        super().take_pose(stamp, pose, uncertainty)

    def _look_at_goals(self) -> None:
        """For a new goal make the controller in map let go of its own, and later let go for a new one of that."""
        if self.supervisor.accepted != self._accepted:
            self._accepted, self._began, self._before = self.supervisor.accepted, time.monotonic(), self._in_map
            if self._release.service_is_ready():
                self._release.call_async(Trigger.Request())
            self._begin_anew_if_lost()
        elif (
            self._has_goal_in_map()
            and self.supervisor.goal is not None
            and time.monotonic() - self._began > _RELEASE_TIME
        ):
            self.get_logger().info("a new goal of the controller in map: letting go of the dock")
            self.cancel()

    def _begin_anew_if_lost(self) -> None:
        """Let the filter see the dock anew, or another one, if its pose says nothing.

        So it is if detections contradict the odometry, or the dock was not seen for too long. Otherwise the pose is
        needed: a docked robot does not see its dock.
        """
        found = self._ekf.localization
        if found.contradiction.cause or (found.initialised and uncertainty_of(found.estimate().P).xy > MAX_UNCERTAINTY):
            self.get_logger().info("the dock is looked for anew")
            self._ekf.restart()

    def _has_goal_in_map(self) -> bool:
        """Return whether the controller in map drives, or has reached a newer goal than this one, which it may hold."""
        if self._in_map is None or self._before is None:
            return False
        is_new = self._in_map.goal_info.goal_id != self._before.goal_info.goal_id
        return self._in_map.status in _UNDER_WAY or (is_new and self._in_map.status == GoalStatus.STATUS_SUCCEEDED)

    def _on_goals_in_map(self, message: GoalStatusArray) -> None:
        # Newest last; a controller that was started again has none.
        self._in_map = message.status_list[-1] if message.status_list else GoalStatus()
        # The topic is latched: the first message tells of the past, though it may come after the first docking began.
        if self._before is None:
            self._before = self._in_map


def make_nodes() -> Iterator[EkfNode | ControllerNode]:
    """Create the two nodes, the filter first.

    Raises:
        InvalidValueError: if there is nothing that detects the dock.
    """
    ekf = DockEkfNode(cli_args=remappings(EKF))
    yield ekf
    if ekf.config.dock.dock_detection == NO_DOCK:
        raise InvalidValueError("dock_detection", NO_DOCK, "a type of messages")
    yield DockControllerNode(ekf, cli_args=remappings(CONTROLLER))


def main(args: list[str] | None = None) -> int:
    """Run both nodes on one executor; return the exit status of the process."""
    return run_together(make_nodes, args, shared_memory=False)
