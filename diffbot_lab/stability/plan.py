"""What a certificate is about: the contract of estimate and base, the plan, and what is not covered.

The certificate is about the law *as it requests*: without limits of the acceleration, dead time, lag and dead band. How
far the motion of the base is from the request is part of the contract. With a dead time or a lag the pose is the
coasted one (law/latency.py), which the base moves at once.

The bounds of the estimate may grow with the distance from the goal, as a filter's errors do on the way.

Near the goal, where the measured distance is at most the leaving radius of Omega_L, the certificate uses the switch and
not the law: the base may move in any way that is not faster than the law's largest request there. So Omega_L,
departures from it, and a base that cannot turn at once after a departure are all covered. What the law remembers when
the contract begins to hold may be anything.

Assumptions only: what makes a certificate and what checks it both read them here.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diffbot_control.law.configuration import SwitchingConfig
from diffbot_control.law.regions import LEAVE_FACTOR, OMEGA_L
from diffbot_control.law.steering import (
    Gains,
    drive_and_hold,
    drive_and_steer,
    gains_of,
    led_by,
    navigation_variables,
    uncertainty_ratio,
)
from diffbot_control.law.switching import SwitchingMemory
from diffbot_core.data_sheet import rim_speed
from diffbot_core.errors import InvalidValueError
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate
from diffbot_sim.config import PlantConfig

_PLANT = PlantConfig()


class Contract(NamedTuple):
    """What estimate and base keep in every step, from some step on."""

    eps_position: float = 0.06
    """[m] bound of the distance of the estimated from the true position"""
    eps_theta: float = 0.03
    """[rad]"""
    sigma_max: float = 0.026
    """[m] bound of the standard deviation of the position"""
    wheel_error: float = _PLANT.drive_noise
    """[-] bound of the relative error of each wheel's speed"""
    eps_v: float = 0.0
    """[m/s] distance of the base after a step from where the requested motion ends, per time, beyond the errors of the
    wheels; near the goal by how much the base may be faster than the law's largest request there"""
    eps_omega: float = 0.0
    """[rad/s] difference from the requested rotation, beyond the errors of the wheels; near the goal any rotation is
    allowed"""
    position_slope: float = 0.0
    """[-] growth of ``eps_position`` per metre of distance from the goal"""
    theta_slope: float = 0.0
    """[rad/m] growth of ``eps_theta``"""
    sigma_slope: float = 0.0
    """[-] growth of ``sigma_max``"""

    def at(self, rho: float) -> Contract:
        """Return the contract of a robot that is within a distance ``rho`` [m] of the goal, with constant bounds."""
        return self._replace(
            eps_position=self.eps_position + self.position_slope * rho,
            eps_theta=self.eps_theta + self.theta_slope * rho,
            sigma_max=self.sigma_max + self.sigma_slope * rho,
            position_slope=0.0,
            theta_slope=0.0,
            sigma_slope=0.0,
        )


_OF_ESTIMATE = ("eps_position", "eps_theta", "sigma_max")
"""Bounds that are above 0; those of the base may be 0."""
SLOPES = ("position_slope", "theta_slope", "sigma_slope")
"""How the bounds of _OF_ESTIMATE grow with the distance, in the same order."""


class Plan(NamedTuple):
    """What is certified, and with which cells."""

    contract: Contract = Contract()
    period: float = _PLANT.sampling_time
    """[s] between two poses"""
    to: float = 12.0
    """[m] the robot starts within this distance"""
    margin: float = 0.19
    """[m] by which the core is made larger than Omega_L asks for: progress is slow near it, so a smaller core is
    entered later"""
    fineness: float = 1.0
    """of the cells near the goal; 2 makes them half as large"""

    def at(self, rho: float) -> Plan:
        """Return the plan with the contract of a robot within a distance ``rho`` [m] of the goal."""
        return self._replace(contract=self.contract.at(rho))


_RANGES = {"period": (1e-3, 10.0), "to": (0.1, 1000.0), "margin": (0.0, 10.0), "fineness": (0.1, 10.0)}


def check_number(name: str, value: Any, low: float, high: float) -> None:
    """Refuse what is no number, or out of range.

    Raises:
        InvalidValueError: if it is.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise InvalidValueError(name, value, f"from {low:g} to {high:g}")


def check_plan(plan: Plan) -> None:
    """Refuse a plan with values of the wrong kind or out of range.

    Raises:
        InvalidValueError: naming the first.
    """
    for name, value in plan.contract._asdict().items():
        check_number(name, value, 1e-6 if name in _OF_ESTIMATE else 0.0, 0.999)
    for name, (low, high) in _RANGES.items():
        check_number(name, getattr(plan, name), low, high)


_ROUNDED = 1.001
"""factor by which omega_max may be above what the rims allow, as in rounded data sheets; it is lowered to that"""


class Requests(NamedTuple):
    """The law as it requests: what it would command a base that obeys at once."""

    config: SwitchingConfig
    """without limits of the acceleration, dead time, lag and dead band"""
    gains: Gains
    """those of the robot with its limits and latency"""


def requesting(config: SwitchingConfig, plan: Plan) -> Requests:
    """Return the law of a configuration as it requests.

    Raises:
        InvalidValueError: naming the first parameter that the certificates do not cover.
    """
    sheet, inf = config.data_sheet, math.inf
    _require("allow_backward", config.allow_backward, config.allow_backward, "true")
    symmetric = config.symmetric_yaw_tolerance
    _require("symmetric_yaw_tolerance", symmetric, not symmetric, "false")
    for name in ("v_max", "omega_max", "wheel_max"):
        _require(name, getattr(sheet, name), getattr(sheet, name) < inf, "finite")
    # Bounds that grow as fast as the distance: far out, a pose could count as inside of Omega_L again.
    growth = plan.contract.position_slope + LEAVE_FACTOR * plan.contract.sigma_slope
    _require(f"position_slope + {LEAVE_FACTOR:g} * sigma_slope", round(growth, 3), growth < 1.0, "below 1")
    most = rim_speed(sheet) / (0.5 * sheet.wheels.wheel_separation)
    _require("omega_max", sheet.omega_max, sheet.omega_max <= _ROUNDED * most, f"at most {most:g}")
    obedient = sheet._replace(
        a_max=inf, omega_dot_max=inf, command_latency=0.0, drive_time_constant=0.0, min_velocity=0.0, min_rotation=0.0
    )
    if sheet != obedient:
        for name in ("eps_v", "eps_omega"):
            value = getattr(plan.contract, name)
            _require(name, value, value > 0.0, "above 0 with limits of the acceleration, dead time, lag or dead band")
    slowed = obedient._replace(omega_max=min(sheet.omega_max, most))
    return Requests(config._replace(data_sheet=slowed), gains_of(sheet, plan.period))


def request(requests: Requests, memory: SwitchingMemory, estimate: Estimate) -> Twist:
    """Return what the law requests at an estimate of the (coasted) pose in the goal's frame.

    Args:
        requests: the law as it requests.
        memory: as left by the law's step at this pose: region and course are those in force.
        estimate: of the pose.
    """
    config, gains = requests
    navigation = navigation_variables(estimate.pose)
    ratio = uncertainty_ratio(estimate.uncertainty.xy, config.sigma_known, config.tolerance.xy_goal_tolerance)
    if memory.switching.region == OMEGA_L:
        return drive_and_hold(navigation, estimate.pose.theta, ratio, gains, config.data_sheet)
    leading = memory.course.leading
    return drive_and_steer(led_by(navigation, leading), ratio, leading, gains, config.data_sheet)


def _require(name: str, value: Any, holds: bool, bound: str) -> None:
    if not holds:
        raise InvalidValueError(name, value, f"{bound}, for a certificate")
