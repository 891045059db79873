"""Enclose one step of the loop by interval arithmetic, for the maker of certificates.

An interval is a pair of arrays (low, high). The robot is at a distance rho from the goal. The goal's bearing is alpha
in the robot's frame and beta in the goal's frame; for a robot that drives backwards, both are turned by pi (alpha_d and
beta_d of the law). A step with the rotation z moves the base along a chord u, which points z / 2 to the left. With
psi = alpha - z / 2, the angle from the chord to the goal,

    rho' exp(i tau) = rho - u cos(psi) + i u sin(psi),   alpha' = alpha - z + tau,   beta' = beta + tau

The checker shares no code with this module. If a bound of this module were wrong, the checker would refuse the
certificate.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.law.regions import leaving_radius
from diffbot_control.law.steering import ARRIVAL_SHARE, BEARING_FADE, BEARING_WEIGHT
from diffbot_lab.stability.plan import IdealLaw, Plan

Array = NDArray[np.float64]
Interval = tuple[Any, Any]

PADDING = 2e-5
"""[m], [rad] width by which an image is enlarged on each side. Rounding errors are far smaller"""
_COLUMNS = 2
"""width of a slice of the measured bearing, in columns of alpha"""
_OVERLAP = 0.2
"""width by which a slice is enlarged on each side, in columns of alpha. If the checker splits a cell into the smallest
parts, its slices are smaller than this overlap, so each of its images lies within an image of the maker"""


class MakerLoop(NamedTuple):
    """Parameters of law, contract and base."""

    brake: float
    """[m/s^2] deceleration"""
    react: float
    """[s] reaction time of the speed with a small standard deviation"""
    slow_react: float
    """[s] reaction time of the speed with the largest standard deviation of the contract"""
    turn_brake: float
    """[rad/s^2] angular deceleration"""
    turn_react: float
    """[s] reaction time of turns"""
    weight: float
    """[-] weight of beta"""
    v_max: float
    """[m/s]"""
    omega_max: float
    """[rad/s]"""
    rim: float
    """[m/s] bound of |v| + half |omega|"""
    half: float
    """[m] half the wheel separation"""
    leaving: float
    """[m] largest measured distance at which the law may be in Omega_L"""
    eps_rho: float
    """[m] bound of the distance between the estimated and the true position"""
    eps_theta: float
    """[rad] bound of the heading error"""
    noise: float
    """[-] bound of the relative error of each wheel's speed"""
    offset: float
    """[m] bound of the position error of the base in a step, in addition to ``noise``"""
    eps_omega: float
    """[rad/s] bound of the error of the rotation, in addition to ``noise``"""
    t_s: float
    """[s] period"""


def maker_loop(law: IdealLaw, plan: Plan) -> MakerLoop:
    """Return the loop of a law under a plan whose contract has constant bounds."""
    (config, gains), contract = law, plan.contract
    sheet, tolerance = config.data_sheet, config.tolerance
    arriving = max(config.sigma_known, ARRIVAL_SHARE * tolerance.xy_goal_tolerance)
    return MakerLoop(
        brake=gains.brake,
        react=gains.react,
        slow_react=gains.react * max(contract.sigma_max / arriving, 1.0) ** 2,
        turn_brake=gains.turn_brake,
        turn_react=gains.turn_react,
        weight=BEARING_WEIGHT,
        v_max=sheet.v_max,
        omega_max=sheet.omega_max,
        rim=sheet.wheel_max * sheet.wheels.wheel_radius,
        half=0.5 * sheet.wheels.wheel_separation,
        leaving=leaving_radius(contract.sigma_max, tolerance),
        eps_rho=contract.eps_position,
        eps_theta=contract.eps_theta,
        noise=contract.wheel_error,
        offset=contract.eps_v * plan.period,
        eps_omega=contract.eps_omega,
        t_s=plan.period,
    )


def longest_near(loop: MakerLoop, measured: float) -> float:
    """Return the largest length [m] of a step if the measured distance is at most ``measured`` [m]."""
    v = min(float(_braking(measured, loop.brake, loop.react)), loop.v_max)
    return loop.t_s * (v + loop.noise * max(v, loop.half * loop.omega_max)) + loop.offset + PADDING


def local_reach(loop: MakerLoop) -> float:
    """Return the largest true distance [m] after a step in Omega_L."""
    return loop.leaving + loop.eps_rho + longest_near(loop, loop.leaving)


def _braking(distance: Any, brake: float, react: float) -> Any:
    """Return the speed from which the robot stops within a distance if it reacts after ``react`` [s]."""
    return 2.0 * distance / (react + np.sqrt(react**2 + 2.0 * distance / brake))


def _times(a: Interval, b: Interval) -> Interval:
    products = a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1]
    return np.minimum.reduce(np.broadcast_arrays(*products)), np.maximum.reduce(np.broadcast_arrays(*products))


def _cosine(a: Interval) -> Interval:
    """Bound the cosine, which is 1 at even and -1 at odd multiples of pi."""
    one, other = np.cos(a[0]), np.cos(a[1])
    first, last = np.ceil(a[0] / math.pi), np.floor(a[1] / math.pi)
    even, odd = 2.0 * np.ceil(0.5 * first) <= last, 2.0 * np.ceil(0.5 * (first - 1.0)) + 1.0 <= last
    return np.where(odd, -1.0, np.minimum(one, other)), np.where(even, 1.0, np.maximum(one, other))


def _absolute(a: Interval) -> Interval:
    one, other = np.abs(a[0]), np.abs(a[1])
    return np.where((a[0] <= 0.0) & (a[1] >= 0.0), 0.0, np.minimum(one, other)), np.maximum(one, other)


def _sinc(a: Interval) -> Interval:
    """Bound sin(a) / a, which falls with |a| up to pi."""
    near, far = _absolute(a)
    return np.sinc(far / math.pi), np.sinc(near / math.pi)


class Slices(NamedTuple):
    """Slices of the measured bearing; arrays (slices, 1). The true bearing of a slice is in one column of alpha."""

    column: NDArray[np.int64]
    alpha: Interval
    """[rad] true bearing"""
    measured: Interval
    """[rad] measured bearing, within +-pi"""
    error: Interval
    """[rad] error of the measured direction of the goal"""


def slices_of(loop: MakerLoop, rho: float, alphas: int) -> Slices:
    """Divide the range of the measured bearing into slices, for each column with alpha >= 0.

    Args:
        loop: loop with the contract of this row.
        rho: [m] smallest distance of the row, above ``eps_rho``.
        alphas: number of columns from -pi to pi. It is a multiple of 4, so that no slice contains pi, where the law is
            discontinuous.
    """
    width, max_error = 2.0 * math.pi / alphas, math.asin(loop.eps_rho / rho)
    reach, cut = max_error + loop.eps_theta, 2.0 * math.pi / alphas * _COLUMNS
    column = np.arange(alphas // 2)[:, None]
    low, high = column * width, (column + 1) * width
    number = np.floor((low - reach) / cut) + np.arange(math.ceil((width + 2.0 * reach) / cut) + 1)
    p = np.maximum(number * cut - _OVERLAP * width, low - reach)
    q = np.minimum((number + 1.0) * cut + _OVERLAP * width, high + reach)
    error = np.maximum(p - high - loop.eps_theta, -max_error), np.minimum(q - low + loop.eps_theta, max_error)
    alpha = np.maximum(low, p - reach), np.minimum(high, q + reach)
    turned = 2.0 * math.pi * np.round((number + 0.5) * cut / (2.0 * math.pi))
    measured = np.clip(p - turned, -math.pi, math.pi), np.clip(q - turned, -math.pi, math.pi)
    valid = p < q

    def valid_rows(a: Any) -> Any:
        return np.broadcast_to(a, valid.shape)[valid][:, None]

    pairs = [(valid_rows(a), valid_rows(b)) for a, b in (alpha, measured, error)]
    return Slices(valid_rows(column), *pairs)


def _measured_distance(loop: MakerLoop, rho: Interval, error: Interval) -> Interval:
    """Bound the measured distance [m] for a range of the direction error; see checker_bounds.measured_distance."""
    least = _absolute(error)[0]
    chord = np.sqrt(np.maximum(loop.eps_rho**2 - (rho[0] * np.sin(least)) ** 2, 0.0))
    return rho[0] * np.cos(least) - chord, rho[1] * np.cos(least) + chord


def _scale(loop: MakerLoop, phi: Any, turn: Any, speed: Any) -> Any:
    """Return the largest s in [0, 1] for which (s speed, phi + s turn) keeps the limits of a turn to the left."""
    s = np.ones(1)
    for room, rate in (
        (loop.omega_max - phi, turn),
        (loop.rim - loop.half * phi, speed + loop.half * turn),
    ):
        free = np.maximum(room, 0.0)
        s = np.minimum(s, np.where(rate > free, free / np.maximum(rate, 1e-300), 1.0))
    return s


def _command(loop: MakerLoop, rho: Interval, alpha: Interval, beta: Interval) -> tuple[Interval, Interval]:
    """Bound the speed [m/s] and the rotation [rad/s] that the law requests for measured values."""
    near, far = rho
    slowest = np.minimum(_braking(far, loop.brake, loop.slow_react), loop.v_max)
    fastest = np.minimum(_braking(near, loop.brake, loop.react), loop.v_max)
    phi = tuple(
        np.copysign(np.minimum(_braking(np.abs(a), loop.turn_brake, loop.turn_react), loop.omega_max), a) for a in alpha
    )
    speed = (
        np.minimum(_braking(near, loop.brake, loop.slow_react), loop.v_max),
        np.minimum(_braking(far, loop.brake, loop.react), loop.v_max),
    )
    cosine = _cosine(alpha)
    v = _times(speed, cosine)
    weight = loop.weight * np.minimum(near / BEARING_FADE, 1.0), loop.weight * np.minimum(far / BEARING_FADE, 1.0)
    aside = _times(weight, beta)
    rate = _times((slowest / far, fastest / near), _times(cosine, _sinc(alpha)))
    turn = _times(rate, (alpha[0] + aside[0], alpha[1] + aside[1]))
    slow, fast = _absolute(v)
    low = np.minimum(_scale(loop, phi[1], turn[1], fast), _scale(loop, -phi[0], -turn[0], fast))
    high = np.minimum(_scale(loop, phi[0], turn[0], slow), _scale(loop, -phi[1], -turn[1], slow))
    v, turn = _times(v, (low, high)), _times(turn, (low, high))
    omega = np.maximum(phi[0] + turn[0], -loop.omega_max), np.minimum(phi[1] + turn[1], loop.omega_max)
    v_limit = loop.rim - loop.half * _absolute(omega)[0]
    return (np.maximum(v[0], -v_limit), np.minimum(v[1], v_limit)), omega


def _square(rho: Any, u: Any, cosine: Any) -> Any:
    """Return the square of the distance [m^2] after a chord u."""
    return rho**2 - 2.0 * rho * u * cosine + u**2


def _moved(loop: MakerLoop, states: tuple[Interval, ...], v: Interval, omega: Interval) -> list[Any]:
    """Return the sides of boxes (rho, alpha, beta) after a step. Angles are not wrapped. rho < 0 means no bound."""
    rho, alpha, beta = states
    error = loop.noise * np.maximum(_absolute(v)[1], loop.half * _absolute(omega)[1])
    turned = error / loop.half + loop.eps_omega
    z = loop.t_s * (omega[0] - turned), loop.t_s * (omega[1] + turned)
    chord = loop.t_s * (v[0] - error), loop.t_s * (v[1] + error)
    u = _times(chord, _sinc((0.5 * z[0], 0.5 * z[1])))
    psi = alpha[0] - 0.5 * z[1], alpha[1] - 0.5 * z[0]
    cosine = _cosine(psi)
    along = _times(u, cosine)
    aside = _times(u, _cosine((psi[0] - 0.5 * math.pi, psi[1] - 0.5 * math.pi)))
    low, high = rho[0] - along[1], rho[1] - along[0]
    tau = (
        np.arctan2(aside[0], np.where(aside[0] < 0.0, low, high)),
        np.arctan2(aside[1], np.where(aside[1] > 0.0, low, high)),
    )
    # rho'^2 = rho^2 - 2 rho u cos(psi) + u^2 rises with rho, is linear in the cosine and convex in u.
    far = np.sqrt(np.maximum.reduce([_square(rho[1], end, c) for end in u for c in cosine])) + loop.offset
    feet = [_square(rho[0], np.clip(rho[0] * c, *u), c) for c in cosine]
    bounded = (low > 0.0) & (np.maximum(np.abs(z[0]), np.abs(z[1])) < math.pi)
    near = np.where(bounded, np.sqrt(np.minimum.reduce(feet)) - loop.offset, -1.0)
    # The angle at the goal between the end of the chord and the farthest possible end of the step.
    angle = np.arcsin(np.clip(loop.offset / (near + loop.offset), 0.0, 1.0))
    return [
        near,
        far,
        alpha[0] - z[1] + tau[0] - angle,
        alpha[1] - z[0] + tau[1] + angle,
        beta[0] + tau[0] - angle,
        beta[1] + tau[1] + angle,
    ]


class Boxes(NamedTuple):
    """Images of the cells of a row."""

    boxes: NDArray[np.float32]
    """(n, 6) bounds of rho [m], alpha [rad] and beta [rad], enlarged by PADDING. Angles are not wrapped"""
    start: NDArray[np.int64]
    """(cells + 1,) index of the first image of each cell"""


def boxes_of_row(loop: MakerLoop, rho: Interval, alphas: int, betas: int) -> Boxes | None:
    """Return the images of the cells of a row after one step of Omega_G, or None if an image is not bounded.

    Args:
        loop: loop with the contract of this row.
        rho: [m] edges of the row.
        alphas: number of columns of alpha from -pi to pi. Only cells with alpha >= 0 have images.
        betas: number of columns of beta from -pi to pi.
    """
    slices = slices_of(loop, rho[0], alphas)
    measured_rho = _measured_distance(loop, rho, slices.error)
    edges = -math.pi + 2.0 * math.pi / betas * np.arange(betas + 1.0)
    images, cells = [], []
    for turns in (-1, 0, 1):
        low = np.maximum(edges[:-1] + slices.error[0] - 2.0 * math.pi * turns, -math.pi)
        high = np.minimum(edges[1:] + slices.error[1] - 2.0 * math.pi * turns, math.pi)
        columns = np.flatnonzero((low < high).any(axis=0))
        if not len(columns):
            continue
        valid = (low < high)[:, columns]
        commands = _command(loop, measured_rho, slices.measured, (low[:, columns], high[:, columns]))
        beta = edges[columns], edges[columns + 1]
        sides = _moved(loop, (rho, slices.alpha, beta), *commands)
        boxes = np.stack([np.broadcast_to(side, valid.shape)[valid] for side in sides], axis=1)
        if not boxes[:, 0].min() > 0.0:
            return None
        images.append(boxes)
        cells.append((slices.column * betas + columns)[valid])
    cell = np.concatenate(cells)
    order = np.argsort(cell, kind="stable")
    widened = np.concatenate(images)[order] + PADDING * np.array([-1.0, 1.0] * 3)
    counts = np.bincount(cell, minlength=alphas // 2 * betas)
    return Boxes(widened.astype(np.float32), np.concatenate(([0], np.cumsum(counts))))
