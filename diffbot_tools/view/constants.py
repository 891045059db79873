"""Tolerances, limits and size of a robot for the page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from scipy.special import chdtri

from diffbot_bag.bag import Parameters
from diffbot_control.law.configuration import SwitchingConfig
from diffbot_core.kinematics import WheelGeometry
from diffbot_core.schema import build, parameters_of

NEES_BOUNDS = tuple(float(chdtri(3, tail)) for tail in (0.975, 0.025))
"""95 % bounds of the NEES of a consistent estimate of x, y and theta."""


def constants_of(config: SwitchingConfig, wheels: WheelGeometry | None = None) -> dict[str, Any]:
    """Return tolerances, limits and size of the robot; None stands for an infinite limit or an unknown size."""
    sheet, tolerance = config.data_sheet, config.tolerance
    limits = {"v": sheet.v_max, "omega": sheet.omega_max}
    if wheels is not None:
        limits["rim"] = sheet.wheel_max * wheels.wheel_radius
    return {
        "xy_tolerance": tolerance.xy_goal_tolerance,
        "yaw_tolerance": tolerance.yaw_goal_tolerance,
        "limits": {name: value if math.isfinite(value) else None for name, value in limits.items()},
        "wheels": None if wheels is None else list(wheels),
        "nees": NEES_BOUNDS,
    }


def recorded_config(parameters: Mapping[str, Any]) -> SwitchingConfig:
    """Return the configuration of a controller from its recorded parameters, with defaults for missing parameters.

    Raises:
        InvalidValueError: if a parameter is out of its bounds.
    """
    own = {one.name: parameters[one.name] for one in parameters_of(SwitchingConfig) if one.name in parameters}
    # The recorder writes infinity as text, since JSON cannot represent it.
    own = {name: math.inf if value == "inf" else value for name, value in own.items()}
    return build(SwitchingConfig, own)


def recorded_wheels(parameters: Parameters, namespace: str) -> WheelGeometry | None:
    """Return the wheels from the recorded parameters of any node of a robot; None if no node has them.

    Raises:
        InvalidValueError: if a size is out of its bounds.
    """
    for node, values in parameters.items():
        if node.rpartition("/")[0] == namespace and "wheel_separation" in values:
            names = [name for name in WheelGeometry._fields if name in values]
            return build(WheelGeometry, {name: values[name] for name in names})
    return None
