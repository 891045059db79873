"""What a certificate is about: the contract of estimate and base, the plan, and what is not covered.

The certificate is about the law *as it requests*: with the gains in force, without a limit of the acceleration, dead
time, lag or dead band. How far the base is from that is part of the contract. With a dead time or a lag the pose is the
coasted one (law/latency.py), which the base moves at once.

The bounds of the estimate may grow with the distance from the goal, as a filter's errors do on the way.

In Omega_L the heading is known well enough for the goal to be reached (``knowable_heading``), and no leg of the
finish is being driven when the contract begins to hold: a V that was begun before goes out as far as the deviations of
that time asked for. All else that the law remembers may be anything.

Assumptions only: what makes a certificate and what checks it both read them here.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diffbot_control.law.braking_step import gains_in_force
from diffbot_control.law.configuration import BRAKING, GIVEN, ControllerConfig
from diffbot_control.law.regions import COVARIANCE, LEAVE_SIGMAS
from diffbot_core.data_sheet import rim_speed
from diffbot_core.errors import InvalidValueError
from diffbot_lab.stability.result_file import check_number
from diffbot_sim.model.plant import PlantConfig

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
    wheels; in Omega_L any motion is allowed that is faster than the legs of the finish by no more than that"""
    eps_omega: float = 0.0
    """[rad/s] difference from the requested rotation, beyond the errors of the wheels; in Omega_L any rotation is
    allowed that is faster than ``omega_max`` by no more than that"""
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
    margin: float = 0.01
    """[m] by which the core is made larger than Omega_L asks for, where the cells do not suffice"""
    fineness: float = 1.0
    """of the cells near the goal; 2 makes them half as large"""

    def at(self, rho: float) -> Plan:
        """Return the plan with the contract of a robot within a distance ``rho`` [m] of the goal."""
        return self._replace(contract=self.contract.at(rho))


_RANGES = {"period": (1e-3, 10.0), "to": (0.1, 1000.0), "margin": (0.0, 10.0), "fineness": (0.1, 10.0)}


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


def requesting(config: ControllerConfig, plan: Plan) -> ControllerConfig:
    """Return the configuration of the law as it requests, with the gains in force and a base that obeys at once.

    Raises:
        InvalidValueError: naming the first parameter that the certificates do not cover.
    """
    sheet, inf = config.data_sheet, math.inf
    _require("speed_profile", config.profile, config.profile == BRAKING, "braking")
    _require("region_policy", config.region_policy.kind, config.region_policy.kind == COVARIANCE, "covariance")
    _require("allow_backward", config.driving.allow_backward, config.driving.allow_backward, "true")
    symmetric = config.driving.symmetric_yaw_tolerance
    _require("symmetric_yaw_tolerance", symmetric, not symmetric, "false")
    _require("uncertainty_scale", config.uncertainty_scale, config.uncertainty_scale == 1.0, "1")
    _require("finish_wait", config.finish.finish_wait, config.finish.finish_wait > 0.0, "above 0")
    for name in ("v_max", "omega_max", "wheel_max"):
        _require(name, getattr(sheet, name), getattr(sheet, name) < inf, "finite")
    _check_slopes(config, plan.contract)
    most = rim_speed(sheet) / (0.5 * sheet.wheels.wheel_separation)
    _require("omega_max", sheet.omega_max, sheet.omega_max <= _ROUNDED * most, f"at most {most:g}")
    obedient = sheet._replace(
        a_max=inf, omega_dot_max=inf, command_latency=0.0, drive_time_constant=0.0, min_velocity=0.0, min_rotation=0.0
    )
    if sheet != obedient:
        for name in ("eps_v", "eps_omega"):
            value = getattr(plan.contract, name)
            _require(name, value, value > 0.0, "above 0 with limits of the acceleration, dead time, lag or dead band")
    return config._replace(
        profile_gains=gains_in_force(config, plan.period),
        gain_source=GIVEN,
        data_sheet=obedient._replace(omega_max=min(sheet.omega_max, most)),
    )


def _check_slopes(config: ControllerConfig, contract: Contract) -> None:
    """Refuse bounds that grow as fast as the distance: far out, a pose could count as inside of Omega_L again."""
    policy = config.region_policy.covariance
    # A part of the leaving radius grows with the distance; near.py refuses one that grows as fast as that or faster.
    growing = policy.eps_P_leave_factor * policy.eps_P_speed_error
    if growing < 1.0:
        sigmas = max(LEAVE_SIGMAS, policy.eps_P_leave_factor * policy.eps_P_sigmas / (1.0 - growing))
        growth = contract.position_slope + sigmas * contract.sigma_slope
        _require(f"position_slope + {sigmas:.3g} * sigma_slope", round(growth, 3), growth < 1.0, "below 1")


def _require(name: str, value: Any, holds: bool, bound: str) -> None:
    if not holds:
        raise InvalidValueError(name, value, f"{bound}, for a certificate")
