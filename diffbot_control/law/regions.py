"""Which law is in force: the regions Omega_G (far) and Omega_L (near), and the policies that switch between them."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_core.errors import InvalidValueError
from diffbot_core.ranges import DISTANCE, SIGMAS
from diffbot_core.schema import Spec, known_fields

OMEGA_G = 0
OMEGA_L = 1
REGION_NAMES = ("Omega_G", "Omega_L")

FIXED = 0
COVARIANCE = 1
POLICY_NAMES = ("fixed", "covariance")
"""Words of the parameter ``region_policy``; compiled code compares their indices."""

LEAVE_SIGMAS = 2.0
"""Omega_L is left only for an error beyond the tolerance by so many standard deviations; less is for the finish."""
RETREAT_MARGIN = 1.5
"""Leaving radius per distance that the robot keeps or drives on purpose: lateral error and noise come on top of it."""


class Switching(NamedTuple):
    """The region in force and the memory of the policy; the default is the state at a new goal."""

    region: int = OMEGA_G
    switches: int = 0
    """changes of region so far; entering Omega_L counts as one"""
    steps_outside: int = 0
    """poses in a row beyond the leaving radius (covariance policy)"""


@known_fields
class FixedRegionPolicy(NamedTuple):
    """Omega_L as a circle of constant radius about the goal, with hysteresis.

    The default radius meets the paper's condition with its raw noise: sqrt(0.3^2 + 0.3^2) + 0.065 / 1.3 = 0.474 m.
    """

    eps_P: Annotated[
        float,
        Spec(
            "Omega_L is entered below this distance (region_policy fixed); 0: never, law (13) everywhere",
            "m",
            *DISTANCE,
        ),
    ] = 0.5
    eps_P_leave: Annotated[float, Spec("Omega_L is left above this distance (region_policy fixed)", "m", *DISTANCE)] = (
        0.6
    )

    def check(self) -> None:
        """Refuse a leaving radius below the entering one: the region would flicker.

        Raises:
            InvalidValueError: if it is.
        """
        if self.eps_P_leave < self.eps_P:
            raise InvalidValueError("eps_P_leave", self.eps_P_leave, f">= eps_P = {self.eps_P:g}")


@known_fields
class CovarianceRegionPolicy(NamedTuple):
    """Omega_L with a radius that follows the covariance of the estimate.

    The paper requires eps_P > |eps_rho| + |eps_v| / gamma for the worst errors possible. Here eps_rho is the present
    error of the estimate, ``eps_P_sigmas`` standard deviations, and eps_v is a share of the speed, as an error of
    +-5 % per wheel makes it. The radius shrinks as the filter converges and as the robot slows down, and little is left
    to be corrected when Omega_L is entered.
    """

    eps_P_min: Annotated[float, Spec("smallest radius", "m", *DISTANCE)] = 0.02
    eps_P_sigmas: Annotated[float, Spec("standard deviations of the position that the radius covers", "-", *SIGMAS)] = (
        1.4
    )
    eps_P_speed_error: Annotated[
        float, Spec("bound of the relative error of the speed, |eps_v| / |v|", minimum=0.0, maximum=1.0)
    ] = 0.05
    eps_P_leave_factor: Annotated[
        float, Spec("Omega_L is left beyond this multiple of the radius", minimum=1.0, maximum=1e3)
    ] = 2.0
    eps_P_leave_min: Annotated[
        float, Spec("Omega_L is left only beyond this distance, too, and beyond the position tolerance", "m", *DISTANCE)
    ] = 0.0
    eps_P_leave_steps: Annotated[
        int, Spec("poses in a row beyond both distances after which Omega_L is left", minimum=1, maximum=1000)
    ] = 3


@known_fields
class RegionPolicy(NamedTuple):
    """The policy in use and the settings of each."""

    kind: Annotated[
        int,
        Spec(
            "radius of Omega_L: fixed (eps_P), or following the covariance of the estimate",
            choices=POLICY_NAMES,
            parameter="region_policy",
            replaces=("follow_covariance",),
        ),
    ] = COVARIANCE
    fixed: FixedRegionPolicy = FixedRegionPolicy()
    covariance: CovarianceRegionPolicy = CovarianceRegionPolicy()


def fixed_region(region: int, rho: float, policy: FixedRegionPolicy) -> int:
    """Return the region at distance ``rho`` [m] when ``region`` was the one before."""
    if region == OMEGA_L:
        return OMEGA_L if rho <= policy.eps_P_leave else OMEGA_G
    return OMEGA_L if rho < policy.eps_P else OMEGA_G


def covariance_radius(rho: float, sigma_xy: float, policy: CovarianceRegionPolicy) -> float:
    """Entering radius [m] at distance ``rho`` [m] for a position with standard deviation ``sigma_xy`` [m].

    |eps_v| / gamma is the relative error of the speed times tanh(rho), since |v| <= gamma tanh(rho).
    """
    return max(policy.eps_P_min, policy.eps_P_sigmas * sigma_xy) + policy.eps_P_speed_error * math.tanh(rho)


def covariance_region(
    region: int,
    steps_outside: int,
    rho: float,
    sigma_xy: float,
    policy: CovarianceRegionPolicy,
    floor: float = 0.0,
) -> tuple[int, int, float]:
    """Return the region, the poses in a row outside the leaving radius, and the radius [m] that rho was compared with.

    The leaving radius is at least ``floor`` [m]: sigma_xy shrinks while the robot rests, and an error that is good
    enough must not end Omega_L. Nor must a re-approach, which drives away from the goal on purpose.
    """
    radius = covariance_radius(rho, sigma_xy, policy)
    if region == OMEGA_G:
        return (OMEGA_L if rho < radius else OMEGA_G), 0, radius
    leaving = max(policy.eps_P_leave_factor * radius, policy.eps_P_leave_min, floor)
    steps_outside = steps_outside + 1 if rho > leaving else 0
    if steps_outside >= policy.eps_P_leave_steps:
        return OMEGA_G, 0, leaving
    return OMEGA_L, steps_outside, leaving


def next_switching(
    before: Switching, rho: float, sigma_xy: float, policy: RegionPolicy, floor: float = 0.0
) -> tuple[Switching, float]:
    """Apply the policy in use to one pose.

    Args:
        before: as left by the last pose.
        rho: [m] distance from the goal.
        sigma_xy: [m] standard deviation of the position.
        policy: which one, and its settings.
        floor: [m] least leaving radius of the covariance policy.

    Returns:
        The next state, and the radius [m] at which the region changes from here.
    """
    if policy.kind == COVARIANCE:
        region, steps_outside, radius = covariance_region(
            before.region, before.steps_outside, rho, sigma_xy, policy.covariance, floor
        )
    else:
        region, steps_outside = fixed_region(before.region, rho, policy.fixed), 0
        radius = policy.fixed.eps_P_leave if region == OMEGA_L else policy.fixed.eps_P
    if region != before.region:
        return Switching(region, before.switches + 1, steps_outside), radius
    # Most steps change nothing, and a new tuple costs more time than the policy.
    return before if steps_outside == before.steps_outside else Switching(
        region, before.switches, steps_outside
    ), radius


def smallest_radius(eps_x: float, eps_y: float, eps_v: float, gamma: float) -> float:
    """The bound that eps_P has to exceed: |eps_rho| + |eps_v| / gamma (paper, section 3.2).

    Args:
        eps_x: [m] bound of the error of x.
        eps_y: [m] bound of the error of y; together |eps_rho| <= hypot(eps_x, eps_y).
        eps_v: [m/s] bound of the velocity noise.
        gamma: [m/s].
    """
    return math.hypot(eps_x, eps_y) + eps_v / gamma
