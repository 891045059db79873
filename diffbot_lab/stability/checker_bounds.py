"""Bound one step of Omega_G by interval arithmetic, for the checker of certificates.

The robot is at a distance rho from the goal. The goal's bearing is alpha in the robot's frame and beta in the goal's
frame; for a robot that drives backwards, both are turned by pi (alpha_d and beta_d of the law). A step with the
rotation z moves the base along the chord of an arc, which has the length u = t_s v sinc(z / 2) and points z / 2 to the
left. With psi = alpha - z / 2, the angle from the chord to the goal,

    rho' exp(i tau) = rho - u cos(psi) + i u sin(psi),   alpha' = alpha - z + tau,   beta' = beta + tau
    rho'^2 = rho^2 - 2 rho u cos(psi) + u^2

The law's braking profile is s(d) = brake (sqrt(react^2 + 2 d / brake) - react), the positive root of
s^2 / (2 brake) + s react = d. The coupling term is (f / rho) sinc(2 alpha) (alpha + h(rho) beta), because
cos(a) sin(a) / a = sinc(2 a).

Rounding: the bounds are floats, and each function widens the bounds that it returns by SLACK. All numbers are below
1e4, and there are only a few operations between two widenings, so the rounding errors are below about 1e-12. This is
far less than SLACK.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diffbot_control.law.regions import leaving_radius
from diffbot_control.law.steering import ARRIVAL_SHARE, BEARING_FADE, BEARING_WEIGHT
from diffbot_core.errors import InvalidValueError
from diffbot_lab.stability.plan import IdealLaw, Plan

SLACK = 1e-10
_SINC_LOWEST, _AT_LOWEST = -0.2172336283, 4.4934094579
"""minimum of sin(x) / x, and the x > 0 where it occurs"""
_HALF_PI = 0.5 * math.pi
PI = math.pi + SLACK
_SLICE = 2.5
"""width of a slice of the measured bearing, as a multiple of the width of the box in alpha"""
_MIN_MEASURED, _MAX_CHORD, _MAX_ROTATION = 0.01, 0.45, 1.0
"""range in which the formulas hold: smallest measured distance [m], largest chord as a share of the distance, largest
rotation [rad]"""

Range = tuple[float, float]


class CheckerLoop(NamedTuple):
    """Parameters of law, contract and base."""

    brake: float
    """[m/s^2] deceleration"""
    react: float
    """[s] reaction time of the speed with a small standard deviation"""
    slow_react: float
    """[s] reaction time of the speed with the largest standard deviation of the contract"""
    weight: float
    """[-] weight of beta far from the goal"""
    fade: float
    """[m] distance below which the weight of beta is proportional to the distance"""
    turn_brake: float
    """[rad/s^2] angular deceleration"""
    turn_react: float
    """[s] reaction time of turns"""
    leaving: float
    """[m] largest measured distance at which the law may be in Omega_L"""
    v_max: float
    """[m/s]"""
    omega_max: float
    """[rad/s]"""
    rim: float
    """[m/s] bound of |v| + half |omega|"""
    half: float
    """[m] half the wheel separation"""
    eps_rho: float
    """[m] bound of the distance between the estimated and the true position"""
    eps_theta: float
    """[rad] bound of the heading error"""
    noise: float
    """[-] bound of the relative error of each wheel's speed"""
    eps_v: float
    """[m/s] bound of the position error of the base in a step, divided by the period, in addition to ``noise``"""
    eps_omega: float
    """[rad/s] bound of the error of the rotation, in addition to ``noise``"""
    t_s: float
    """[s] period"""


class Command(NamedTuple):
    """Bounds of v [m/s] and omega [rad/s]."""

    v0: float
    v1: float
    w0: float
    w1: float


def checker_loop(law: IdealLaw, plan: Plan) -> CheckerLoop:
    """Return the loop of a law under a plan whose contract has constant bounds.

    Raises:
        InvalidValueError: if the rounding errors could exceed SLACK.
    """
    config, gains = law
    sheet, contract = config.data_sheet, plan.contract
    # The law does not slow the approach while the uncertainty is below this share of the tolerance.
    known = max(config.sigma_known, ARRIVAL_SHARE * config.tolerance.xy_goal_tolerance)
    slow = gains.react * max(1.0, contract.sigma_max / known) ** 2 + SLACK
    for name, product in (("react", gains.brake * slow), ("turn_react", gains.turn_brake * gains.turn_react)):
        if product > 1e4:
            raise InvalidValueError(name, getattr(gains, name), "smaller, for the rounding errors of the checker")
    half, rim = 0.5 * sheet.wheels.wheel_separation, sheet.wheel_max * sheet.wheels.wheel_radius
    return CheckerLoop(
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
    """Return the speed s(d) of the braking profile. It rises with the distance and falls with the reaction time."""
    return brake * (math.sqrt(react * react + 2.0 * distance / brake) - react)


def approach_range(loop: CheckerLoop, near: float, far: float) -> Range:
    """Return bounds of f(rho) [m/s] for rho in [near, far] and all standard deviations that the contract allows."""
    slowest = min(profile(near, loop.brake, loop.slow_react), loop.v_max)
    return max(slowest - SLACK, 0.0), min(profile(far, loop.brake, loop.react), loop.v_max) + SLACK


def per_distance_range(loop: CheckerLoop, near: float, far: float) -> Range:
    """Return bounds of f(rho) / rho [1/s]. It falls with rho, because s is concave and v_max is constant."""
    least = min(profile(far, loop.brake, loop.slow_react), loop.v_max) / far
    return max(least - SLACK, 0.0), min(profile(near, loop.brake, loop.react), loop.v_max) / near + SLACK


def signed_profile(error: float, brake: float, react: float, largest: float) -> float:
    """Return phi(error) [rad/s], an odd function that rises with the error."""
    return math.copysign(min(profile(abs(error), brake, react), largest), error)


def cosine_range(a0: float, a1: float) -> Range:
    """Return bounds of the cosine on an interval within +-2 pi."""
    low, high = min(math.cos(a0), math.cos(a1)), max(math.cos(a0), math.cos(a1))
    lowest = a0 <= -math.pi <= a1 or a0 <= math.pi <= a1
    return (-1.0 if lowest else max(low - SLACK, -1.0)), (1.0 if a0 <= 0.0 <= a1 else min(high + SLACK, 1.0))


def smallest(a: Range) -> float:
    """Return the smallest absolute value in an interval."""
    return 0.0 if a[0] <= 0.0 <= a[1] else min(abs(a[0]), abs(a[1]))


def largest(a: Range) -> float:
    """Return the largest absolute value in an interval."""
    return max(abs(a[0]), abs(a[1]))


def sinc_range(x0: float, x1: float) -> Range:
    """Return bounds of sin(x) / x on an interval within +-7. It falls with |x| to its minimum, and rises beyond."""
    near, far = smallest((x0, x1)), largest((x0, x1))
    low, high = min(_sinc(near), _sinc(far)), max(_sinc(near), _sinc(far))
    return (_SINC_LOWEST if near <= _AT_LOWEST <= far else low) - SLACK, high + SLACK


def _sinc(x: float) -> float:
    return math.sin(x) / x if x > 1e-6 else 1.0


def product(a: Range, b: Range) -> Range:
    """Return bounds of a product. SLACK does not move a bound past 0, because the sign of a product is exact."""
    p, q, r, s = a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]
    low, high = min(p, q, r, s), max(p, q, r, s)
    return max(low - SLACK, 0.0) if low >= 0.0 else low - SLACK, min(high + SLACK, 0.0) if high <= 0.0 else high + SLACK


def command_of(loop: CheckerLoop, rho: Range, alpha: Range, beta: Range) -> Command:
    """Return bounds of the command of Omega_G with all limits. v is positive in the direction of travel.

    Args:
        loop: law, contract and base.
        rho: [m] measured distance, > 0.
        alpha: [rad] measured bearing, within +-pi.
        beta: [rad] measured direction of the goal, within +-pi.
    """
    p0 = signed_profile(alpha[0], loop.turn_brake, loop.turn_react, loop.omega_max) - SLACK
    p1 = signed_profile(alpha[1], loop.turn_brake, loop.turn_react, loop.omega_max) + SLACK
    v = product(approach_range(loop, rho[0], rho[1]), cosine_range(alpha[0], alpha[1]))
    turn = product(per_distance_range(loop, rho[0], rho[1]), _coupling(loop, rho, alpha, beta))
    share = _share(loop, (p0, p1), v, turn)
    v, turn = product(v, share), product(turn, share)
    w0, w1 = max(p0 + turn[0], -loop.omega_max) - SLACK, min(p1 + turn[1], loop.omega_max) + SLACK
    # The limit of the rims bounds the speed by the rotation.
    v_limit = min(loop.rim - loop.half * smallest((w0, w1)), loop.v_max) + SLACK
    return Command(max(v[0], -v_limit), min(v[1], v_limit), w0, w1)


def _coupling(loop: CheckerLoop, rho: Range, alpha: Range, beta: Range) -> Range:
    """Return bounds of cos(a) sinc(a) (a + h(rho) beta) = sinc(2 a) (a + h(rho) beta), where h rises with rho.

    The sign has to be exact: if phi is at its limit, any additional turn to the same side reduces the speed to zero.
    """
    low, high = sinc_range(2.0 * alpha[0], 2.0 * alpha[1])
    # For angles within +-pi, sinc(2 a) has the same sign as cos(a).
    if alpha[0] > _HALF_PI or alpha[1] < -_HALF_PI:
        high = min(high, 0.0)
    elif alpha[0] > -_HALF_PI and alpha[1] < _HALF_PI:
        low = max(low, 0.0)
    weight = loop.weight * min(1.0, rho[0] / loop.fade), loop.weight * min(1.0, rho[1] / loop.fade)
    aside = product(weight, beta)
    both = alpha[0] + aside[0] - SLACK, alpha[1] + aside[1] + SLACK
    return product((low, high), both)


def _share(loop: CheckerLoop, phi: Range, v: Range, turn: Range) -> Range:
    """Return bounds of the largest s in [0, 1] for which (s v, phi + s turn) keeps all limits.

    The limits |phi + s turn| <= omega_max and s |v| +- half (phi + s turn) <= rim are four inequalities p + s q <=
    bound with p <= bound. If q > 0, each of them requires s <= (bound - p) / q. So s is smallest for the largest p and
    q, and largest for the smallest p and q. The limit |v| <= v_max already holds.
    """
    slow, fast, low, high = smallest(v), largest(v), 1.0, 1.0
    for p, q in ((phi, turn), ((-phi[1], -phi[0]), (-turn[1], -turn[0]))):
        low = min(low, _max_share(loop.omega_max - p[1], q[1]))
        high = min(high, _max_share(loop.omega_max - p[0], q[0]))
        low = min(low, _max_share(loop.rim - loop.half * p[1], fast + loop.half * q[1]))
        high = min(high, _max_share(loop.rim - loop.half * p[0], slow + loop.half * q[0]))
    return max(low - SLACK, 0.0), min(high + SLACK, 1.0)


def _max_share(room: float, rate: float) -> float:
    """Return the largest s in [0, 1] with s rate <= room."""
    room = max(room, 0.0)
    return room / rate if rate > room else 1.0


def longest_step(loop: CheckerLoop, distance: float) -> float:
    """Return the largest length [m] of a step if the measured distance is at most ``distance`` [m]."""
    speed = approach_range(loop, 0.0, distance)[1]
    return loop.t_s * (speed + loop.noise * max(speed, loop.half * loop.omega_max) + loop.eps_v) + SLACK


def local_reach(loop: CheckerLoop) -> float:
    """Return the largest true distance [m] after a step in Omega_L or a departure from Omega_L.

    In both cases the measured distance before the step is at most the leaving radius.
    """
    return loop.leaving + loop.eps_rho + longest_step(loop, loop.leaving) + SLACK


class Box(NamedTuple):
    """Closed box of true states: rho [m], and alpha and beta [rad] for the direction of travel."""

    r0: float
    r1: float
    a0: float
    a1: float
    b0: float
    b1: float


def bearing_error(loop: CheckerLoop, rho: float) -> float:
    """Return the largest error [rad] of the goal's direction at a distance ``rho`` [m] above ``eps_rho``."""
    return math.asin(min(loop.eps_rho / rho, 1.0)) + SLACK


def measured_distance(loop: CheckerLoop, box: Box, error: Range) -> Range:
    """Return bounds of the measured distance [m] for a range of the error d of the goal's direction.

    The measured goal lies in a disc of radius eps about the true goal. A line from the robot, in the direction with the
    error d, intersects the circle in two points. The distances of these points have the product rho^2 - eps^2 and the
    sum 2 rho cos(d). The smallest |d| gives the smallest and the largest distance.
    """
    least = smallest(error)
    half = math.sqrt(max(loop.eps_rho**2 - (box.r0 * math.sin(least)) ** 2, 0.0)) + SLACK
    near = (box.r0**2 - loop.eps_rho**2) / (box.r0 * math.cos(least) + half) - SLACK
    return near, box.r1 * math.cos(least) + half + SLACK


def motion_of(loop: CheckerLoop, command: Command) -> tuple[Range, Range]:
    """Return bounds of the chord [m] and of the rotation [rad] of one step, with an independent error of each wheel.

    The errors of the wheels change v by at most noise (|left| + |right|) / 2 = noise max(|v|, half |omega|). They
    change omega by at most this value divided by half.
    """
    v0, v1, w0, w1 = command
    error = loop.noise * max(largest((v0, v1)), loop.half * largest((w0, w1)))
    turned = error / loop.half + loop.eps_omega + SLACK
    error += SLACK
    z = loop.t_s * (w0 - turned) - SLACK, loop.t_s * (w1 + turned) + SLACK
    arc = loop.t_s * (v0 - error), loop.t_s * (v1 + error)
    return product(arc, sinc_range(0.5 * z[0], 0.5 * z[1])), z


def distance_range(box: Box, u: Range, cosine: Range) -> Range:
    """Return bounds of the distance [m] from the goal at the end of the chord.

    The distance rises with rho, because the chord is shorter than r0 / 2. It is monotone in the cosine of psi and
    convex in the chord. So the largest distance is at the ends of both ranges. The distance is smallest if the chord
    ends at the foot of the perpendicular from the goal, or as near to the foot as the range of the chord allows.
    """
    near, far = math.inf, 0.0
    for c in cosine:
        far = max(far, _third_side(box.r1, u[0], c), _third_side(box.r1, u[1], c))
        near = min(near, _third_side(box.r0, min(max(box.r0 * c, u[0]), u[1]), c))
    return near - SLACK, far + SLACK


def _third_side(rho: float, u: float, cosine: float) -> float:
    return math.sqrt(max((rho - u * cosine) ** 2 + u * u * (1.0 - cosine * cosine), 0.0))


def after(loop: CheckerLoop, box: Box, u: Range, z: Range) -> Box:
    """Return bounds of the states after a step from a box.

    The step may end at an offset from the end of the chord. The offset changes the goal's distance by at most its
    length. It changes the goal's direction by at most the angle between the goal's direction and the tangent to the
    circle with this radius.

    Args:
        loop: law, contract and base.
        box: true states.
        u: [m] chord, shorter than r0 / 2.
        z: [rad] rotation.
    """
    psi = box.a0 - 0.5 * z[1] - SLACK, box.a1 - 0.5 * z[0] + SLACK
    cosine = cosine_range(*psi)
    near, far = distance_range(box, u, cosine)
    along = product(u, cosine)
    x0, x1 = box.r0 - along[1] - SLACK, box.r1 - along[0] + SLACK
    y0, y1 = product(u, cosine_range(psi[0] - _HALF_PI - SLACK, psi[1] - _HALF_PI + SLACK))
    offset = loop.t_s * loop.eps_v
    angle = math.asin(offset / near) + SLACK if offset < near else PI
    tau0 = math.atan2(y0, x0 if y0 < 0.0 else x1) - angle - SLACK
    tau1 = math.atan2(y1, x0 if y1 > 0.0 else x1) + angle + SLACK
    return Box(
        near - offset - SLACK,
        far + offset + SLACK,
        box.a0 + tau0 - z[1] - SLACK,
        box.a1 + tau1 - z[0] + SLACK,
        box.b0 + tau0 - SLACK,
        box.b1 + tau1 + SLACK,
    )


def within_pi(low: float, high: float, turn: float) -> Range:
    """Subtract ``turn`` from an interval of angles and cut it to +-pi. The result is empty if low > high."""
    return max(low - turn - SLACK, -PI), min(high - turn + SLACK, PI)


def slice_count(loop: CheckerLoop, box: Box) -> int:
    """Return the number of slices into which the range of the measured bearing is divided."""
    width = box.a1 - box.a0
    return math.ceil((width + 2.0 * (bearing_error(loop, box.r0) + loop.eps_theta)) / (_SLICE * width))


def max_images(loop: CheckerLoop, box: Box) -> int:
    """Return the largest number of images of a box; see :func:`images`."""
    return 9 * slice_count(loop, box)


def images(loop: CheckerLoop, box: Box, out: Any) -> int:
    """Enclose all states to which one step of Omega_G may lead from a box, for all errors that the contract allows.

    The measured beta has an error d, the error of the goal's direction. The measured alpha has the error d and the
    error of the heading. The range of the measured alpha is divided into slices, and each slice gives one box. If alpha
    or beta exceeds +-pi in a slice, the part that is wrapped by a full turn gives a box of its own.

    Args:
        loop: law, contract and base.
        box: true states.
        out: (n, 6) array for the images, with angles that are not wrapped; see :func:`max_images`.

    Returns:
        The number of images; -1 if the formulas do not hold, because the measured goal may be at the robot itself or a
        step may be too long.
    """
    max_error, parts, number = bearing_error(loop, box.r0), slice_count(loop, box), 0
    eps = loop.eps_theta + SLACK
    reach = max_error + eps + 4.0 * SLACK
    width = (box.a1 - box.a0 + 2.0 * reach) / parts
    for part in range(parts):
        p = box.a0 - reach + part * width - SLACK
        q = p + width + 2.0 * SLACK
        error = max(p - box.a1 - eps, -max_error), min(q - box.a0 + eps, max_error)
        if error[0] > error[1]:
            continue
        for case in range(9):
            a_turn, b_turn = 2.0 * math.pi * (case % 3 - 1), 2.0 * math.pi * (case // 3 - 1)
            d0 = max(error[0], a_turn - PI - box.a1 - eps, b_turn - PI - box.b1)
            d1 = min(error[1], a_turn + PI - box.a0 + eps, b_turn + PI - box.b0)
            alpha = within_pi(max(p, box.a0 + d0 - eps), min(q, box.a1 + d1 + eps), a_turn)
            beta = within_pi(box.b0 + d0, box.b1 + d1, b_turn)
            if d0 > d1 or alpha[0] > alpha[1] or beta[0] > beta[1]:
                continue
            rho = measured_distance(loop, box, (d0, d1))
            if not rho[0] > _MIN_MEASURED:
                return -1
            u, z = motion_of(loop, command_of(loop, rho, alpha, beta))
            if not (largest(u) < _MAX_CHORD * box.r0 and largest(z) < _MAX_ROTATION):
                return -1
            a0, a1 = max(box.a0, alpha[0] + a_turn - reach), min(box.a1, alpha[1] + a_turn + reach)
            put_box(out[number], after(loop, Box(box.r0, box.r1, a0, a1, box.b0, box.b1), u, z))
            number += 1
    return number


def put_box(row: Any, box: Box) -> None:
    """Write a box to a row of an array."""
    row[0], row[1], row[2], row[3], row[4], row[5] = box


def box_at(row: Any) -> Box:
    """Return the box in a row of an array."""
    return Box(row[0], row[1], row[2], row[3], row[4], row[5])
