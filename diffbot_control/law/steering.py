"""The law with braking profiles: law (17) with f(rho) for gamma tanh(rho), phi for k alpha, and either end leading.

Let d be the end of the robot that leads, front (+1) or back (-1), and alpha_d, beta_d the variables of Eq. (2) for it:
alpha and beta, or both turned by pi (the paper's "forward direction is redefined"). With f = f(rho) >= 0:

    Omega_G:  v = f cos(alpha),  omega = phi(alpha_d) + (f / rho) sinc(alpha_d) cos(alpha_d) (alpha_d + h beta_d)
    Omega_L:  v = f cos(alpha),  omega = -phi_L(theta)

V = (rho^2 + alpha_d^2 + h beta_d^2) / 2 changes in Omega_G at -f rho cos^2(alpha) - alpha_d phi(alpha_d) <= 0, for any
f >= 0 and any odd phi in the first and third quadrant; docs/explanation/law.md has the argument with limits.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.law.limits import limit_global, limit_local
from diffbot_control.law.lyapunov_law import sinc
from diffbot_control.law.polar_coordinates import Navigation
from diffbot_control.law.speed_profile import ProfileGains, approach_speed, signed_braking
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import wrap_angle
from diffbot_core.kinematics import Twist

_SMALLEST_DISTANCE = 1e-9
"""[m] f(rho) / rho is taken here at the goal itself"""


UNDECIDED, FRONT, BACK = 0, 1, -1
"""which end of the robot leads"""


class Course(NamedTuple):
    """What is decided once for a goal, and again when Omega_L is left."""

    leading: int = UNDECIDED
    turned: bool = False
    """the robot's heading at the goal is opposite to the goal's (``symmetric_yaw_tolerance``)"""


def chosen_course(navigation: Navigation, allow_backward: bool, symmetric: bool) -> Course:
    """Choose the course with the least turning.

    It takes |alpha_d| to look along the line to the goal, and |beta_d| from there to the heading at the goal.
    """
    rear_alpha, rear_beta = _opposite(navigation.alpha), _opposite(navigation.beta)
    alpha, beta = abs(navigation.alpha), abs(navigation.beta)
    best, leading, turned = alpha + beta, FRONT, False
    if allow_backward and rear_alpha + rear_beta < best:
        best, leading = rear_alpha + rear_beta, BACK
    if symmetric and alpha + rear_beta < best:
        best, leading, turned = alpha + rear_beta, FRONT, True
    if symmetric and allow_backward and rear_alpha + beta < best:
        leading, turned = BACK, True
    return Course(leading, turned)


def _opposite(angle: float) -> float:
    return abs(wrap_angle(angle - math.pi))


def led_by(navigation: Navigation, leading: int) -> Navigation:
    """Return the variables as of the end that leads."""
    if leading != BACK:
        return navigation
    return Navigation(navigation.rho, wrap_angle(navigation.alpha - math.pi), wrap_angle(navigation.beta - math.pi))


def drive_and_steer(
    navigation: Navigation, vagueness: float, leading: int, gains: ProfileGains, data_sheet: DataSheet
) -> Twist:
    """Law of Omega_G within the bounds of the velocities; ``navigation`` is that of the end that leads."""
    rho, alpha, beta = navigation
    cosine = math.cos(alpha)
    speed = approach_speed(rho, vagueness, gains, data_sheet.v_max)
    phi = signed_braking(alpha, gains.turn_brake, gains.turn_react, data_sheet.omega_max)
    turn = speed / max(rho, _SMALLEST_DISTANCE) * cosine * sinc(alpha) * (alpha + gains.bearing_weight * beta)
    command = limit_global(phi, speed * cosine, turn, data_sheet)
    return command if leading != BACK else Twist(-command.v, command.omega)


def turn_to_the_goal(alpha: float, gains: ProfileGains, data_sheet: DataSheet) -> Twist:
    """Stand and turn: where the law of Omega_G would reverse and must not; dV = -alpha phi(alpha) <= 0."""
    phi = signed_braking(alpha, gains.turn_brake, gains.turn_react, data_sheet.omega_max)
    return limit_global(phi, 0.0, 0.0, data_sheet)


def drive_and_hold(
    navigation: Navigation,
    heading_error: float,
    vagueness: float,
    gains: ProfileGains,
    data_sheet: DataSheet,
) -> Twist:
    """Law of Omega_L within the bounds of the velocities; ``heading_error`` [rad] is to become 0."""
    speed = approach_speed(navigation.rho, vagueness, gains, data_sheet.v_max)
    omega = -signed_braking(heading_error, gains.hold_brake, gains.hold_react, data_sheet.omega_max)
    return limit_local(Twist(speed * math.cos(navigation.alpha), omega), data_sheet)


def course_lyapunov(navigation: Navigation, gains: ProfileGains) -> float:
    """V of Omega_G for the end that leads: (rho^2 + alpha_d^2 + h beta_d^2) / 2."""
    rho, alpha, beta = navigation
    return 0.5 * (rho * rho + alpha * alpha + gains.bearing_weight * beta * beta)
