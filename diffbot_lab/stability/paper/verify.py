"""``diffbot stability verify``: checks a certificate again, cell by cell, with formulas and rounding of its own.

It shares no code with what made the certificate, and assumes nothing of how that was done. Rounding: see
interval/plain.py.

Geometry: in a frame whose x axis points from the robot to the goal, the robot leaves at the angle -alpha. One step
leads into a sector of a ring, which lies in a quadrilateral; seen from there, the goal is in the convex hull of eight
points. Its farthest point and its extreme directions are corners; the distance to it is at least that to its
projection on any direction.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.interval.plain import SLACK, Pair, cosine, sinc, tanhc, times, wide
from diffbot_lab.stability.paper.file import EXACT_ARC, Certificate, Loop
from diffbot_lab.stability.paper.lookup import RankLookup

Array = NDArray[np.float64]

PI = math.pi + SLACK
_SLICE = 0.04
"""[rad] of the measured bearing, at first"""
_BATCH = 4096
"""cells at a time"""
_LEVELS = 5
"""A cell that does not pass is split into 2 x 2 parts and its slices into halves, so many times less one ..."""
_HOPELESS = 1600
"""... unless more cells of a batch than that do not pass at first, or than a quarter of that after each splitting."""


class Boxes(NamedTuple):
    """Closed cells, as flat arrays."""

    r0: Array
    r1: Array
    a0: Array
    a1: Array

    def take(self, index: NDArray[np.intp]) -> Boxes:
        """Return some of them."""
        return Boxes(*(one[index] for one in self))


class Slices(NamedTuple):
    """Measurements, flat: what the law may be given in a cell."""

    cell: NDArray[np.intp]
    """index of the cell"""
    distance: Pair
    """[m]"""
    bearing: Pair
    """[rad] wrapped"""


def slices_of(loop: Loop, boxes: Boxes, width: float) -> Slices:
    """Cover what may be measured in each cell by slices of the measured bearing of at most ``width`` [rad]."""
    error = math.hypot(loop.eps_x, loop.eps_y) + SLACK
    widest = np.arcsin(np.minimum(error / boxes.r0, 1.0)) + SLACK
    low, high = boxes.a0 - widest - loop.eps_theta - SLACK, boxes.a1 + widest + loop.eps_theta + SLACK
    number = math.ceil(float((high - low).max()) / width)
    share = np.arange(number + 1) / number
    edges = low[:, None] + (high - low)[:, None] * share
    p, q = edges[:, :-1] - SLACK, edges[:, 1:] + SLACK
    # The measured goal is off by an angle between these two.
    d0 = np.maximum(p - boxes.a1[:, None] - loop.eps_theta, -widest[:, None]) - SLACK
    d1 = np.minimum(q - boxes.a0[:, None] + loop.eps_theta, widest[:, None]) + SLACK
    off = np.where((d0 <= 0.0) & (d1 >= 0.0), 0.0, np.minimum(np.abs(d0), np.abs(d1)))
    r0, r1 = boxes.r0[:, None], boxes.r1[:, None]
    half = np.sqrt(np.maximum(error**2 - (r0 * np.sin(off)) ** 2, 0.0) + SLACK)
    far = r1 * np.cos(off) + half + SLACK
    # The ends of the ray's way through the disc have the product rho^2 - error^2.
    near = (r0**2 - error**2) / (r0 * np.cos(off) + half) - SLACK
    parts = []
    for turn in (-1, 0, 1):
        b0, b1 = np.maximum(p - 2.0 * math.pi * turn - SLACK, -PI), np.minimum(q - 2.0 * math.pi * turn + SLACK, PI)
        cell, part = np.nonzero((b0 <= b1) & (d0 <= d1))
        at = cell, part
        parts.append((cell, np.maximum(near[at], 0.0), far[at], b0[at], b1[at]))
    cell, near, far, b0, b1 = (np.concatenate(one) for one in zip(*parts, strict=True))
    return Slices(cell, (near, far), (b0, b1))


def commands_of(loop: Loop, slices: Slices) -> tuple[NDArray[np.intp], Pair, Pair]:
    """Return cells, and bounds of v [m/s] and omega [rad/s] with the input noise; both regions where both may be."""
    near, far = slices.distance
    everywhere = far >= loop.eps_P
    local = (near <= loop.eps_P_leave) & (loop.eps_P_leave > 0.0)
    cells, bounds = [], []
    for use, distance in (
        (everywhere, (np.maximum(near, loop.eps_P), far)),
        (local, (near, np.minimum(far, loop.eps_P_leave))),
    ):
        index = np.flatnonzero(use)
        rho = distance[0][index], distance[1][index]
        alpha = slices.bearing[0][index], slices.bearing[1][index]
        facing = cosine(alpha)
        v = times(wide(loop.gamma * np.tanh(rho[0]), loop.gamma * np.tanh(rho[1])), facing)
        if use is everywhere:
            omega = _global_omega(loop, rho, alpha, facing)
        else:
            omega = np.full_like(v[0], -loop.k_2 * PI), np.full_like(v[0], loop.k_2 * PI)
        cells.append(slices.cell[index])
        noisy = wide(v[0] - loop.eps_v, v[1] + loop.eps_v), wide(omega[0] - loop.eps_omega, omega[1] + loop.eps_omega)
        bounds.append((*noisy[0], *noisy[1]))
    v0, v1, w0, w1 = (np.concatenate(one) for one in zip(*bounds, strict=True))
    return np.concatenate(cells), (v0, v1), (w0, w1)


def _global_omega(loop: Loop, rho: Pair, alpha: Pair, facing: Pair) -> Pair:
    """Eq. (13) as printed: k alpha + gamma (sin(alpha)/alpha) (tanh(rho)/rho) cos(alpha) (alpha + h beta)."""
    factor = times(times(sinc(alpha), tanhc(rho)), facing)
    steer = times(factor, wide(alpha[0] - loop.h * PI, alpha[1] + loop.h * PI))
    return wide(loop.k * alpha[0] + loop.gamma * steer[0], loop.k * alpha[1] + loop.gamma * steer[1])


def images_of(loop: Loop, boxes: Boxes, v: Pair, omega: Pair) -> tuple[Pair, Pair]:
    """Return bounds of rho [m] and of alpha [rad], not wrapped, after a step from each box with these commands.

    Raises:
        DiffbotError: if a step may come as far as the goal.
    """
    turn = wide(loop.t_s * omega[0], loop.t_s * omega[1])
    length = wide(loop.t_s * v[0], loop.t_s * v[1])
    left = -boxes.a1, -boxes.a0
    if loop.plant == EXACT_ARC:
        if not max(np.abs(turn[0]).max(initial=0.0), np.abs(turn[1]).max(initial=0.0)) < 8.0:
            raise DiffbotError("not verified: a step may turn by more than 8 rad")
        length = times(length, sinc((0.5 * turn[0], 0.5 * turn[1])))
        left = wide(left[0] + 0.5 * turn[0], left[1] + 0.5 * turn[1])
    # Corners farther out by 1 / cos(half angle): the sides between them are outside of the arcs.
    half = 0.5 * (left[1] - left[0])
    if not half.max(initial=0.0) < 1.5:
        raise DiffbotError("not verified: the cells are too wide")
    stretch = 1.0 / np.cos(half) + SLACK
    lengths = (
        np.where(length[0] < 0.0, length[0] * stretch, length[0]),
        np.where(length[1] > 0.0, length[1] * stretch, length[1]),
    )
    corners = [
        (r - one * np.cos(angle), -one * np.sin(angle))
        for r in (boxes.r0, boxes.r1)
        for one in lengths
        for angle in left
    ]
    if not min(x.min(initial=1.0) for x, _ in corners) > SLACK:
        raise DiffbotError("not verified: a step may come as far as the goal")
    middle = sum(x for x, _ in corners), sum(y for _, y in corners)
    norm = np.hypot(*middle)
    toward = middle[0] / norm, middle[1] / norm
    low = np.minimum.reduce([x * toward[0] + y * toward[1] for x, y in corners])
    high = np.maximum.reduce([np.hypot(x, y) for x, y in corners])
    angles = [np.arctan2(y, x) for x, y in corners]
    alpha = boxes.a0 + np.minimum.reduce(angles) - turn[1], boxes.a1 + np.maximum.reduce(angles) - turn[0]
    return wide(low, high), wide(*alpha)


def highest_next(loop: Loop, lookup: RankLookup, boxes: Boxes, width: float) -> NDArray[np.int16]:
    """Return for each box the highest rank that a state in it may lead to; TOO_HIGH beyond the ranked cells."""
    cell, v, omega = commands_of(loop, slices_of(loop, boxes, width))
    rho, alpha = images_of(loop, boxes.take(cell), v, omega)
    highest = np.zeros(len(boxes.r0), np.int16)
    np.maximum.at(highest, cell, lookup.highest(rho, alpha))
    return highest


def failing_cells(certificate: Certificate, threads: int | None = None) -> NDArray[np.intp]:
    """Return the flat indices of the ranked cells that may lead to a rank that is not smaller, or out of the core."""
    ranks = certificate.ranks.ravel()
    lookup = RankLookup(certificate)
    checked = np.flatnonzero(ranks >= 0)

    def failing(part: NDArray[np.intp]) -> NDArray[np.intp]:
        allowed = np.maximum(ranks[part] - 1, 0)
        for level in range(_LEVELS):
            boxes, owner = _split(certificate, part, 2**level)
            highest = np.zeros(len(part), np.int16)
            np.maximum.at(highest, owner, highest_next(certificate.loop, lookup, boxes, _SLICE / 2**level))
            bad = highest > allowed
            part, allowed = part[bad], allowed[bad]
            if len(part) == 0 or len(part) > _HOPELESS >> (2 * level):
                break
        return part

    parts = [checked[at : at + _BATCH] for at in range(0, len(checked), _BATCH)]
    with ThreadPoolExecutor(threads) as pool, tqdm(desc="verify", total=len(parts), unit="part", disable=None) as bar:
        return np.concatenate([*_counted(pool.map(failing, parts), bar), np.empty(0, np.intp)])


def _counted(results: Iterator[NDArray[np.intp]], bar: tqdm[None]) -> Iterator[NDArray[np.intp]]:
    for one in results:
        bar.update()
        yield one


def _split(certificate: Certificate, part: NDArray[np.intp], pieces: int) -> tuple[Boxes, NDArray[np.intp]]:
    """Return the cells in ``pieces`` x ``pieces`` parts, and the position in ``part`` of the cell of each."""
    row, column = np.divmod(part, len(certificate.alpha) - 1)
    owner = np.repeat(np.arange(len(part)), pieces * pieces)
    i, j = np.divmod(np.tile(np.arange(pieces * pieces), len(part)), pieces)
    sides = []
    for edges, line, number in ((certificate.rho, row, i), (certificate.alpha, column, j)):
        low, high = edges[line][owner], edges[line + 1][owner]
        step = (high - low) / pieces
        sides += list(wide(low + number * step, low + (number + 1) * step))
    return Boxes(*sides), owner


def verify(certificate: Certificate, threads: int | None = None) -> None:
    """Check every claim of a certificate.

    Raises:
        DiffbotError: naming the first thing that is not proved.
    """
    _check_cover(certificate)
    _check_inside(certificate)
    _check_claims(certificate)
    failing = failing_cells(certificate, threads)
    if len(failing):
        row, column = divmod(int(failing[0]), len(certificate.alpha) - 1)
        rho, alpha, rank = certificate.rho, certificate.alpha, int(certificate.ranks[row, column])
        where = f"rho {rho[row]:.4f} to {rho[row + 1]:.4f} m, alpha {alpha[column]:.4f} to {alpha[column + 1]:.4f} rad"
        meaning = "may leave the core" if rank == 0 else "may lead to a rank that is not smaller"
        raise DiffbotError(f"not verified: {len(failing)} cells; the first, {where}, of rank {rank}, {meaning}")


def _check_cover(certificate: Certificate) -> None:
    """The columns go all around; rows begin beyond the position error and the longest step."""
    loop, rho, alpha = certificate.loop, certificate.rho, certificate.alpha
    if not (alpha[0] <= -3.1415926535897936 and alpha[-1] >= 3.1415926535897936):
        raise DiffbotError("not verified: the columns of alpha do not cover -pi to pi")
    # With 1 % more, the arc sine of the ratio is well conditioned.
    least = 1.01 * max(math.hypot(loop.eps_x, loop.eps_y), loop.t_s * (loop.gamma + loop.eps_v))
    if not least < rho[0] <= rho[-1] <= 1e4:
        raise DiffbotError(f"not verified: rho begins at {rho[0]:g} m, must be above {least:g} m")


def _check_inside(certificate: Certificate) -> None:
    """Whatever a step from inside may lead to is in the core."""
    loop, rho = certificate.loop, certificate.rho
    speed = loop.gamma * math.tanh(rho[0] + math.hypot(loop.eps_x, loop.eps_y)) + loop.eps_v
    reach = rho[0] + loop.t_s * speed + SLACK
    if not (reach < rho[-1] and (certificate.ranks[rho[:-1] <= reach] == 0).all()):
        raise DiffbotError(f"not verified: a step from inside may lead to {reach:.4f} m, which is not all in the core")


def _check_claims(certificate: Certificate) -> None:
    """The claims are no more than what the ranks say."""
    claims, rho, ranks = certificate.claims, certificate.rho, certificate.ranks
    core = np.flatnonzero((ranks == 0).any(axis=1))
    if not (len(core) and rho[core[-1] + 1] <= claims.radius):
        raise DiffbotError(f"not verified: claims.radius = {claims.radius:g} m, the core reaches farther")
    starts = ranks[rho[:-1] <= claims.start]
    if not (claims.start < rho[-1] and (starts >= 0).all()):
        raise DiffbotError(f"not verified: claims.start = {claims.start:g} m, a cell within it has no rank")
    if not starts.max(initial=0) <= claims.steps:
        raise DiffbotError(f"not verified: claims.steps = {claims.steps}, a cell within the start has a higher rank")
