"""Bounds of the commands of Omega_G for intervals of what is measured.

Rounding: plain floats, widened by SLACK wherever a bound is handed on. The numbers are below 1e4 with a few operations
between two widenings, whose errors are some 1e-12 at most; SLACK exceeds them by far.

Formulas: s(d) = brake (sqrt(react^2 + 2 d / brake) - react), the positive root of s^2 / (2 brake) + s react = d. The
coupling term is (f / rho) sinc(2 a) (a + h beta), as cos(a) sin(a) / a = sinc(2 a).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.law.configuration import ControllerConfig
from diffbot_control.law.speed_profile import ARRIVAL_SHARE
from diffbot_core.errors import InvalidValueError
from diffbot_lab.stability.plan import Plan

SLACK = 1e-10
_SINC_LOWEST, _AT_LOWEST = -0.2172336283, 4.4934094579
"""the minimum of sinc, and where it is"""
_HALF_PI = 0.5 * math.pi

Range = tuple[float, float]


class Numbers(NamedTuple):
    """Law, contract and plant, as numbers."""

    brake: float
    """[m/s^2]"""
    react: float
    """[s] with a position that is known well ..."""
    slow_react: float
    """[s] ... and with the largest sigma of the contract"""
    weight: float
    """[-] of beta"""
    turn_brake: float
    """[rad/s^2]"""
    turn_react: float
    """[s]"""
    hold_brake: float
    """[rad/s^2]"""
    hold_react: float
    """[s]"""
    v_max: float
    """[m/s]"""
    omega_max: float
    """[rad/s]"""
    rim: float
    """[m/s] bound of |v| + half |omega|"""
    half: float
    """[m] half the distance of the wheels"""
    eps_rho: float
    """[m] bound of the distance of the estimated from the true position"""
    eps_theta: float
    """[rad]"""
    noise: float
    """[-] bound of the relative error of each wheel's speed"""
    eps_v: float
    """[m/s] bound of how far beside the base ends, per time ..."""
    eps_omega: float
    """[rad/s] ... and of the error of its rotation"""
    t_s: float
    """[s]"""


class Command(NamedTuple):
    """Bounds of v [m/s] and omega [rad/s]."""

    v0: float
    v1: float
    w0: float
    w1: float


def numbers_of(config: ControllerConfig, plan: Plan) -> Numbers:
    """Collect the numbers of the loop of a law as it requests.

    Raises:
        InvalidValueError: if they are too large for the rounding that SLACK stands for.
    """
    gains, sheet, contract = config.profile_gains, config.data_sheet, plan.contract
    # An uncertainty that is a share of the tolerance does not slow the approach.
    known = max(gains.sigma_known, ARRIVAL_SHARE * config.tolerance.xy_goal_tolerance)
    slow = gains.react * max(1.0, contract.sigma_max / known) ** 2 + SLACK
    for name, product in (
        ("react", gains.brake * slow),
        ("turn_react", gains.turn_brake * gains.turn_react),
        ("hold_react", gains.hold_brake * gains.hold_react),
    ):
        if product > 1e4:
            raise InvalidValueError(name, getattr(gains, name), "less, for the check's rounding")
    half, rim = 0.5 * sheet.wheels.wheel_separation, sheet.wheel_max * sheet.wheels.wheel_radius
    turns = min(sheet.omega_max, rim / half)
    position = contract.eps_position + SLACK
    return Numbers(
        gains.brake, gains.react, slow, gains.bearing_weight, gains.turn_brake, gains.turn_react, gains.hold_brake,
        gains.hold_react, sheet.v_max, turns, rim, half, position, contract.eps_theta,
        contract.wheel_error, contract.eps_v, contract.eps_omega, plan.period,
    )  # fmt: skip


def profile(distance: float, brake: float, react: float) -> float:
    """s(d) for d >= 0: rises with the distance, falls with the reaction time."""
    return brake * (math.sqrt(react * react + 2.0 * distance / brake) - react)


def approach_range(loop: Numbers, near: float, far: float) -> Range:
    """Bounds of f(rho) [m/s] for rho in [near, far] and any sigma of the contract."""
    slowest = min(profile(near, loop.brake, loop.slow_react), loop.v_max)
    return max(slowest - SLACK, 0.0), min(profile(far, loop.brake, loop.react), loop.v_max) + SLACK


def per_distance_range(loop: Numbers, near: float, far: float) -> Range:
    """Bounds of f(rho) / rho [1/s], which falls: s is concave and the bound constant."""
    least = min(profile(far, loop.brake, loop.slow_react), loop.v_max) / far
    return max(least - SLACK, 0.0), min(profile(near, loop.brake, loop.react), loop.v_max) / near + SLACK


def signed_profile(error: float, brake: float, react: float, largest: float) -> float:
    """phi(error) [rad/s]: odd, and rises."""
    return math.copysign(min(profile(abs(error), brake, react), largest), error)


def cosine_range(a0: float, a1: float) -> Range:
    """Bounds of the cosine on an interval within +-(pi + SLACK)."""
    low, high = min(math.cos(a0), math.cos(a1)), max(math.cos(a0), math.cos(a1))
    return max(low - SLACK, -1.0), (1.0 if a0 <= 0.0 <= a1 else min(high + SLACK, 1.0))


def sinc_range(x0: float, x1: float) -> Range:
    """Bounds of sin(x) / x on an interval within +-7: it falls with |x| down to its minimum, and rises beyond."""
    far = max(abs(x0), abs(x1))
    near = 0.0 if x0 <= 0.0 <= x1 else min(abs(x0), abs(x1))
    low, high = min(_sinc(near), _sinc(far)), max(_sinc(near), _sinc(far))
    return (_SINC_LOWEST if near <= _AT_LOWEST <= far else low) - SLACK, high + SLACK


def _sinc(x: float) -> float:
    return math.sin(x) / x if x > 1e-6 else 1.0


def product(a: Range, b: Range) -> Range:
    """Bounds of a product; SLACK does not take them across 0, since the sign of a product is exact."""
    p, q, r, s = a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]
    low, high = min(p, q, r, s), max(p, q, r, s)
    return max(low - SLACK, 0.0) if low >= 0.0 else low - SLACK, min(high + SLACK, 0.0) if high <= 0.0 else high + SLACK


def command_of(loop: Numbers, rho: Range, alpha: Range, beta: Range) -> Command:
    """Bounds of the command of Omega_G with all limits, of the end that leads.

    Args:
        loop: law, contract and plant.
        rho: [m] measured, > 0.
        alpha: [rad] measured, within +-pi
        beta: [rad] likewise.
    """
    p0 = signed_profile(alpha[0], loop.turn_brake, loop.turn_react, loop.omega_max) - SLACK
    p1 = signed_profile(alpha[1], loop.turn_brake, loop.turn_react, loop.omega_max) + SLACK
    v = product(approach_range(loop, rho[0], rho[1]), cosine_range(alpha[0], alpha[1]))
    turn = product(per_distance_range(loop, rho[0], rho[1]), _coupling(loop, alpha, beta))
    share = _share(loop, (p0, p1), v, turn)
    v, turn = product(v, share), product(turn, share)
    w0, w1 = max(p0 + turn[0], -loop.omega_max) - SLACK, min(p1 + turn[1], loop.omega_max) + SLACK
    # The rims leave this much for the speed.
    slowest = 0.0 if w0 <= 0.0 <= w1 else min(abs(w0), abs(w1))
    most = min(loop.rim - loop.half * slowest, loop.v_max) + SLACK
    return Command(max(v[0], -most), min(v[1], most), w0, w1)


def _coupling(loop: Numbers, alpha: Range, beta: Range) -> Range:
    """Bounds of cos(a) sinc(a) (a + h beta) = sinc(2 a) (a + h beta).

    The limits hang on its sign: with phi at its own bound, any turn to the same side would take the whole speed.
    """
    low, high = sinc_range(2.0 * alpha[0], 2.0 * alpha[1])
    # The law's angles are within +-pi, where sinc(2 a) has the sign of cos(a).
    if alpha[0] > _HALF_PI or alpha[1] < -_HALF_PI:
        high = min(high, 0.0)
    elif alpha[0] > -_HALF_PI and alpha[1] < _HALF_PI:
        low = max(low, 0.0)
    both = alpha[0] + loop.weight * beta[0] - SLACK, alpha[1] + loop.weight * beta[1] + SLACK
    return product((low, high), both)


def _share(loop: Numbers, phi: Range, v: Range, turn: Range) -> Range:
    """Bounds of the largest s in [0, 1] with which (s v, phi + s turn) keeps all limits.

    |phi + s turn| <= omega_max and s |v| +- half (phi + s turn) <= rim are four inequalities p + s q <= bound with
    p <= bound: each asks for s <= (bound - p) / q where q > 0. The least s has the largest p and q, and vice versa.
    |v| <= v_max holds already.
    """
    fast = max(abs(v[0]), abs(v[1]))
    slow = 0.0 if v[0] <= 0.0 <= v[1] else min(abs(v[0]), abs(v[1]))
    low = high = 1.0
    for p, q in ((phi, turn), ((-phi[1], -phi[0]), (-turn[1], -turn[0]))):
        low = min(low, _most(loop.omega_max - p[1], q[1]))
        high = min(high, _most(loop.omega_max - p[0], q[0]))
        low = min(low, _most(loop.rim - loop.half * p[1], fast + loop.half * q[1]))
        high = min(high, _most(loop.rim - loop.half * p[0], slow + loop.half * q[0]))
    return max(low - SLACK, 0.0), min(high + SLACK, 1.0)


def _most(room: float, rate: float) -> float:
    """Return the s that uses up the room, 1 if it is not used up by s <= 1."""
    room = max(room, 0.0)
    return room / rate if rate > room else 1.0
