"""The plain values of a campaign, in a module of their own so that the command line can list them without numba."""

from __future__ import annotations

import sys
from typing import Annotated, Any, NamedTuple

from diffbot_core.errors import InvalidValueError
from diffbot_core.ranges import POSITION
from diffbot_core.schema import Spec
from diffbot_sim.feedback import EKF, FEEDBACKS


class CampaignOptions(NamedTuple):
    """The plain values of a campaign; the same names in YAML and as flags."""

    runs: Annotated[int, Spec("runs of each cell", minimum=1, maximum=10**9)] = 1000
    seed: Annotated[int, Spec("seed of all noise", minimum=0, maximum=2**63 - 1)] = 1
    duration: Annotated[float, Spec("length of each run", "s", minimum=1e-3, maximum=1e5)] = 60.0
    feedback: Annotated[str, Spec("what the controller sees", choices=FEEDBACKS)] = EKF
    law: Annotated[str, Spec("law that drives: a registered name, or package.module:Class")] = "switching"
    goal: Annotated[tuple[float, ...], Spec("x, y, heading of the goal in map", "m, m, rad", *POSITION)] = (0.0,) * 3
    chunk: Annotated[
        int, Spec("runs that a worker does at a time; 0: about a second's work", minimum=0, maximum=10**9)
    ] = 0

    def check(self) -> None:
        """Refuse a goal that is no triple.

        Raises:
            InvalidValueError: if it is not.
        """
        triple("goal", self.goal)


def is_number(value: Any) -> bool:
    """Return True if a value from YAML is a finite number."""
    # By comparison: an integer may be too large to convert to a float.
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def is_coordinate(value: Any) -> bool:
    """Return True if a value from YAML is a number in the range of positions, which serves headings, too."""
    return is_number(value) and POSITION[0] <= value <= POSITION[1]


def triple(name: str, value: Any) -> tuple[float, float, float]:
    """Return a value from YAML as three numbers.

    Raises:
        InvalidValueError: naming ``name`` if it is anything else.
    """
    if not isinstance(value, (list, tuple)) or len(value) != 3 or not all(map(is_coordinate, value)):
        raise InvalidValueError(name, value, f"three numbers x, y, heading within +-{POSITION[1]:g}")
    return float(value[0]), float(value[1]), float(value[2])
