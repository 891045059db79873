"""What both bounds share of CasADi: loading it, the unicycle over one period, constraints and options of the solver."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diffbot_core.data_sheet import DataSheet, rim_speed
from diffbot_core.errors import DiffbotError

Array = NDArray[np.float64]
Row = tuple[Any, float, float]
"""A constraint: expression, lower and upper bound."""

QUIET = {"print_time": False, "expand": True, "ipopt.print_level": 0, "ipopt.sb": "yes"}
"""Options of every solver: expressions expanded to scalars, nothing printed."""

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


def rim_rows(v: Any, omega: Any, sheet: DataSheet) -> list[Row]:
    """Return the constraints that keep both rims of a command within their bound."""
    half, rim = 0.5 * sheet.wheels.wheel_separation, rim_speed(sheet)
    return [(v + sign * half * omega, -rim, rim) for sign in (1.0, -1.0)]


def stacked(casadi: Any, rows: list[Row]) -> tuple[Any, Array, Array]:
    """Return all constraints as one expression (n,), and its lower and upper bounds (n,)."""
    low, high = (np.concatenate([np.full(row[0].numel(), row[side]) for row in rows]) for side in (1, 2))
    return casadi.vertcat(*(row[0] for row in rows)), low, high
