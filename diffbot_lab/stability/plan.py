"""Assumptions of a certificate: the contract of estimate and base, the plan, and the law that is covered.

A certificate covers the law's *requested* command, which is the command before the limits of the acceleration, dead
time, lag and dead band act on it. The contract bounds how far the motion of the base deviates from the requested
motion. If the base has a dead time or a lag, all poses are coasted poses (law/latency.py), because the request acts on
the coasted pose without delay.

The bounds of the estimate may grow with the distance from the goal, because the errors of a filter are larger during
the drive than at the goal.

Near the goal, where the measured distance is at most the leaving radius of Omega_L, the certificate does not use the
law's command. It only assumes that the base is not faster than the law's largest request there. This covers Omega_L,
departures from Omega_L, and a base that needs time to turn after a departure. The memory of the law may have any
content when the contract begins to hold.

This module contains assumptions only. The maker and the checker of certificates both import it.
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
    in_direction,
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
    """Bounds of the errors of the estimate and of the base. All of them hold in every step from some step on."""

    eps_position: float = 0.06
    """[m] bound of the distance between the estimated and the true position"""
    eps_theta: float = 0.03
    """[rad] bound of the error of the estimated heading"""
    sigma_max: float = 0.026
    """[m] bound of the reported standard deviation of the position"""
    wheel_error: float = _PLANT.drive_noise
    """[-] bound of the relative error of each wheel's speed"""
    eps_v: float = 0.0
    """[m/s] bound of the position error of the base in a step, divided by the period, in addition to ``wheel_error``.
    The position error is the distance from the end of the requested motion. Near the goal, where any motion is allowed,
    the bound is how much faster the base may be than the law's largest request"""
    eps_omega: float = 0.0
    """[rad/s] bound of the error of the rotation, in addition to ``wheel_error``. Near the goal any rotation is
    allowed"""
    position_slope: float = 0.0
    """[-] growth of ``eps_position`` per metre of distance from the goal"""
    theta_slope: float = 0.0
    """[rad/m] growth of ``eps_theta``"""
    sigma_slope: float = 0.0
    """[-] growth of ``sigma_max``"""

    def at(self, rho: float) -> Contract:
        """Return a contract with constant bounds that holds within a distance ``rho`` [m] of the goal."""
        return self._replace(
            eps_position=self.eps_position + self.position_slope * rho,
            eps_theta=self.eps_theta + self.theta_slope * rho,
            sigma_max=self.sigma_max + self.sigma_slope * rho,
            position_slope=0.0,
            theta_slope=0.0,
            sigma_slope=0.0,
        )


_ESTIMATE_BOUNDS = ("eps_position", "eps_theta", "sigma_max")
"""Bounds of the estimate. They must be above 0; the bounds of the base may be 0."""
SLOPES = ("position_slope", "theta_slope", "sigma_slope")
"""Growth of each of the _ESTIMATE_BOUNDS with the distance, in the same order."""


class Plan(NamedTuple):
    """Contract, period and distance of the starts that are certified, and the sizes of the core and of the cells."""

    contract: Contract = Contract()
    period: float = _PLANT.sampling_time
    """[s] between two poses"""
    to: float = 12.0
    """[m] largest distance at which the robot starts"""
    margin: float = 0.19
    """[m] difference between the radius of the core and the smallest radius that Omega_L allows. The robot is slow near
    Omega_L, so a smaller margin gives a smaller core that the robot enters later"""
    fineness: float = 1.0
    """[-] inverse scale of the cells near the goal; 2 halves their size"""

    def at(self, rho: float) -> Plan:
        """Return the plan with the constant contract that holds within a distance ``rho`` [m] of the goal."""
        return self._replace(contract=self.contract.at(rho))


_RANGES = {"period": (1e-3, 10.0), "to": (0.1, 1000.0), "margin": (0.0, 10.0), "fineness": (0.1, 10.0)}


def check_number(name: str, value: Any, low: float, high: float) -> None:
    """Check that a value is a number from ``low`` to ``high``.

    Raises:
        InvalidValueError: if it is not.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise InvalidValueError(name, value, f"from {low:g} to {high:g}")


def check_plan(plan: Plan) -> None:
    """Check that all values of a plan are numbers within their ranges.

    Raises:
        InvalidValueError: naming the first value that is not.
    """
    for name, value in plan.contract._asdict().items():
        check_number(name, value, 1e-6 if name in _ESTIMATE_BOUNDS else 0.0, 0.999)
    for name, (low, high) in _RANGES.items():
        check_number(name, getattr(plan, name), low, high)


_ROUNDED = 1.001
"""largest omega_max, as a multiple of the turn rate that the wheel speeds allow. Because of rounding, a data sheet may
state slightly more than this turn rate; such an omega_max is lowered to it"""


class IdealLaw(NamedTuple):
    """The law of a base that follows every request at once."""

    config: SwitchingConfig
    """without limits of the acceleration, dead time, lag and dead band"""
    gains: Gains
    """gains for the robot with its limits of acceleration"""


def ideal_law(config: SwitchingConfig, plan: Plan) -> IdealLaw:
    """Return the ideal law of a configuration.

    Raises:
        InvalidValueError: naming the first parameter that the certificates do not cover.
    """
    sheet, inf = config.data_sheet, math.inf
    _require("allow_backward", config.allow_backward, config.allow_backward, "true")
    symmetric = config.symmetric_yaw_tolerance
    _require("symmetric_yaw_tolerance", symmetric, not symmetric, "false")
    for name in ("v_max", "omega_max", "wheel_max"):
        _require(name, getattr(sheet, name), getattr(sheet, name) < inf, "finite")
    # If the bounds grew as fast as the distance, a pose far from the goal could count as inside Omega_L.
    growth = plan.contract.position_slope + LEAVE_FACTOR * plan.contract.sigma_slope
    _require(f"position_slope + {LEAVE_FACTOR:g} * sigma_slope", round(growth, 3), growth < 1.0, "below 1")
    rim_limit = rim_speed(sheet) / (0.5 * sheet.wheels.wheel_separation)
    _require("omega_max", sheet.omega_max, sheet.omega_max <= _ROUNDED * rim_limit, f"at most {rim_limit:g}")
    ideal = sheet._replace(
        a_max=inf, omega_dot_max=inf, command_latency=0.0, drive_time_constant=0.0, min_velocity=0.0, min_rotation=0.0
    )
    if sheet != ideal:
        for name in ("eps_v", "eps_omega"):
            value = getattr(plan.contract, name)
            _require(name, value, value > 0.0, "above 0 with limits of the acceleration, dead time, lag or dead band")
    limited = ideal._replace(omega_max=min(sheet.omega_max, rim_limit))
    return IdealLaw(config._replace(data_sheet=limited), gains_of(sheet, plan.period))


def requested_command(law: IdealLaw, memory: SwitchingMemory, estimate: Estimate) -> Twist:
    """Return the requested command at an estimate of the (coasted) pose in the goal's frame.

    Args:
        law: the ideal law.
        memory: memory after the law's step at this pose, with region and direction of travel of this step.
        estimate: estimate of the pose.
    """
    config, gains = law
    navigation = navigation_variables(estimate.pose)
    ratio = uncertainty_ratio(estimate.uncertainty.xy, config.sigma_known, config.tolerance.xy_goal_tolerance)
    if memory.switching.region == OMEGA_L:
        return drive_and_hold(navigation, estimate.pose.theta, ratio, gains, config.data_sheet)
    direction = memory.approach.direction
    return drive_and_steer(in_direction(navigation, direction), ratio, direction, gains, config.data_sheet)


def _require(name: str, value: Any, holds: bool, bound: str) -> None:
    if not holds:
        raise InvalidValueError(name, value, f"{bound}, for a certificate")
