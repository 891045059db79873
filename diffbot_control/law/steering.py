"""The two laws of :mod:`switching`: drive and steer far from the goal, drive and hold the heading near the goal.

The navigation variables are defined by Eq. (2) of the paper. *Braking profiles* replace the paper's gamma tanh(rho) and
k alpha. A braking profile is the largest speed s from which the robot stops within a distance d, if it reacts after the
time tau and then brakes with the deceleration b:

    d = s tau + s^2 / (2 b)    so    s(d; b, tau) = 2 d / (tau + sqrt(tau^2 + 2 d / b))

Near 0 the slope of the profile is 1 / tau, a proportional gain. Far away the profile is sqrt(2 b d), which requires the
deceleration b. Let f(rho) be the profile of the speed and phi(alpha) the profile of the turn. Both are odd functions.

    Omega_G:  v = f(rho) cos(alpha),  omega = phi(alpha) + (f(rho) / rho) cos(alpha) sinc(alpha) (alpha + h beta)
    Omega_L:  v = f(rho) cos(alpha),  omega = -phi_L(theta)

    V_G = (rho^2 + alpha^2 + h beta^2) / 2   with   dV_G = -rho f cos^2(alpha) - alpha phi(alpha) <= 0
    V_L = (rho^2 + theta^2) / 2              with   dV_L = -rho f cos^2(alpha) - theta phi_L(theta) <= 0

The weight h(rho) = h min(1, rho / 0.3 m) fades near the goal, so that the robot drives straight to the goal point and
turns there in Omega_L. The change of the weight adds h' rho' beta^2 / 2 to dV_G. This is <= 0, because rho' <= 0 and h'
>= 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.law.limits import limit_global, limit_local
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist

HALF_PI = 0.5 * math.pi
_SERIES = 1e-4
"""[rad] below this angle sin(a) / a is computed from its series, which is exact to the last bit there"""
BEARING_WEIGHT = 0.8
"""h, the weight of beta in Omega_G"""
BEARING_FADE = 0.3
"""[m] distance below which h fades"""
ARRIVAL_SHARE = 0.3
"""required deviation of the position at arrival, as a share of xy_goal_tolerance"""
BRAKE, TURN_BRAKE, HOLD_BRAKE = 3.0, 7.0, 5.0
"""[m/s^2], [rad/s^2], [rad/s^2] largest decelerations of the braking profiles of the speed, the turn and the heading"""
_BRAKE_SHARE, _TURN_BRAKE_SHARE = 0.86, 0.65
"""shares of the acceleration limits that the profiles use; the rest is for errors of the estimate and of the drives"""
_UNKNOWN_LATENCY = 0.2
"""[s] dead time missing in the data sheet with which the loop is still stable"""
_DRIVE_LOOPS, _TURN_LOOPS, _HOLD_LOOPS = 2.0, 1.8, 1.6
"""reaction times as multiples of the loop's delay; the loop is stable above 2 / pi"""
_SMALLEST_DISTANCE = 1e-9
"""[m] lower bound of rho in f(rho) / rho"""


class Navigation(NamedTuple):
    """Position of the goal relative to the robot."""

    rho: float
    """[m] distance of the goal"""
    alpha: float
    """[rad] bearing of the goal in the robot's frame, in (-pi, pi]"""
    beta: float
    """[rad] bearing of the goal in the goal's frame, in (-pi, pi]; the heading is theta = beta - alpha"""


def navigation_variables(pose: Pose) -> Navigation:
    """Return the variables of Eq. (2) for a pose in the goal's frame, i.e. with the goal at (0, 0, 0).

    At the goal itself (rho = 0) beta is 0, so alpha is -theta.
    """
    # 0.0 - x, not -x: atan2(-0.0, -0.0) is -pi, and beta at the goal would flip.
    dx = 0.0 - pose.x
    dy = 0.0 - pose.y
    beta = wrap_angle(math.atan2(dy, dx))
    return Navigation(math.hypot(dx, dy), wrap_angle(beta - pose.theta), beta)


def in_front(alpha: float) -> bool:
    """Return True if the goal is in the front sector, alpha in (-pi/2, pi/2].

    Eq. (4) excludes pi/2 and Eq. (6) includes it; this function follows (6).
    """
    return -HALF_PI < alpha <= HALF_PI


def sinc(angle: float) -> float:
    """Return sin(angle) / angle, which is 1 at 0."""
    if abs(angle) < _SERIES:
        return 1.0 - angle * angle / 6.0
    return math.sin(angle) / angle


class Gains(NamedTuple):
    """Decelerations and reaction times of the braking profiles.

    1 / ``turn_react`` and 1 / ``hold_react`` are the paper's k and k_2 near 0.
    """

    brake: float
    """[m/s^2] deceleration of the speed"""
    react: float
    """[s] reaction time of the speed"""
    turn_brake: float
    """[rad/s^2] of the turn towards the goal in Omega_G"""
    turn_react: float
    """[s] of the turn towards the goal in Omega_G"""
    hold_brake: float
    """[rad/s^2] of the heading in Omega_L"""
    hold_react: float
    """[s] of the heading in Omega_L"""


def gains_of(data_sheet: DataSheet, period: float) -> Gains:
    """Derive the gains from the limits of the robot and the period [s] of its poses.

    The delay of the loop is half a period, the mean age of a command that is held, plus 0.2 s. The 0.2 s allow for dead
    time that is missing in the data sheet, so that the law does not predict over it.
    """
    loop = 0.5 * period + _UNKNOWN_LATENCY
    turning = _TURN_BRAKE_SHARE * data_sheet.omega_dot_max
    return Gains(
        min(BRAKE, _BRAKE_SHARE * data_sheet.a_max),
        _DRIVE_LOOPS * loop,
        min(TURN_BRAKE, turning),
        _TURN_LOOPS * loop,
        min(HOLD_BRAKE, turning),
        _HOLD_LOOPS * loop,
    )


def braking(distance: float, brake: float, react: float) -> float:
    """Return the largest speed s with s^2 / (2 brake) + s react <= ``distance`` >= 0, in any unit (also rad)."""
    return 2.0 * distance / (react + math.sqrt(react * react + 2.0 * distance / brake))


def signed_braking(error: float, brake: float, react: float, largest: float) -> float:
    """Return phi(a) = sign(a) min(largest, s(|a|)): odd, and phi(a) a >= 0."""
    return math.copysign(min(largest, braking(abs(error), brake, react)), error)


def uncertainty_ratio(sigma_xy: float, sigma_known: float, xy_goal_tolerance: float) -> float:
    """Return ``sigma_xy`` [m] divided by the deviation that is required at arrival, which grows with the tolerance."""
    return sigma_xy / max(sigma_known, ARRIVAL_SHARE * xy_goal_tolerance)


def approach_speed(rho: float, ratio: float, gains: Gains, v_max: float) -> float:
    """Return f(rho) [m/s] >= 0 with f(0) = 0; an :func:`uncertainty_ratio` above 1 reduces the speed."""
    react = gains.react * ratio * ratio if ratio > 1.0 else gains.react
    return min(v_max, braking(rho, gains.brake, react))


def bearing_weight(rho: float) -> float:
    """Return h at distance ``rho`` [m]."""
    return BEARING_WEIGHT * min(1.0, rho / BEARING_FADE)


UNDECIDED, FORWARD, BACKWARD = 0, 1, -1
"""Direction of travel: not chosen yet, forwards, backwards."""


class Approach(NamedTuple):
    """How the robot drives to the goal. It is chosen for each goal, and again when the robot leaves Omega_L."""

    direction: int
    """direction of travel: UNDECIDED, FORWARD or BACKWARD"""
    opposite_heading: bool
    """True to arrive with the opposite heading (``symmetric_yaw_tolerance``)"""


def choose_approach(navigation: Navigation, allow_backward: bool, symmetric: bool) -> Approach:
    """Return the approach with the least turning.

    alpha_d and beta_d are the bearings for a direction of travel, see :func:`in_direction`. The robot turns by
    |alpha_d| onto the line to the goal, and by |beta_d| from this line to the heading at the goal.
    """
    rear_alpha, rear_beta = _opposite(navigation.alpha), _opposite(navigation.beta)
    alpha, beta = abs(navigation.alpha), abs(navigation.beta)
    best, direction, opposite = alpha + beta, FORWARD, False
    if allow_backward and rear_alpha + rear_beta < best:
        best, direction = rear_alpha + rear_beta, BACKWARD
    if symmetric and alpha + rear_beta < best:
        best, direction, opposite = alpha + rear_beta, FORWARD, True
    if symmetric and allow_backward and rear_alpha + beta < best:
        direction, opposite = BACKWARD, True
    return Approach(direction, opposite)


def _opposite(angle: float) -> float:
    return abs(wrap_angle(angle - math.pi))


def in_direction(navigation: Navigation, direction: int) -> Navigation:
    """Return the variables with alpha_d and beta_d, which are alpha and beta, turned by pi for BACKWARD."""
    if direction != BACKWARD:
        return navigation
    return Navigation(navigation.rho, wrap_angle(navigation.alpha - math.pi), wrap_angle(navigation.beta - math.pi))


def drive_and_steer(navigation: Navigation, ratio: float, direction: int, gains: Gains, data_sheet: DataSheet) -> Twist:
    """Return the command of Omega_G within the velocity limits; ``navigation`` is a result of :func:`in_direction`."""
    rho, alpha, beta = navigation
    cosine = math.cos(alpha)
    speed = approach_speed(rho, ratio, gains, data_sheet.v_max)
    phi = signed_braking(alpha, gains.turn_brake, gains.turn_react, data_sheet.omega_max)
    turn = speed / max(rho, _SMALLEST_DISTANCE) * cosine * sinc(alpha) * (alpha + bearing_weight(rho) * beta)
    command = limit_global(phi, speed * cosine, turn, data_sheet)
    return command if direction != BACKWARD else Twist(-command.v, command.omega)


def turn_to_the_goal(alpha: float, gains: Gains, data_sheet: DataSheet) -> Twist:
    """Return the turn on the spot of a robot that must not reverse; dV = -alpha phi(alpha) <= 0."""
    phi = signed_braking(alpha, gains.turn_brake, gains.turn_react, data_sheet.omega_max)
    return limit_global(phi, 0.0, 0.0, data_sheet)


def drive_and_hold(
    navigation: Navigation, heading_error: float, ratio: float, gains: Gains, data_sheet: DataSheet
) -> Twist:
    """Return the command of Omega_L within the velocity limits; it reduces ``heading_error`` [rad] to 0."""
    speed = approach_speed(navigation.rho, ratio, gains, data_sheet.v_max)
    omega = -signed_braking(heading_error, gains.hold_brake, gains.hold_react, data_sheet.omega_max)
    return limit_local(Twist(speed * math.cos(navigation.alpha), omega), data_sheet)


def global_lyapunov(navigation: Navigation) -> float:
    """Return V of Omega_G, (rho^2 + alpha_d^2 + h beta_d^2) / 2, for a result of :func:`in_direction`."""
    rho, alpha, beta = navigation
    return 0.5 * (rho * rho + alpha * alpha + bearing_weight(rho) * beta * beta)


def local_lyapunov(navigation: Navigation, theta: float) -> float:
    """Return V of Omega_L, Eq. (15): (rho^2 + theta^2) / 2."""
    return 0.5 * (navigation.rho * navigation.rho + theta * theta)
