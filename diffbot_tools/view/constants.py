"""Tolerances and limits that the page draws."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from diffbot_control.law.configuration import ControllerConfig
from diffbot_control.law.presets import PRESETS, TUNED
from diffbot_core.schema import build, parameters_of


def constants_of(config: ControllerConfig) -> dict[str, Any]:
    """Return tolerances, limits and bounds for the page; None for no limit."""
    sheet, tolerance = config.data_sheet, config.tolerance
    limits = {"v": sheet.v_max, "omega": sheet.omega_max}
    return {
        "xy_tolerance": tolerance.xy_goal_tolerance,
        "yaw_tolerance": tolerance.yaw_goal_tolerance,
        "limits": {name: value if math.isfinite(value) else None for name, value in limits.items()},
    }


def recorded_config(parameters: Mapping[str, Any]) -> ControllerConfig:
    """Return the configuration of a controller by the parameters in a bag; what they lack is that of ``tuned``.

    Raises:
        InvalidValueError: if one is out of its bounds.
    """
    own = {one.name: parameters[one.name] for one in parameters_of(ControllerConfig) if one.name in parameters}
    # JSON has no infinity: the recorder writes it as a text.
    own = {name: math.inf if value == "inf" else value for name, value in own.items()}
    return build(ControllerConfig, own, PRESETS[TUNED])
