"""The control laws and Lyapunov functions of the paper, as pure functions.

The robot's velocity along its real axis is gamma tanh(rho) cos(alpha) in *both* sectors. The paper prints a minus sign
for the rear one because it reverses the forward direction there ("v := -v"); with the kinematics (3) that sign, taken
literally, drives away from a goal behind the robot. See docs/explanation/law.md.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.law.polar_coordinates import Navigation
from diffbot_core.kinematics import Twist
from diffbot_core.ranges import GAIN, SPEED
from diffbot_core.schema import Spec, known_fields

_SERIES = 1e-4
"""Below it sin(a)/a and tanh(r)/r are computed from their series, exact to the last bit there."""


@known_fields
class Gains(NamedTuple):
    """Gains of the laws (13) and (17).

    The defaults put a double pole at -lambda = -2 /s near the goal: k = 2 lambda, h = (lambda / gamma)^2; see
    docs/explanation/law.md.
    """

    gamma: Annotated[float, Spec("gamma, bound of |v|", "m/s", *SPEED)] = 1.3
    k: Annotated[float, Spec("weight of alpha in Omega_G", "1/s", *GAIN)] = 4.0
    h: Annotated[float, Spec("weight of beta in Omega_G", "-", *GAIN)] = 2.37
    k_2: Annotated[float, Spec("heading gain in Omega_L", "1/s", *GAIN)] = 4.0


PAPER_GAINS = Gains(1.3, 1.0, 0.17, 2.7)
"""Section 4.1 of the paper."""


def sinc(angle: float) -> float:
    """sin(angle) / angle, 1 at 0."""
    if abs(angle) < _SERIES:
        return 1.0 - angle * angle / 6.0
    return math.sin(angle) / angle


def tanhc(rho: float) -> float:
    """tanh(rho) / rho, 1 at 0."""
    if abs(rho) < _SERIES:
        return 1.0 - rho * rho / 3.0
    return math.tanh(rho) / rho


def velocity(navigation: Navigation, gains: Gains) -> float:
    """Velocity [m/s] along the robot's real axis, both regions, both sectors (Eqs. (13), (17)); |v| <= gamma."""
    return gains.gamma * math.tanh(navigation.rho) * math.cos(navigation.alpha)


def steering(navigation: Navigation, gains: Gains) -> float:
    """Angular velocity [rad/s] in Omega_G, Eq. (13)."""
    rho, alpha, beta = navigation
    turn = gains.gamma * sinc(alpha) * tanhc(rho) * math.cos(alpha)
    return gains.k * alpha + turn * (alpha + gains.h * beta)


def heading_hold(theta: float, gains: Gains) -> float:
    """Angular velocity [rad/s] in Omega_L, Eq. (17); theta [rad] is the heading in the goal's frame."""
    return -gains.k_2 * theta


def global_law(navigation: Navigation, gains: Gains) -> Twist:
    """Law (13), for Omega_G: drive and steer."""
    return Twist(velocity(navigation, gains), steering(navigation, gains))


def local_law(navigation: Navigation, theta: float, gains: Gains) -> Twist:
    """Law (17) in Omega_L: drive and hold the heading theta [rad] of the goal's frame at 0."""
    return Twist(velocity(navigation, gains), heading_hold(theta, gains))


def global_lyapunov(navigation: Navigation, gains: Gains) -> float:
    """V of Omega_G, Eq. (8): (rho^2 + alpha^2 + h beta^2) / 2."""
    rho, alpha, beta = navigation
    return 0.5 * (rho * rho + alpha * alpha + gains.h * beta * beta)


def local_lyapunov(navigation: Navigation, theta: float) -> float:
    """V of Omega_L, Eq. (15): (rho^2 + theta^2) / 2."""
    return 0.5 * (navigation.rho * navigation.rho + theta * theta)
