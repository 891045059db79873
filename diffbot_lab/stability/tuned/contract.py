"""What a certificate of the tuned law is about: the contract of the estimate, the plan, and what it does not cover.

The heading is known well enough in every step for the goal to be reached (``knowable_heading``): otherwise a V of the
finish may go out as far as its standard deviations ask for.

Assumptions only: what makes a certificate and what checks it both read them here.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diffbot_control.law.configuration import BRAKING, GIVEN, ControllerConfig
from diffbot_control.law.regions import COVARIANCE
from diffbot_core.data_sheet import rim_speed
from diffbot_core.errors import InvalidValueError
from diffbot_sim.model.plant import PlantConfig

PLANT = PlantConfig()
"""The robot and its input noise; a file does not change them."""


class Contract(NamedTuple):
    """What the estimate keeps in every step."""

    eps_position: float = 0.06
    """[m] bound of the distance of the estimated from the true position"""
    eps_theta: float = 0.03
    """[rad]"""
    sigma_max: float = 0.026
    """[m] bound of the standard deviation of the position"""


class Plan(NamedTuple):
    """What is certified, and with which cells."""

    contract: Contract = Contract()
    to: float = 12.0
    """[m] the robot starts within this distance"""
    margin: float = 0.01
    """[m] by which the core is made larger than Omega_L asks for, where the cells do not suffice"""
    fineness: float = 1.0
    """of the cells near the goal; 2 makes them half as large"""


def check_plan(plan: Plan) -> None:
    """Refuse a plan with values of the wrong kind or out of range.

    Raises:
        InvalidValueError: naming the first.
    """
    for name, value in plan.contract._asdict().items():
        holds = isinstance(value, (int, float)) and not isinstance(value, bool) and 1e-6 <= value < 1.0
        _require(name, value, holds, "from 1e-6 to below 1")
    for name, low, high in (("to", 0.1, 1000.0), ("margin", 0.0, 10.0), ("fineness", 0.1, 10.0)):
        value = getattr(plan, name)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
            raise InvalidValueError(name, value, f"from {low:g} to {high:g}")


def check_covered(config: ControllerConfig) -> None:
    """Refuse a configuration that the certificates do not cover.

    Raises:
        InvalidValueError: naming the first parameter.
    """
    sheet, inf = config.data_sheet, math.inf
    _require("speed_profile", config.profile, config.profile == BRAKING, "braking")
    _require("region_policy", config.region_policy.kind, config.region_policy.kind == COVARIANCE, "covariance")
    _require("allow_backward", config.driving.allow_backward, config.driving.allow_backward, "true")
    _require("gains", config.gain_source, config.gain_source == GIVEN, "preset")
    symmetric = config.driving.symmetric_yaw_tolerance
    _require("symmetric_yaw_tolerance", symmetric, not symmetric, "false")
    _require("uncertainty_scale", config.uncertainty_scale, config.uncertainty_scale == 1.0, "1")
    _require("finish_wait", config.finish.finish_wait, config.finish.finish_wait > 0.0, "above 0")
    for name in ("a_max", "omega_dot_max"):
        _require(name, getattr(sheet, name), getattr(sheet, name) == inf, "inf: no limit of the acceleration")
    for name in ("command_latency", "drive_time_constant", "min_velocity", "min_rotation"):
        _require(name, getattr(sheet, name), getattr(sheet, name) == 0.0, "0")
    for name in ("v_max", "omega_max", "wheel_max"):
        _require(name, getattr(sheet, name), getattr(sheet, name) < inf, "finite")
    rim, half = rim_speed(sheet), 0.5 * sheet.wheels.wheel_separation
    _require("omega_max", sheet.omega_max, half * sheet.omega_max <= rim, f"at most {rim / half:g}")


def _require(name: str, value: Any, holds: bool, bound: str) -> None:
    if not holds:
        raise InvalidValueError(name, value, f"{bound}, for a certificate")
