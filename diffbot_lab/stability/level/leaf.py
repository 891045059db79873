"""Bounds of the checker: is a level's claim shown in a box of states? With formulas and rounding of its own.

It shares no code with the search. Rounding: see interval/plain.py.

Geometry: in a frame whose x axis points from the robot to the goal, the goal is at (rho, 0). The robot moves by L in a
direction to which the goal's bearing is a; from there the goal is at (rho - L cos a, L sin a). For a box of (rho, L, a)
these points lie in the convex hull of eight corners, and the goal's bearing changes by the direction of one of them at
most. An error of the measured position is such a move, too.

All changes of V are largest at corners:

- (rho+^2 - rho^2) / 2 = L (L / 2 - rho cos a) is convex in L, and linear in rho and in cos a;
- (alpha+^2 - alpha^2) / 2 = s (alpha + s / 2), s = alpha+ - alpha, is convex in s and linear in alpha; beta likewise.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_lab.stability.interval.plain import SLACK, Array, Pair, cosine, sinc, tanhc, times, wide
from diffbot_lab.stability.level.problem import LevelProblem

Mask = NDArray[np.bool_]

PI = math.pi + SLACK
TURN = 2.0 * math.pi


class Boxes(NamedTuple):
    """Boxes of states and of the noise in one step, as bounds in flat arrays."""

    rho: Pair
    """[m]"""
    alpha: Pair
    """[rad]"""
    beta: Pair
    """[rad] from 0 to pi"""
    measured: Pair
    """[rad] alpha as it is measured, before it is wrapped"""
    eps_v: Pair
    """[m/s]"""
    eps_omega: Pair
    """[rad/s]"""

    @classmethod
    def of(cls, rows: Array) -> Boxes:
        """Return boxes out of rows (n, 12) of lower and upper bounds."""
        return cls(*((rows[:, 2 * i], rows[:, 2 * i + 1]) for i in range(6)))

    def take(self, index: NDArray[np.intp]) -> Boxes:
        """Return some of them."""
        return Boxes(*((low[index], high[index]) for low, high in self))


def top_of(problem: LevelProblem, rho_max: float) -> float:
    """Return a number that V does not exceed within ``rho_max`` [m] of the goal."""
    return 0.5 * (rho_max**2 + (1.0 + problem.h) * PI**2) * (1.0 + SLACK)


def root_of(problem: LevelProblem, top: float) -> Array:
    """Return a box (12,) of all states with V <= ``top`` and beta >= 0, and all noise there.

    The mirror image of a step has the same V, and the signs of alpha, beta and four errors change: so beta < 0 follows.
    """
    farthest = math.sqrt(2.0 * top) * (1.0 + SLACK)
    # The bearing's error is pi at most.
    measured = 2.0 * PI + problem.eps_theta
    sides = (0.0, farthest), (-PI, PI), (0.0, PI), (-measured, measured)
    return np.array([*itertools.chain(*sides), *_both(problem.eps_v), *_both(problem.eps_omega)])


def _both(bound: float) -> tuple[float, float]:
    return -bound, bound


def settled(boxes: Boxes, problem: LevelProblem, level: float, top: float) -> Mask:
    """Whether it is shown for each box, for every noise: V decreases if level < V <= top, and V <= level stays so."""
    (a0, a1), (b0, b1) = _square(boxes.alpha), _square(boxes.beta)
    angles = wide(a0 + problem.h * b0, a1 + problem.h * b1)
    distance = _square(boxes.rho)
    low, high = wide(0.5 * (angles[0] + distance[0]), 0.5 * (angles[1] + distance[1]))
    shown = np.ones(len(low), np.bool_)
    # rho^2 = 2 V - alpha^2 - h beta^2
    above = np.flatnonzero(~(low > top) & ~(high <= level))
    nearest = np.sqrt(np.maximum(2.0 * level - angles[1][above], 0.0))
    part = boxes.take(above)
    part = part._replace(rho=(np.maximum(part.rho[0], nearest * (1.0 - SLACK)), part.rho[1]))
    shown[above] = highest_rise(part, problem) < 0.0
    below = np.flatnonzero(~(low > level))
    farthest = np.sqrt(np.maximum(2.0 * level - angles[0][below], 0.0) + SLACK)
    part = boxes.take(below)
    part = part._replace(rho=(part.rho[0], np.minimum(part.rho[1], farthest * (1.0 + SLACK))))
    shown[below] &= highest_rise(part, problem) <= (level - np.minimum(high[below], level)) * (1.0 - SLACK)
    return shown


def highest_rise(boxes: Boxes, problem: LevelProblem) -> Array:
    """Return upper bounds of V+ - V in each box, for all admissible noise; -inf where no noise leads to it."""
    error, boxes = measurable(boxes, problem)
    highest = np.full(len(boxes.rho[0]), -np.inf)
    sides = (*error, *itertools.chain(*boxes))
    possible = ~np.any([low > high for low, high in zip(sides[::2], sides[1::2], strict=True)], axis=0)
    beta = wide(boxes.beta[0] + error[0], boxes.beta[1] + error[1])
    # What is measured is wrapped to [-pi, pi], on whichever side of the cut it lies.
    for of_alpha, of_beta in itertools.product((-1, 0, 1), repeat=2):
        alpha_seen, beta_seen = _within_a_turn(boxes.measured, of_alpha), _within_a_turn(beta, of_beta)
        may_be = possible & ~(alpha_seen[0] > alpha_seen[1]) & ~(beta_seen[0] > beta_seen[1])
        index = np.flatnonzero(may_be)
        part, seen = boxes.take(index), [(low[index], high[index]) for low, high in (alpha_seen, beta_seen)]
        length, turn = motion_of(part, seen[0], seen[1], problem)
        highest[index] = np.maximum(highest[index], rise_of(part, length, turn, problem))
    return highest


def _within_a_turn(angle: Pair, turns: int) -> Pair:
    low, high = wide(angle[0] - TURN * turns, angle[1] - TURN * turns)
    return np.maximum(low, -PI), np.minimum(high, PI)


def measurable(boxes: Boxes, problem: LevelProblem) -> tuple[Pair, Boxes]:
    """Return bounds of the bearing's error [rad] from the position's, and the boxes without what cannot be measured."""
    error, eps = bearing_error(boxes, problem), problem.eps_theta
    (a0, a1), (m0, m1), (e0, e1) = boxes.alpha, boxes.measured, error
    # measured alpha = alpha + error of the bearing - error of the heading
    measured, alpha = wide(a0 + e0 - eps, a1 + e1 + eps), wide(m0 - e1 - eps, m1 - e0 + eps)
    of_both = wide(m0 - a1 - eps, m1 - a0 + eps)
    narrower = boxes._replace(alpha=_common(boxes.alpha, alpha), measured=_common(boxes.measured, measured))
    return _common(error, of_both), narrower


def _common(a: Pair, b: Pair) -> Pair:
    return np.maximum(a[0], b[0]), np.minimum(a[1], b[1])


def bearing_error(boxes: Boxes, problem: LevelProblem) -> Pair:
    """Return bounds of the error [rad] of the goal's bearing that the position's error causes.

    The measured position is in a rectangle. Seen from the goal, its corners are in the extreme directions; and a
    tangent to the circle around it is at the angle arcsin(radius / rho).
    """
    distance = np.full_like(boxes.rho[0], math.hypot(problem.eps_x, problem.eps_y))
    errors = []
    for x, y in itertools.product(_both(problem.eps_x), _both(problem.eps_y)):
        direction = math.atan2(y, x)
        relative = wide(boxes.beta[0] - direction, boxes.beta[1] - direction)
        errors.append(swing(boxes.rho, wide(distance, distance), relative))
    of_corners = np.minimum.reduce([low for low, _ in errors]), np.maximum.reduce([high for _, high in errors])
    # Up to 0.99 the arc sine magnifies rounding eightfold at most.
    outside = distance < 0.99 * boxes.rho[0]
    tangent = np.where(outside, np.arcsin(np.minimum(distance / np.maximum(boxes.rho[0], SLACK), 0.99)) + SLACK, PI)
    return _common(of_corners, (-tangent, tangent))


def swing(rho: Pair, length: Pair, direction: Pair) -> Pair:
    """Return bounds of the change [rad] of the goal's bearing when the robot moves, or is measured elsewhere.

    Args:
        rho: [m] distance of the goal.
        length: [m] of the move, may be negative.
        direction: [rad] bearing of the goal less the direction of the move.
    """
    half = 0.5 * (direction[1] - direction[0])
    # Corners farther out by 1 / cos(half angle): the sides between them are outside of the arcs.
    stretch = 1.0 / np.cos(np.minimum(half, 1.0)) + SLACK
    l0, l1 = (
        np.where(length[0] < 0.0, length[0] * stretch, length[0]),
        np.where(length[1] > 0.0, length[1] * stretch, length[1]),
    )
    corners = [
        (r - one * np.cos(angle), one * np.sin(angle)) for r, one, angle in itertools.product(rho, (l0, l1), direction)
    ]
    nearest = np.minimum.reduce([x for x, _ in corners])
    angles = [np.arctan2(y, x) for x, y in corners]
    low, high = wide(np.minimum.reduce(angles), np.maximum.reduce(angles))
    # So far in front of the goal that a direction has no more error than the corners.
    clear = (half <= 1.0) & (nearest > 1e-3 * (rho[1] + np.maximum(np.abs(l0), np.abs(l1))))
    return np.where(clear, low, -PI), np.where(clear, high, PI)


def motion_of(boxes: Boxes, alpha: Pair, beta: Pair, problem: LevelProblem) -> tuple[Pair, Pair]:
    """Return bounds of Ts (v + eps_v) [m] and Ts (omega + eps_omega) [rad], law (13) as printed.

    Args:
        boxes: true distances and input noise.
        alpha: [rad] measured, wrapped.
        beta: [rad] measured, wrapped.
        problem: law and noise.
    """
    reach = math.hypot(problem.eps_x, problem.eps_y) + SLACK
    rho = wide(boxes.rho[0] - reach, boxes.rho[1] + reach)
    rho = np.maximum(rho[0], 0.0), rho[1]
    facing = cosine(alpha)
    v0, v1 = times(wide(problem.gamma * np.tanh(rho[0]), problem.gamma * np.tanh(rho[1])), facing)
    factor = times(times(sinc(alpha), tanhc(rho)), facing)
    w0, w1 = times(factor, wide(alpha[0] + problem.h * beta[0], alpha[1] + problem.h * beta[1]))
    w0, w1 = wide(problem.k * alpha[0] + problem.gamma * w0, problem.k * alpha[1] + problem.gamma * w1)
    t_s = problem.t_s
    length = wide(t_s * (v0 + boxes.eps_v[0]), t_s * (v1 + boxes.eps_v[1]))
    return length, wide(t_s * (w0 + boxes.eps_omega[0]), t_s * (w1 + boxes.eps_omega[1]))


def rise_of(boxes: Boxes, length: Pair, turn: Pair, problem: LevelProblem) -> Array:
    """Return upper bounds of V+ - V for a move by Ts v = ``length`` [m] and Ts omega = ``turn`` [rad]."""
    direction = boxes.alpha
    if problem.exact_arc:
        # The chord, of the length L sinc(turn / 2) in the direction turn / 2.
        half = 0.5 * turn[0], 0.5 * turn[1]
        length = times(length, _sinc(half))
        direction = wide(boxes.alpha[0] - half[1], boxes.alpha[1] - half[0])
    corners = itertools.product(length, boxes.rho, _cosine(direction))
    approach = np.maximum.reduce([one * (0.5 * one - rho * c) for one, rho, c in corners])
    d0, d1 = swing(boxes.rho, length, direction)
    of_alpha = _rise_of_square(boxes.alpha, wide(d0 - turn[1], d1 - turn[0]))
    of_beta = problem.h * _rise_of_square(boxes.beta, (d0, d1))
    # Rounding of the first is relative to its terms, which are not above this.
    largest = np.maximum(np.abs(length[0]), np.abs(length[1])) * (boxes.rho[1] + np.abs(length).max(axis=0))
    rise: Array = approach + of_alpha + of_beta + SLACK * (1.0 + largest + np.abs(of_alpha) + np.abs(of_beta))
    return rise


def _rise_of_square(angle: Pair, change: Pair) -> Array:
    """Upper bounds of ((angle + change)^2 - angle^2) / 2, with the sum wrapped to [-pi, pi]."""
    widest = 0.5 * (PI * PI - _square(angle)[0])
    highest = np.full_like(widest, -np.inf)
    for turns in (-1, 0, 1):
        s0, s1 = wide(change[0] - TURN * turns, change[1] - TURN * turns)
        s0, s1 = np.maximum(s0, -PI - angle[1] - SLACK), np.minimum(s1, PI - angle[0] + SLACK)
        corners = [s * (a + 0.5 * s) for s in (s0, s1) for a in angle]
        # Within [-pi, pi] the new angle is no farther from 0 than one of these.
        end = np.minimum(np.maximum(np.abs(angle[0] + s0), np.abs(angle[1] + s1)), PI) + SLACK
        bound = np.minimum(np.maximum.reduce(corners), 0.5 * (end * end - _square(angle)[0]))
        highest = np.where(s0 > s1, highest, np.maximum(highest, bound))
    beyond = (angle[0] + change[0] < -3.0 * math.pi) | (angle[1] + change[1] > 3.0 * math.pi)
    return np.where(beyond, widest, highest) + SLACK


def _square(a: Pair) -> Pair:
    near = np.where((a[0] <= 0.0) & (a[1] >= 0.0), 0.0, np.minimum(np.abs(a[0]), np.abs(a[1])))
    far = np.maximum(np.abs(a[0]), np.abs(a[1]))
    return wide(near * near, far * far)


def _cosine(a: Pair) -> Pair:
    """Cosine on any interval."""
    low, high = cosine(a)
    far = np.maximum(np.abs(a[0]), np.abs(a[1])) > 9.0
    return np.where(far, -1.0, low), np.where(far, 1.0, high)


def _sinc(a: Pair) -> Pair:
    """sin(a)/a on any interval; its least value is -0.2172..."""
    low, high = sinc(a)
    far = np.maximum(np.abs(a[0]), np.abs(a[1])) > 4.0
    return np.where(far, -0.22, low), np.where(far, 1.0, high)
