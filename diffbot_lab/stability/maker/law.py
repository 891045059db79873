"""Bounds of the commands of the law with braking profiles, for intervals of what it measures.

The formulas are those of law/speed_profile.py, law/steering.py and law/limits.py; a test holds
the law itself inside these bounds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_lab.stability.maker.ranges import Bounds, absolute, add, cos, div, mul, sinc, sqr, sqrt, sub


class TunedLoop(NamedTuple):
    """Law, contract of the estimate, and plant, as numbers."""

    brake: float
    """[m/s^2]"""
    react: float
    """[s]"""
    slow_react: float
    """[s] the same with the largest sigma of the contract"""
    bearing_weight: float
    """[-] h"""
    turn_brake: float
    """[rad/s^2]"""
    turn_react: float
    """[s]"""
    v_max: float
    """[m/s]"""
    omega_max: float
    """[rad/s]"""
    rim: float
    """[m/s] bound of |v| + half |omega|"""
    half: float
    """[m] half the distance of the wheels"""
    eps_position: float
    """[m] bound of the distance of the estimated from the true position"""
    eps_theta: float
    """[rad] bound of the estimate's error of the heading"""
    wheel_error: float
    """[-] bound of the relative error of each wheel's speed"""
    eps_v: float
    """[m/s] bound of how far beside the base ends, per time ..."""
    eps_omega: float
    """[rad/s] ... and of the error of its rotation"""
    t_s: float
    """[s]"""


class Measured(NamedTuple):
    """Bounds of what the law is given, of the end that leads."""

    rho_low: float
    """[m] > 0"""
    rho_high: float
    alpha_low: float
    """[rad] wrapped"""
    alpha_high: float
    beta_low: float
    """[rad] wrapped"""
    beta_high: float


class Command(NamedTuple):
    """Bounds of a command."""

    v_low: float
    v_high: float
    omega_low: float
    omega_high: float


def profile_gain(distance: float, brake: float, react: float) -> Bounds:
    """Bounds of s(d) / d = 2 / (react + sqrt(react^2 + 2 d / brake)), which falls with d and with react."""
    q0, q1 = div(2.0 * distance, 2.0 * distance, brake, brake)
    r0, r1 = sqr(react, react)
    q0, q1 = add(q0, q1, r0, r1)
    q0, q1 = sqrt(q0, q1)
    q0, q1 = add(q0, q1, react, react)
    return div(2.0, 2.0, q0, q1)


def speed_per_distance(loop: TunedLoop, near: float, far: float) -> Bounds:
    """Bounds of f(rho) / rho [1/s] for 0 < near <= rho <= far; it falls with rho."""
    low, _ = profile_gain(far, loop.brake, loop.slow_react)
    _, high = profile_gain(near, loop.brake, loop.react)
    least, _ = div(loop.v_max, loop.v_max, far, far)
    _, most = div(loop.v_max, loop.v_max, near, near)
    return min(low, least), min(high, most)


def approach(loop: TunedLoop, near: float, far: float) -> Bounds:
    """Bounds of f(rho) [m/s] for near <= rho <= far; it rises with rho."""
    gain, _ = profile_gain(near, loop.brake, loop.slow_react)
    _, most = profile_gain(far, loop.brake, loop.react)
    return min(near * gain, loop.v_max), min(far * most, loop.v_max)


def steering_to_goal(loop: TunedLoop, alpha0: float, alpha1: float) -> Bounds:
    """Bounds of phi(alpha) [rad/s], odd and rising."""
    low, _ = _phi(loop, alpha0)
    _, high = _phi(loop, alpha1)
    return low, high


def _phi(loop: TunedLoop, alpha: float) -> Bounds:
    g0, g1 = profile_gain(abs(alpha), loop.turn_brake, loop.turn_react)
    p0, p1 = mul(alpha, alpha, g0, g1)
    return max(min(p0, loop.omega_max), -loop.omega_max), max(min(p1, loop.omega_max), -loop.omega_max)


def command_bounds(loop: TunedLoop, measured: Measured) -> Command:
    """Bounds of the command of Omega_G: (s f cos(alpha), phi + s turn), with s from the limits of the velocities."""
    near, far, a0, a1, _, _ = measured
    c0, c1 = cos(a0, a1)
    f0, f1 = approach(loop, near, far)
    v0, v1 = mul(f0, f1, c0, c1)
    t0, t1 = _turn(loop, measured, (c0, c1))
    p0, p1 = steering_to_goal(loop, a0, a1)
    s0, s1 = _share(loop, (p0, p1), absolute(v0, v1), (t0, t1))
    t0, t1 = mul(t0, t1, s0, s1)
    w0, w1 = add(p0, p1, t0, t1)
    w0, w1 = max(w0, -loop.omega_max), min(w1, loop.omega_max)
    v0, v1 = mul(v0, v1, s0, s1)
    turning, _ = absolute(w0, w1)
    room = min(loop.rim - loop.half * turning, loop.v_max)
    return Command(max(v0, -room), min(v1, room), w0, w1)


def _turn(loop: TunedLoop, measured: Measured, cosine: Bounds) -> Bounds:
    """Bounds of (f / rho) cos(alpha) sinc(alpha) (alpha + h beta) [rad/s]."""
    g0, g1 = speed_per_distance(loop, measured.rho_low, measured.rho_high)
    g0, g1 = _signed_product(g0, g1, cosine[0], cosine[1])
    c0, c1 = sinc(measured.alpha_low, measured.alpha_high)
    # Not negative for a wrapped angle: the law's own pi is below pi.
    g0, g1 = _signed_product(g0, g1, max(c0, 0.0), c1)
    b0, b1 = mul(loop.bearing_weight, loop.bearing_weight, measured.beta_low, measured.beta_high)
    b0, b1 = add(measured.alpha_low, measured.alpha_high, b0, b1)
    return _signed_product(g0, g1, b0, b1)


def _signed_product(a0: float, a1: float, b0: float, b1: float) -> Bounds:
    """Return bounds of a b that keep to one side of 0 where the product does: the share of the speed hangs on it."""
    low, high = mul(a0, a1, b0, b1)
    p, q, r, s = a0 * b0, a0 * b1, a1 * b0, a1 * b1
    if min(p, q, r, s) >= 0.0:
        return max(low, 0.0), high
    return low, min(high, 0.0) if max(p, q, r, s) <= 0.0 else high


def _share(loop: TunedLoop, phi: Bounds, speed: Bounds, turn: Bounds) -> Bounds:
    """Bounds of the share s of the speed that the limits leave: the least of 1 and four quotients.

    With W the bound of |omega| and r that of the rims: (W -+ phi) / |turn| for either sign of the turn, and
    (r -+ half phi) / (speed +- half turn) where the divisor is positive. Each falls with its divisor.
    """
    h0, h1 = mul(loop.half, loop.half, phi[0], phi[1])
    q0, q1 = mul(loop.half, loop.half, turn[0], turn[1])
    low = high = 1.0
    for sign in (1.0, -1.0):
        p0, p1 = (phi[0], phi[1]) if sign > 0.0 else (-phi[1], -phi[0])
        t0, t1 = (turn[0], turn[1]) if sign > 0.0 else (-turn[1], -turn[0])
        low0, high0 = _quotient(loop.omega_max, p0, p1, t0, t1)
        p0, p1 = (h0, h1) if sign > 0.0 else (-h1, -h0)
        t0, t1 = (q0, q1) if sign > 0.0 else (-q1, -q0)
        t0, t1 = add(speed[0], speed[1], t0, t1)
        low1, high1 = _quotient(loop.rim, p0, p1, t0, t1)
        low, high = min(low, low0, low1), min(high, high0, high1)
    return max(low, 0.0), max(high, 0.0)


def _quotient(bound: float, part0: float, part1: float, divisor0: float, divisor1: float) -> Bounds:
    """Bounds of (bound - part) / divisor where the divisor is positive, infinite where it is not."""
    r0, r1 = sub(bound, bound, part0, part1)
    low = high = math.inf
    if divisor1 > 0.0:
        low, _ = div(max(r0, 0.0), max(r0, 0.0), divisor1, divisor1)
    if divisor0 > 0.0:
        _, high = div(max(r1, 0.0), max(r1, 0.0), divisor0, divisor0)
    return low, high
