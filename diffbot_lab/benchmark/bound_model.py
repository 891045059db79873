"""What both bounds share of CasADi: loading it, and the unicycle over one period as its expressions."""

from __future__ import annotations

import math
from typing import Any

from diffbot_core.errors import DiffbotError

_TERMS = 10
"""of the series of sin(a) / a: exact to 1e-11 for |a| <= 2.6 rad, half the turn of the longest period"""


def load_casadi() -> Any:
    """Return the module casadi, which only the bounds need.

    Raises:
        DiffbotError: if it is not installed.
    """
    try:
        import casadi  # noqa: PLC0415 - an extra
    except ImportError:
        raise DiffbotError("diffbot benchmark bound needs casadi: pip install 'casadi>=3.6'") from None
    return casadi


def moved(casadi: Any, pose: Any, command: Any, period: Any) -> Any:
    """Return the pose (3,) after ``command`` (2,) was held for ``period`` [s], along the exact arc, as an expression.

    The same arc as in plant.integrate; the heading is not wrapped.
    """
    half = 0.5 * command[1] * period
    square, series = half * half, 0.0
    for index in reversed(range(_TERMS)):
        series = series * square + (-1.0) ** index / math.factorial(2 * index + 1)
    chord, middle = command[0] * period * series, pose[2] + half
    return casadi.vertcat(
        pose[0] + chord * casadi.cos(middle), pose[1] + chord * casadi.sin(middle), pose[2] + 2.0 * half
    )
