"""Which law is in force: the regions Omega_G (far) and Omega_L (near), and the policies that switch between them."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import Spec

OMEGA_G = 0
OMEGA_L = 1
REGION_NAMES = ("Omega_G", "Omega_L")

_WAY_BACK_ROOM = 1.5
"""Ways back that a re-approach may be away from the goal: the lateral error and noise come on top of the way."""


class FixedRegion(NamedTuple):
    """Omega_L as a circle of constant radius about the goal, with hysteresis.

    The default radius meets the paper's condition with its raw noise: sqrt(0.3^2 + 0.3^2) + 0.065 / 1.3 = 0.474 m.
    """

    eps_P: Annotated[
        float, Spec("Omega_L is entered below this distance; 0: never, law (13) everywhere", "m", minimum=0.0)
    ] = 0.5
    eps_P_leave: Annotated[float, Spec("Omega_L is left above this distance", "m", minimum=0.0)] = 0.6

    def check(self) -> None:
        """Refuse a leaving radius below the entering one: the region would flicker.

        Raises:
            InvalidValueError: if it is.
        """
        if self.eps_P_leave < self.eps_P:
            raise InvalidValueError("eps_P_leave", self.eps_P_leave, f">= eps_P = {self.eps_P:g}")


def fixed_region(region: int, rho: float, policy: FixedRegion) -> int:
    """Return the region at distance ``rho`` [m] when ``region`` was the one before."""
    if region == OMEGA_L:
        return OMEGA_L if rho <= policy.eps_P_leave else OMEGA_G
    return OMEGA_L if rho < policy.eps_P else OMEGA_G


class CovarianceRegion(NamedTuple):
    """Omega_L with a radius that follows the filter's covariance.

    The paper asks for eps_P > |eps_rho| + |eps_v| / gamma with the worst errors there may be. Here eps_rho is the error
    that the filter has now, ``eps_P_sigmas`` standard deviations, and eps_v is a share of the speed, as +-5 % per wheel
    makes it: the radius shrinks as the filter converges and as the robot slows down, and little is left to be
    corrected when Omega_L is entered.
    """

    follow_covariance: Annotated[bool, Spec("let the radius follow the covariance; otherwise eps_P is fixed")] = False
    eps_P_min: Annotated[float, Spec("smallest radius", "m", minimum=0.0)] = 0.02
    eps_P_sigmas: Annotated[float, Spec("standard deviations of the position that the radius covers", minimum=0.0)] = (
        2.2
    )
    eps_P_speed_error: Annotated[
        float, Spec("bound of the relative error of the speed, |eps_v| / |v|", minimum=0.0, maximum=1.0)
    ] = 0.05
    eps_P_leave_factor: Annotated[float, Spec("Omega_L is left above so many radii ...", minimum=1.0)] = 3.0
    eps_P_leave_min: Annotated[float, Spec("... and not below this distance", "m", minimum=0.0)] = 0.3
    eps_P_leave_steps: Annotated[int, Spec("... in so many poses in a row", minimum=1, maximum=1000)] = 3


def covariance_radius(rho: float, sigma_xy: float, policy: CovarianceRegion) -> float:
    """Entering radius [m] at distance ``rho`` [m] with the position known to ``sigma_xy`` [m] (one standard deviation).

    |eps_v| / gamma is the relative error of the speed times tanh(rho), since |v| <= gamma tanh(rho).
    """
    return max(policy.eps_P_min, policy.eps_P_sigmas * sigma_xy) + policy.eps_P_speed_error * math.tanh(rho)


def covariance_region(
    region: int,
    steps_outside: int,
    rho: float,
    sigma_xy: float,
    policy: CovarianceRegion,
    retreat_distance: float = 0.0,
) -> tuple[int, int, float]:
    """Return the region, the poses in a row outside the leaving radius, and the radius [m] that was compared with.

    The leaving radius has a floor: sigma_xy shrinks while the robot rests, and a residue that was inside when it came
    must not throw it out. Nor must a re-approach, which goes ``retreat_distance`` [m] away from the goal on purpose.
    """
    radius = covariance_radius(rho, sigma_xy, policy)
    if region == OMEGA_G:
        return (OMEGA_L if rho < radius else OMEGA_G), 0, radius
    leaving = max(policy.eps_P_leave_factor * radius, policy.eps_P_leave_min, _WAY_BACK_ROOM * retreat_distance)
    steps_outside = steps_outside + 1 if rho > leaving else 0
    if steps_outside >= policy.eps_P_leave_steps:
        return OMEGA_G, 0, leaving
    return OMEGA_L, steps_outside, leaving


def forward_only(policy: CovarianceRegion, xy_goal_tolerance: float) -> CovarianceRegion:
    """Return the policy for a robot that may not reverse, and so cannot re-approach.

    It has to leave Omega_L with any error that the goal does not allow: standing there it could do nothing about it.
    """
    return CovarianceRegion(
        policy.follow_covariance,
        policy.eps_P_min,
        policy.eps_P_sigmas,
        policy.eps_P_speed_error,
        policy.eps_P_leave_factor,
        min(policy.eps_P_leave_min, xy_goal_tolerance),
        policy.eps_P_leave_steps,
    )


def smallest_radius(eps_x: float, eps_y: float, eps_v: float, gamma: float) -> float:
    """The bound that eps_P has to exceed: |eps_rho| + |eps_v| / gamma (paper, section 3.2).

    Args:
        eps_x: [m] bound of the error of x.
        eps_y: [m] bound of the error of y; together |eps_rho| <= hypot(eps_x, eps_y).
        eps_v: [m/s] bound of the velocity noise.
        gamma: [m/s].
    """
    return math.hypot(eps_x, eps_y) + eps_v / gamma
