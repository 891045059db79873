"""The nodes ``dock_ekf`` and ``dock_controller`` in one process: a robot's filter and law in the frame of its dock.

They are the nodes ekf and controller, beside those that drive to goals in map: detected_dock_pose and odom ->
dock/pose, and with dock/goal_pose or ``diffbot dock`` -> cmd_vel. Their parameters are in config/dock.yaml.
"""

from __future__ import annotations

if __name__ == "__main__":  # before the imports that take long: see launcher
    from diffbot_core.launcher import launch

    raise SystemExit(launch("diffbot_control.docking_node"))

from collections.abc import Iterator

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_control.law.docking import Docking
from diffbot_control.robot_node import RobotControllerNode
from diffbot_control.ros.parameters.dock import NO_DOCK
from diffbot_core.errors import InvalidValueError
from diffbot_core.ros.node import run_together

EKF, CONTROLLER = "dock_ekf", "dock_controller"
_IN_MAP = (
    *("pose", "odometry/filtered", "global_pose", "heading", "landmarks", "initialpose"),
    *("goal_pose", "goal_update", "path", "navigate_to_pose", "navigate_through_poses"),
)
"""Topics and actions of the robot's own filter and controller, here of those in the dock's frame."""


def remappings(name: str) -> list[str]:
    """Return the arguments of a node that keep it apart from the one that it is a second copy of."""
    rules = [f"__node:={name}", *(f"{topic}:=dock/{topic}" for topic in _IN_MAP)]
    return ["--ros-args", *(word for rule in rules for word in ("-r", rule))]


def make_nodes() -> Iterator[EkfNode | ControllerNode]:
    """Create the two nodes, the filter first.

    Raises:
        InvalidValueError: if they do not have the parameters of config/dock.yaml.
    """
    ekf = EkfNode(cli_args=remappings(EKF))
    yield ekf
    if ekf.config.dock.dock_detection == NO_DOCK:
        raise InvalidValueError(f"{EKF}: dock_detection", NO_DOCK, "a type of messages, as in config/dock.yaml")
    controller = RobotControllerNode(ekf, cli_args=remappings(CONTROLLER))
    yield controller
    if controller.law.name != Docking.name:
        raise InvalidValueError(f"{CONTROLLER}: law", controller.law.name, f"{Docking.name}, as in config/dock.yaml")


def main(args: list[str] | None = None) -> int:
    """Run both nodes on one executor; return the exit status of the process."""
    return run_together(make_nodes, args, shared_memory=False)
