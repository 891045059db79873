"""What ``--set`` changes: the paper's noise, the names that are covered, and the bounds of all errors in one step."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from diffbot_control.law.controller import ControllerConfig
from diffbot_core.errors import InvalidValueError
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig

PAPER_NOISE = {
    "drive_noise": 0.0,
    "eps_v_max": 0.065,
    "eps_omega_max": 0.2167,
    "exact_arc": False,
    "linear.x.max_velocity": math.inf,
}
"""The paper's input noise, and no velocity limits; the default measurement noise is the paper's."""


def refuse_others(values: Mapping[str, Any], known: Sequence[str], what: str) -> None:
    """Refuse a parameter that a result does not cover.

    Args:
        values: of ``--set``.
        known: names of the parameters that are covered.
        what: the result, as in "the certificate".

    Raises:
        InvalidValueError: naming the first.
    """
    for name, value in values.items():
        if name not in known:
            raise InvalidValueError(name, value, f"left out, {what} knows only {', '.join(known)}")


class NoiseBox(NamedTuple):
    """Bounds of all errors in one step."""

    eps_x: float
    """[m]"""
    eps_y: float
    """[m]"""
    eps_theta: float
    """[rad]"""
    eps_v: float
    """[m/s]"""
    eps_omega: float
    """[rad/s]"""

    @property
    def eps_position(self) -> float:
        """[m] bound of |eps_rho|: hypot(eps_x, eps_y)."""
        return math.hypot(self.eps_x, self.eps_y)


def noise_box(plant: PlantConfig, sensors: SensorConfig, controller: ControllerConfig) -> NoiseBox:
    """Bounds of one step, a relative wheel error taken at v_max = gamma as the paper does (section 4.1)."""
    at_full_speed = plant.drive_noise * controller.gains.gamma
    return NoiseBox(
        sensors.eps_x_max,
        sensors.eps_y_max,
        sensors.eps_theta_max,
        plant.eps_v_max + at_full_speed,
        plant.eps_omega_max + 2.0 * at_full_speed / plant.wheels.wheel_separation,
    )
