"""The executables of this room; this module is light, since it decides what a signal does while a node is imported."""

from __future__ import annotations

from functools import partial

from diffbot_core.launcher import launch

controller_node = partial(launch, "diffbot_control.controller_node")
ekf_node = partial(launch, "diffbot_control.ekf_node")
docking_node = partial(launch, "diffbot_control.docking_node")
robot_node = partial(launch, "diffbot_control.robot_node")
