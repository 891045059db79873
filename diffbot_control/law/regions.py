"""The regions Omega_G (far) and Omega_L (near) of the switching law, and the conditions for a change.

The paper requires eps_P > |eps_rho| + |eps_v| / gamma for the worst errors possible (section 3.2). With its raw noise
this gives a fixed circle, see :mod:`paper`. Here the radius follows the current standard deviation of the position. The
radius shrinks as the filter converges, so the error is small when the robot enters Omega_L.

In Omega_L every (0, y, 0) is an equilibrium, so a lateral error remains. The estimate of this error improves while the
robot rests. If the error is significant after the time REST, the robot leaves Omega_L and approaches the goal again
with the law of Omega_G. The Lyapunov functions do not cover these departures, so ``MAX_DEPARTURES`` bounds their
number.
"""

from __future__ import annotations

from typing import NamedTuple

from diffbot_control.law.goal_checker import GoalTolerance, is_at_rest, is_off
from diffbot_core.data_sheet import DataSheet
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Uncertainty

OMEGA_G, OMEGA_L = 0, 1
REGION_NAMES = ("Omega_G", "Omega_L")

LEAST_RADIUS = 0.2
"""Smallest entering radius as a share of the position tolerance; the radius is also at least one standard deviation."""
LEAVE_FACTOR = 3.0
"""Leaving radius as a multiple of the entering radius; it is at least the position tolerance."""
REST = 1.0
"""[s] time at rest after which the robot leaves Omega_L, if the goal is not reached and the error is significant"""
MAX_DEPARTURES = 20
"""Largest number of departures from Omega_L for one goal; the benchmarks have at most 12, with correlated fixes."""


class Switching(NamedTuple):
    """The region, and how long the robot has rested in it."""

    region: int
    switches: int
    """number of changes of the region for this goal"""
    rest: float
    """[s] uninterrupted time at rest in Omega_L with the heading within its tolerance"""


class SwitchInput(NamedTuple):
    """State on which the region depends, besides the uncertainty."""

    rho: float
    """[m] distance of the goal"""
    theta: float
    """[rad] heading in the goal's frame"""
    command: Twist
    """the last command"""
    reached: bool
    """the goal counts as reached"""


def entering_radius(sigma_xy: float, tolerance: GoalTolerance) -> float:
    """Return eps_P [m] for a position with standard deviation ``sigma_xy`` [m]."""
    return max(LEAST_RADIUS * tolerance.xy_goal_tolerance, sigma_xy)


def leaving_radius(sigma_xy: float, tolerance: GoalTolerance) -> float:
    """Return the distance [m] beyond which the robot leaves Omega_L at once."""
    return max(LEAVE_FACTOR * entering_radius(sigma_xy, tolerance), tolerance.xy_goal_tolerance)


def next_switching(
    before: Switching,
    present: SwitchInput,
    uncertainty: Uncertainty,
    dt: float,
    tolerance: GoalTolerance,
    data_sheet: DataSheet,
) -> tuple[Switching, float]:
    """Return the region at the next pose, and the distance [m] from the goal at which the region changes.

    Args:
        before: region at the last pose.
        present: distance and heading at this pose, and the last command.
        uncertainty: uncertainty of the estimate.
        dt: [s] since the last pose.
        tolerance: tolerances of the goal.
        data_sheet: thresholds of rest.
    """
    rho, entering = present.rho, entering_radius(uncertainty.xy, tolerance)
    leaving = leaving_radius(uncertainty.xy, tolerance)
    if before.region == OMEGA_G:
        if rho < entering:
            return Switching(OMEGA_L, before.switches + 1, 0.0), leaving
        return before, entering
    rest = 0.0
    if abs(present.theta) <= tolerance.yaw_goal_tolerance and is_at_rest(present.command, data_sheet):
        rest = before.rest + dt
    if rest >= REST and not present.reached and is_off(rho, tolerance, uncertainty):
        leaving = entering
    if rho > leaving:
        return Switching(OMEGA_G, before.switches + 1, 0.0), entering
    return Switching(OMEGA_L, before.switches, rest), leaving
