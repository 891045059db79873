"""Bounds of one step of Omega_G, which the checker of certificates trusts: plain interval arithmetic.

The robot is at a distance rho from the goal, whose bearing is alpha in the robot's frame and beta in the goal's frame,
all as of the leading end. A step with the rotation z ends on the chord of an arc, u = t_s v sinc(z / 2), which points
z / 2 to the left. With psi = alpha - z / 2, the angle from the chord to the goal,

    rho' exp(i tau) = rho - u cos(psi) + i u sin(psi),   alpha' = alpha - z + tau,   beta' = beta + tau
    rho'^2 = rho^2 - 2 rho u cos(psi) + u^2

The law has s(d) = brake (sqrt(react^2 + 2 d / brake) - react), the positive root of s^2 / (2 brake) + s react = d. Its
coupling term is (f / rho) sinc(2 alpha) (alpha + h(rho) beta), as cos(a) sin(a) / a = sinc(2 a).

Rounding: plain floats, widened by SLACK wherever a bound is handed on. The numbers are below 1e4 with a few operations
between two widenings, whose errors are some 1e-12 at most. SLACK exceeds them by far.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diffbot_control.law.regions import leaving_radius
from diffbot_control.law.steering import ARRIVAL_SHARE, BEARING_FADE, BEARING_WEIGHT
from diffbot_core.errors import InvalidValueError
from diffbot_lab.stability.plan import Plan, Requests

SLACK = 1e-10
_SINC_LOWEST, _AT_LOWEST = -0.2172336283, 4.4934094579
"""the minimum of sinc, and where it is"""
_HALF_PI = 0.5 * math.pi
PI = math.pi + SLACK
_SLICE = 2.5
"""width of the slices of the measured bearing, in widths of a box"""
_NEAREST, _LONGEST, _WIDEST = 0.01, 0.45, 1.0
"""limits of the formulas: measured distance [m], chord as a share of the distance, rotation [rad]"""

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
    """[-] of beta, far from the goal ..."""
    fade: float
    """[m] ... and below this distance in proportion to it"""
    turn_brake: float
    """[rad/s^2]"""
    turn_react: float
    """[s]"""
    leaving: float
    """[m] largest measured distance at which Omega_L may be in force"""
    v_max: float
    """[m/s]"""
    omega_max: float
    """[rad/s]"""
    rim: float
    """[m/s] bound of |v| + half |omega|"""
    half: float
    """[m] half the wheel separation"""
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


def numbers_of(requests: Requests, plan: Plan) -> Numbers:
    """Collect the numbers of the loop of a law as it requests.

    Raises:
        InvalidValueError: if they are too large for the rounding that SLACK stands for.
    """
    config, gains = requests
    sheet, contract = config.data_sheet, plan.contract
    # An uncertainty that is a share of the tolerance does not slow the approach.
    known = max(config.sigma_known, ARRIVAL_SHARE * config.tolerance.xy_goal_tolerance)
    slow = gains.react * max(1.0, contract.sigma_max / known) ** 2 + SLACK
    for name, product in (("react", gains.brake * slow), ("turn_react", gains.turn_brake * gains.turn_react)):
        if product > 1e4:
            raise InvalidValueError(name, getattr(gains, name), "less, for the check's rounding")
    half, rim = 0.5 * sheet.wheels.wheel_separation, sheet.wheel_max * sheet.wheels.wheel_radius
    return Numbers(
        brake=gains.brake,
        react=gains.react,
        slow_react=slow,
        weight=BEARING_WEIGHT,
        fade=BEARING_FADE,
        turn_brake=gains.turn_brake,
        turn_react=gains.turn_react,
        v_max=sheet.v_max,
        omega_max=min(sheet.omega_max, rim / half),
        rim=rim,
        half=half,
        leaving=leaving_radius(contract.sigma_max, config.tolerance),
        eps_rho=contract.eps_position + SLACK,
        eps_theta=contract.eps_theta,
        noise=contract.wheel_error,
        eps_v=contract.eps_v,
        eps_omega=contract.eps_omega,
        t_s=plan.period,
    )


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
    """Bounds of the cosine on an interval within +-2 pi."""
    low, high = min(math.cos(a0), math.cos(a1)), max(math.cos(a0), math.cos(a1))
    lowest = a0 <= -math.pi <= a1 or a0 <= math.pi <= a1
    return (-1.0 if lowest else max(low - SLACK, -1.0)), (1.0 if a0 <= 0.0 <= a1 else min(high + SLACK, 1.0))


def smallest(a: Range) -> float:
    """Smallest absolute value in an interval."""
    return 0.0 if a[0] <= 0.0 <= a[1] else min(abs(a[0]), abs(a[1]))


def largest(a: Range) -> float:
    """Largest absolute value in an interval."""
    return max(abs(a[0]), abs(a[1]))


def sinc_range(x0: float, x1: float) -> Range:
    """Bounds of sin(x) / x on an interval within +-7: it falls with |x| down to its minimum, and rises beyond."""
    near, far = smallest((x0, x1)), largest((x0, x1))
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
    turn = product(per_distance_range(loop, rho[0], rho[1]), _coupling(loop, rho, alpha, beta))
    share = _share(loop, (p0, p1), v, turn)
    v, turn = product(v, share), product(turn, share)
    w0, w1 = max(p0 + turn[0], -loop.omega_max) - SLACK, min(p1 + turn[1], loop.omega_max) + SLACK
    # The rims leave this much for the speed.
    most = min(loop.rim - loop.half * smallest((w0, w1)), loop.v_max) + SLACK
    return Command(max(v[0], -most), min(v[1], most), w0, w1)


def _coupling(loop: Numbers, rho: Range, alpha: Range, beta: Range) -> Range:
    """Bounds of cos(a) sinc(a) (a + h(rho) beta) = sinc(2 a) (a + h(rho) beta); h rises.

    The limits hang on its sign: with phi at its own bound, any turn to the same side would take the whole speed.
    """
    low, high = sinc_range(2.0 * alpha[0], 2.0 * alpha[1])
    # The law's angles are within +-pi, where sinc(2 a) has the sign of cos(a).
    if alpha[0] > _HALF_PI or alpha[1] < -_HALF_PI:
        high = min(high, 0.0)
    elif alpha[0] > -_HALF_PI and alpha[1] < _HALF_PI:
        low = max(low, 0.0)
    weight = loop.weight * min(1.0, rho[0] / loop.fade), loop.weight * min(1.0, rho[1] / loop.fade)
    aside = product(weight, beta)
    both = alpha[0] + aside[0] - SLACK, alpha[1] + aside[1] + SLACK
    return product((low, high), both)


def _share(loop: Numbers, phi: Range, v: Range, turn: Range) -> Range:
    """Bounds of the largest s in [0, 1] with which (s v, phi + s turn) keeps all limits.

    |phi + s turn| <= omega_max and s |v| +- half (phi + s turn) <= rim are four inequalities p + s q <= bound with
    p <= bound: each asks for s <= (bound - p) / q where q > 0. The least s has the largest p and q, and vice versa.
    |v| <= v_max holds already.
    """
    slow, fast, low, high = smallest(v), largest(v), 1.0, 1.0
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


def longest_step(loop: Numbers, distance: float) -> float:
    """Longest way [m] in one step with any rotation towards a goal that is measured within a distance [m]."""
    speed = approach_range(loop, 0.0, distance)[1]
    return loop.t_s * (speed + loop.noise * max(speed, loop.half * loop.omega_max) + loop.eps_v) + SLACK


def farthest_local(loop: Numbers) -> float:
    """Largest true distance [m] at which Omega_L may still be in force, or just be left.

    While it is in force the measured distance is at most the leaving radius; that holds for departures, too. One step
    of any motion follows that is not faster than the law's largest request there.
    """
    return loop.leaving + loop.eps_rho + longest_step(loop, loop.leaving) + SLACK


class Box(NamedTuple):
    """True states, closed; angles as of the leading end."""

    r0: float
    """[m]"""
    r1: float
    a0: float
    """[rad]"""
    a1: float
    b0: float
    b1: float


def bearing_error(loop: Numbers, rho: float) -> float:
    """Largest error [rad] of the goal's direction at a distance beyond ``eps_rho`` [m]."""
    return math.asin(min(loop.eps_rho / rho, 1.0)) + SLACK


def measured_distance(loop: Numbers, box: Box, off: Range) -> Range:
    """Bounds of the measured distance [m] where the measured direction of the goal is off by an angle in a range.

    The goal is measured in a disc of radius eps about itself. The line in a direction that is off by d meets the disc
    between two points whose distances have the product rho^2 - eps^2 and the sum 2 rho cos(d). The nearer point is
    nearest and the farther point farthest for the smallest |d|.
    """
    least = smallest(off)
    half = math.sqrt(max(loop.eps_rho**2 - (box.r0 * math.sin(least)) ** 2, 0.0)) + SLACK
    near = (box.r0**2 - loop.eps_rho**2) / (box.r0 * math.cos(least) + half) - SLACK
    return near, box.r1 * math.cos(least) + half + SLACK


def motion_of(loop: Numbers, command: Command) -> tuple[Range, Range]:
    """Bounds of the chord [m] and of the rotation [rad] of one step, each wheel off by its own error.

    The errors of the rims add up to half noise (|left| + |right|) = noise max(|v|, half |omega|) in v, and to this over
    half in omega.
    """
    v0, v1, w0, w1 = command
    error = loop.noise * max(largest((v0, v1)), loop.half * largest((w0, w1)))
    turned = error / loop.half + loop.eps_omega + SLACK
    error += SLACK
    z = loop.t_s * (w0 - turned) - SLACK, loop.t_s * (w1 + turned) + SLACK
    way = loop.t_s * (v0 - error), loop.t_s * (v1 + error)
    return product(way, sinc_range(0.5 * z[0], 0.5 * z[1])), z


def distance_range(box: Box, u: Range, cosine: Range) -> Range:
    """Bounds of the distance [m] from the goal at the end of the chord.

    It rises with rho, as the chord is shorter than r0 / 2, is monotone in the cosine of psi and convex in the chord. So
    it is largest at ends of both, and least where the chord ends at the foot of the perpendicular, or next to it.
    """
    near, far = math.inf, 0.0
    for c in cosine:
        far = max(far, _third_side(box.r1, u[0], c), _third_side(box.r1, u[1], c))
        near = min(near, _third_side(box.r0, min(max(box.r0 * c, u[0]), u[1]), c))
    return near - SLACK, far + SLACK


def _third_side(rho: float, u: float, cosine: float) -> float:
    return math.sqrt(max((rho - u * cosine) ** 2 + u * u * (1.0 - cosine * cosine), 0.0))


def after(loop: Numbers, box: Box, u: Range, z: Range) -> Box:
    """Return bounds of the states after a step from a box with a chord shorter than r0 / 2 and a rotation.

    The base may end beside the end of the chord: the goal's distance then changes by as much at most, and its direction
    by the angle of a tangent.
    """
    psi = box.a0 - 0.5 * z[1] - SLACK, box.a1 - 0.5 * z[0] + SLACK
    cosine = cosine_range(*psi)
    near, far = distance_range(box, u, cosine)
    along = product(u, cosine)
    x0, x1 = box.r0 - along[1] - SLACK, box.r1 - along[0] + SLACK
    y0, y1 = product(u, cosine_range(psi[0] - _HALF_PI - SLACK, psi[1] - _HALF_PI + SLACK))
    beside = loop.t_s * loop.eps_v
    angle = math.asin(beside / near) + SLACK if beside < near else PI
    tau0 = math.atan2(y0, x0 if y0 < 0.0 else x1) - angle - SLACK
    tau1 = math.atan2(y1, x0 if y1 > 0.0 else x1) + angle + SLACK
    return Box(
        near - beside - SLACK,
        far + beside + SLACK,
        box.a0 + tau0 - z[1] - SLACK,
        box.a1 + tau1 - z[0] + SLACK,
        box.b0 + tau0 - SLACK,
        box.b1 + tau1 + SLACK,
    )


def within_pi(low: float, high: float, turn: float) -> Range:
    """Return the part of an interval of angles that is within +-pi after a turn back; empty: low > high."""
    return max(low - turn - SLACK, -PI), min(high - turn + SLACK, PI)


def slice_count(loop: Numbers, box: Box) -> int:
    """Return the number of slices of the measured bearing."""
    width = box.a1 - box.a0
    return math.ceil((width + 2.0 * (bearing_error(loop, box.r0) + loop.eps_theta)) / (_SLICE * width))


def most_images(loop: Numbers, box: Box) -> int:
    """Return the largest number of images of a box; see :func:`images`."""
    return 9 * slice_count(loop, box)


def images(loop: Numbers, box: Box, out: Any) -> int:
    """Enclose all states one step of Omega_G after the states of a box, for all admissible errors.

    The bearing is measured wrong by the error of the heading and by an error d of the goal's direction, beta by d. Each
    slice of the measured bearing is one case, and within it each full turn that brings alpha and beta into +-pi.

    Args:
        loop: law, contract and plant.
        box: true states.
        out: (n, 6) array for the images, angles not wrapped; see :func:`most_images`.

    Returns:
        The number of images; -1 where the formulas do not hold: if the goal may be measured at the robot itself, or a
        step is too long.
    """
    widest, parts, number = bearing_error(loop, box.r0), slice_count(loop, box), 0
    eps = loop.eps_theta + SLACK
    reach = widest + eps + 4.0 * SLACK
    width = (box.a1 - box.a0 + 2.0 * reach) / parts
    for part in range(parts):
        p = box.a0 - reach + part * width - SLACK
        q = p + width + 2.0 * SLACK
        off = max(p - box.a1 - eps, -widest), min(q - box.a0 + eps, widest)
        if off[0] > off[1]:
            continue
        for case in range(9):
            a_turn, b_turn = 2.0 * math.pi * (case % 3 - 1), 2.0 * math.pi * (case // 3 - 1)
            d0 = max(off[0], a_turn - PI - box.a1 - eps, b_turn - PI - box.b1)
            d1 = min(off[1], a_turn + PI - box.a0 + eps, b_turn + PI - box.b0)
            alpha = within_pi(max(p, box.a0 + d0 - eps), min(q, box.a1 + d1 + eps), a_turn)
            beta = within_pi(box.b0 + d0, box.b1 + d1, b_turn)
            if d0 > d1 or alpha[0] > alpha[1] or beta[0] > beta[1]:
                continue
            rho = measured_distance(loop, box, (d0, d1))
            if not rho[0] > _NEAREST:
                return -1
            u, z = motion_of(loop, command_of(loop, rho, alpha, beta))
            if not (largest(u) < _LONGEST * box.r0 and largest(z) < _WIDEST):
                return -1
            a0, a1 = max(box.a0, alpha[0] + a_turn - reach), min(box.a1, alpha[1] + a_turn + reach)
            put_box(out[number], after(loop, Box(box.r0, box.r1, a0, a1, box.b0, box.b1), u, z))
            number += 1
    return number


def put_box(place: Any, box: Box) -> None:
    """Write a box to a row of an array."""
    place[0], place[1], place[2], place[3], place[4], place[5] = box


def taken(place: Any) -> Box:
    """Return the box in a row of an array."""
    return Box(place[0], place[1], place[2], place[3], place[4], place[5])
