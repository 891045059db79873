"""Entry points of the executables. They import only the launcher, which handles signals during the other imports."""

from __future__ import annotations

from functools import partial

from diffbot_core.launcher import launch

_INTERRUPTED = 130
"""Exit status of a command that SIGINT ended, as shells report it."""

controller_node = partial(launch, "diffbot_control.controller_node")
docking_node = partial(launch, "diffbot_control.docking_node")
ekf_node = partial(launch, "diffbot_control.ekf_node")
plant_node = partial(launch, "diffbot_sim.plant_node")
recorder_node = partial(launch, "diffbot_bag.recorder_node")
replay_node = partial(launch, "diffbot_bag.replay_node")
robot_node = partial(launch, "diffbot_control.robot_node")
diffbot = partial(launch, "diffbot_tools.cli", _INTERRUPTED)
