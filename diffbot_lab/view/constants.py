"""Tolerances and limits that the page draws."""

from __future__ import annotations

import math
from typing import Any

from diffbot_control.law.configuration import ControllerConfig


def constants_of(config: ControllerConfig) -> dict[str, Any]:
    """Return tolerances, limits and bounds for the page; None for no limit."""
    sheet, tolerance = config.data_sheet, config.tolerance
    limits = {"v": sheet.v_max, "omega": sheet.omega_max}
    return {
        "xy_tolerance": tolerance.xy_goal_tolerance,
        "yaw_tolerance": tolerance.yaw_goal_tolerance,
        "limits": {name: value if math.isfinite(value) else None for name, value in limits.items()},
    }
