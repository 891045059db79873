"""Curves of the page, and the columns of each curve."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Columns = dict[str, Array]
"""Columns of equal length (n,) by name; ``t`` [s] is the time."""

FILTER_COLUMNS = ("nis", "nis_low", "nis_high", "whiteness", "whiteness_bound", "left", "right")
"""Mean NIS per measured number with 95 % bounds, autocorrelation with its bound, errors of both wheel radii."""
COLUMNS: dict[str, tuple[str, ...]] = {
    "estimate": ("t", "x", "y", "theta", "xx", "xy", "yy", "tt", "xt", "yt"),
    "truth": ("t", "x", "y", "theta", "v", "omega", "tt"),
    "odometry": ("t", "x", "y", "theta", "v", "omega"),
    "fixes": ("t", "x", "y", "theta"),
    "residual": ("t", "x", "y", "theta"),
    "to_goal": ("t", "distance", "heading"),
    "docking": ("t", "x", "y", "theta"),
    "command": ("t", "v", "omega"),
    "law": ("t", "rho", "alpha", "beta", "eps_P", "region", "V"),
    "filter": ("t", *FILTER_COLUMNS),
}
"""Columns of each curve by its name; ``docking`` is the robot in the frame of the dock."""
