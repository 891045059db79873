"""The executables of this room; this module is light, since it decides what a signal does while a node is imported."""

from __future__ import annotations

from functools import partial

from diffbot_core.launcher import launch

recorder_node = partial(launch, "diffbot_bag.recorder_node")
replay_node = partial(launch, "diffbot_bag.replay_node")
