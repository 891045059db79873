"""Which topics of a bag are a robot's odometry, estimate, commands ..., by name and type; robots by namespace."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from diffbot_bag.bag.number_rows import LABELLED

ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
TWIST, TWIST_STAMPED = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"
STATUS, STATUSES = "diagnostic_msgs/msg/DiagnosticStatus", "diagnostic_msgs/msg/DiagnosticArray"
PATH, CLOUD = "nav_msgs/msg/Path", "sensor_msgs/msg/PointCloud2"
STRING = "std_msgs/msg/String"
LOG, TRANSFORMS = "rcl_interfaces/msg/Log", "tf2_msgs/msg/TFMessage"

ROLES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "truth": (("ground_truth",), (ODOMETRY, POSE, POSE_STAMPED)),
    "estimate": (("pose", "odometry/filtered", "amcl_pose"), (POSE, ODOMETRY)),
    "odometry": (("odom", "odometry", "wheel/odometry"), (ODOMETRY,)),
    "fixes": (("global_pose", "gps/pose"), (POSE, ODOMETRY)),
    "command": (("cmd_vel",), (TWIST, TWIST_STAMPED)),
    "law": (("controller/navigation",), (LABELLED,)),
    "controller": (("controller/status",), (STATUS,)),
    "filter": (("ekf/status",), (STATUS,)),
    "goals": (("goal_pose",), (POSE_STAMPED,)),
    "results": (("controller/goal_results",), (STATUSES,)),
    "plan": (("path",), (PATH,)),
    "landmarks": (("landmarks",), (CLOUD,)),
    "transforms": (("tf",), (TRANSFORMS,)),
    "description": (("robot_description",), (STRING,)),
}
"""Names below the robot's namespace, the best first, and the types that are understood."""
COMMON = {"/diagnostics": STATUSES, "/rosout": LOG}
"""Topics of all robots together."""
_POSES = ("truth", "estimate", "odometry", "transforms")
"""What makes a robot: something that tells where it is."""


class RobotTopics(NamedTuple):
    """The topics of one robot."""

    namespace: str
    """such as ``/robot1``; empty for a robot without one"""
    names: Mapping[str, str]
    """topic by role"""


def robots_in(types: Mapping[str, str]) -> list[RobotTopics]:
    """Return the robots of a bag in the order of their namespaces.

    Args:
        types: type of each topic, by its name.
    """
    found: dict[str, dict[str, str]] = {}
    for role, (names, role_types) in ROLES.items():
        for name in names:
            for topic, type_name in types.items():
                if type_name in role_types and topic.endswith(f"/{name}"):
                    found.setdefault(topic[: -len(name) - 1], {}).setdefault(role, topic)
    _unshare(found)
    robots = [RobotTopics(space, roles) for space, roles in sorted(found.items()) if set(_POSES) & set(roles)]
    return robots or _foreign(types)


def _unshare(found: dict[str, dict[str, str]]) -> None:
    """Of ``/odometry/filtered`` beside ``/odom``, the namespace is no robot: one topic is of one robot."""
    for space in sorted(found, key=len, reverse=True):
        parent, _, last = space.rpartition("/")
        if last in ("odometry", "wheel", "gps") and parent in found:
            del found[space]


def _foreign(types: Mapping[str, str]) -> list[RobotTopics]:
    """Return one robot for each odometry or pose topic of an unknown name, named like the topic."""
    role_of = {ODOMETRY: "odometry", POSE: "estimate", POSE_STAMPED: "truth"}
    return [RobotTopics(topic, {role_of[kind]: topic}) for topic, kind in sorted(types.items()) if kind in role_of]
