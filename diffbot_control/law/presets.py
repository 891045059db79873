"""Named sets of defaults: ``tuned``, ``precise`` and ``paper``."""

from __future__ import annotations

from typing import Any, NamedTuple

from diffbot_control.law.configuration import PaperConfig, SwitchingConfig
from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.law import Law
from diffbot_control.law.paper import PaperLaw
from diffbot_control.law.switching import SwitchingLaw


class Preset(NamedTuple):
    """A law with its parameters."""

    law: type[Law]
    config: Any
    """instance of the law's Config"""


TUNED, PRECISE, PAPER = "tuned", "precise", "paper"
PRESETS = {
    TUNED: Preset(SwitchingLaw, SwitchingConfig()),
    PRECISE: Preset(SwitchingLaw, SwitchingConfig(tolerance=GoalTolerance(xy_goal_tolerance=0.03))),
    PAPER: Preset(PaperLaw, PaperConfig()),
}
"""``tuned``: the defaults. ``precise``: the defaults with a position tolerance of 0.03 m. ``paper``: the law of the
paper, with its gains and its fixed region."""
