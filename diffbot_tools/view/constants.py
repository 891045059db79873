"""Tolerances and limits that the page draws."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from diffbot_bag.mcap.attachments import Parameters
from diffbot_control.law.configuration import ControllerConfig
from diffbot_control.law.presets import PRESETS, TUNED
from diffbot_core.kinematics import WheelGeometry
from diffbot_core.schema import build, parameters_of


def constants_of(config: ControllerConfig, wheels: WheelGeometry | None = None) -> dict[str, Any]:
    """Return tolerances, limits and the size of the robot for the page; None for no limit and for an unknown size."""
    sheet, tolerance = config.data_sheet, config.tolerance
    limits = {"v": sheet.v_max, "omega": sheet.omega_max}
    if wheels is not None:
        limits["rim"] = sheet.wheel_max * wheels.wheel_radius
    return {
        "xy_tolerance": tolerance.xy_goal_tolerance,
        "yaw_tolerance": tolerance.yaw_goal_tolerance,
        "limits": {name: value if math.isfinite(value) else None for name, value in limits.items()},
        "wheels": None if wheels is None else list(wheels),
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


def recorded_wheels(parameters: Parameters, namespace: str) -> WheelGeometry | None:
    """Return the wheels that a bag's parameters name for a robot, of whichever node; None without any.

    Raises:
        InvalidValueError: if a size is out of its bounds.
    """
    for node, values in parameters.items():
        if node.rpartition("/")[0] == namespace and "wheel_separation" in values:
            names = [name for name in WheelGeometry._fields if name in values]
            return build(WheelGeometry, {name: values[name] for name in names})
    return None
