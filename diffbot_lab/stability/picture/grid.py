"""``diffbot stability picture``: whether V decreases for every admissible noise, at the points of a grid.

For a state, the noise box gives intervals of the measured rho, alpha and beta, and interval arithmetic on the law gives
intervals of v and omega that contain every possible command. One step of the paper's models (6), (7) is affine in v and
omega, and V is a convex quadratic form, so V after the step is largest at a corner: an upper bound of dV for *every*
admissible noise, up to rounding. It holds at the points of the grid alone. Between them V may increase at a higher
level than at any of them, so no statement about all states follows; for that see :mod:`level`.
"""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.law.controller import ControllerConfig
from diffbot_control.law.lyapunov_law import Gains
from diffbot_control.law.regions import smallest_radius
from diffbot_lab.stability.settings import NoiseBox

Array = NDArray[np.float64]
HALF_PI = 0.5 * math.pi
_POINTS_AT_A_TIME = 200_000


class Interval(NamedTuple):
    """Lower and upper bounds, arrays of one shape."""

    low: Array
    high: Array


class Grid(NamedTuple):
    """Points (rho, alpha, beta) as three arrays that broadcast to (n_rho, n_alpha, n_beta)."""

    rho: Array
    alpha: Array
    beta: Array


def make_grid(rho_max: float, number: int) -> Grid:
    """Return ``number`` distances up to ``rho_max`` [m], denser near the goal, and angles in (-pi, pi]."""
    rho = rho_max * (np.arange(1, number + 1) / number) ** 2
    # (-pi, pi]: the cut itself occurs once.
    angles = np.linspace(-math.pi, math.pi, (number | 1) + 1)[1:]
    return Grid(rho[:, None, None], angles[None, :, None], angles[None, None, :])


def measured(grid: Grid, box: NoiseBox) -> tuple[Interval, list[Interval], list[Interval]]:
    """Return the interval of the measured rho, and two intervals each whose union contains alpha and beta.

    Two, because an angle near pi may be measured on the other side of the cut, where the law is discontinuous. If the
    goal is nearer than the position error, its bearing is arbitrary.
    """
    shift = np.full_like(grid.rho, math.pi)
    known = grid.rho > box.eps_position
    shift[known] = np.arcsin(box.eps_position / grid.rho[known])
    rho = Interval(np.maximum(grid.rho - box.eps_position, 0.0), grid.rho + box.eps_position)
    return rho, _pieces(grid.alpha, shift + box.eps_theta), _pieces(grid.beta, shift)


def _pieces(centre: Array, half: Array) -> list[Interval]:
    """Split [centre - half, centre + half] at +-pi and wrap it; both pieces are equal where it is not split."""
    low, high = centre - half, centre + half
    everywhere = half >= math.pi
    below, above = low < -math.pi, high > math.pi
    first = Interval(
        np.where(everywhere | below, -math.pi, low), np.where(everywhere | (above & ~below), math.pi, high)
    )
    second = Interval(
        np.where(below & ~everywhere, low + 2.0 * math.pi, np.where(above, -math.pi, first.low)),
        np.where(below | everywhere, math.pi, np.where(above, high - 2.0 * math.pi, first.high)),
    )
    return [first, second]


def commands(rho: Interval, alpha: Interval, beta: Interval, gains: Gains) -> tuple[Interval, Interval]:
    """Return intervals that contain v and omega of law (13) for all rho, alpha, beta in the given intervals."""
    cosine, sine = _cosine(alpha), _sine(alpha)
    v = _product(Interval(gains.gamma * np.tanh(rho.low), gains.gamma * np.tanh(rho.high)), cosine)
    # omega = k alpha + gamma tanhc(rho) cos(alpha) (sin(alpha) + h beta sinc(alpha)); tanhc decreases with rho.
    turn = Interval(gains.gamma * _tanhc(rho.high), gains.gamma * _tanhc(rho.low))
    lateral = _product(Interval(gains.h * beta.low, gains.h * beta.high), _sinc(alpha))
    steer = _product(_product(turn, cosine), Interval(sine.low + lateral.low, sine.high + lateral.high))
    return v, Interval(gains.k * alpha.low + steer.low, gains.k * alpha.high + steer.high)


def worst_rate(grid: Grid, gains: Gains, box: NoiseBox, t_s: float) -> Array:
    """Upper bound of dV / Ts over the noise box at each point, law (13) with V of Eq. (8); shape of the grid."""
    rho, alphas, betas = measured(grid, box)
    worst = np.full(np.broadcast(grid.rho, grid.alpha, grid.beta).shape, -math.inf)
    for alpha, beta in itertools.product(alphas, betas):
        v, omega = commands(rho, alpha, beta, gains)
        v = Interval(v.low - box.eps_v, v.high + box.eps_v)
        omega = Interval(omega.low - box.eps_omega, omega.high + box.eps_omega)
        worst = np.maximum(worst, _largest_next_level(grid, v, omega, gains, t_s))
    return (worst - level_of(grid, gains)) / t_s


def _largest_next_level(grid: Grid, v: Interval, omega: Interval, gains: Gains, t_s: float) -> Array:
    """Upper bound of V one step later over all v and omega, by the models with v along the robot's real axis."""
    ahead = t_s * np.cos(grid.alpha)
    sideways = t_s * np.sin(grid.alpha) / grid.rho
    corners = []
    for speed, turn in itertools.product(v, omega):
        moved = sideways * speed
        corners.append((grid.rho - ahead * speed, grid.alpha + moved - t_s * turn, grid.beta + moved))
    squares = [(rho**2, _wrapped(alpha) ** 2, gains.h * _wrapped(beta) ** 2) for rho, alpha, beta in corners]
    largest = np.max([rho + alpha + beta for rho, alpha, beta in squares], axis=0)
    # Across the cut the square of an angle is not convex: between the corners it may reach pi^2.
    alpha_cut, beta_cut = _crosses_cut([c[1] for c in corners]), _crosses_cut([c[2] for c in corners])
    rho_part, alpha_part, beta_part = (np.max([parts[i] for parts in squares], axis=0) for i in range(3))
    apart = rho_part + np.where(alpha_cut, math.pi**2, alpha_part) + np.where(beta_cut, gains.h * math.pi**2, beta_part)
    return np.asarray(0.5 * np.where(alpha_cut | beta_cut, apart, largest))


def _wrapped(angle: Array) -> Array:
    return np.asarray(math.pi - np.mod(math.pi - angle, 2.0 * math.pi))


def _crosses_cut(corners: list[Array]) -> NDArray[np.bool_]:
    """True where the cut, an odd multiple of pi, lies between the corner values of an angle."""
    turns = [np.ceil((angle - math.pi) / (2.0 * math.pi)) for angle in corners]
    return np.asarray(np.max(turns, axis=0) > np.min(turns, axis=0))


def level_of(grid: Grid, gains: Gains) -> Array:
    """V of Eq. (8) at each point."""
    return np.asarray(0.5 * (grid.rho**2 + grid.alpha**2 + gains.h * grid.beta**2))


def highest_rise(level: Array, worst: Array) -> float:
    """Return the largest V of the points at which V may increase, 0 if there is none."""
    failing = level[worst >= 0.0]
    return float(failing.max()) if failing.size else 0.0


def heading_bound(gains: Gains, box: NoiseBox, t_s: float) -> float:
    """Ultimate bound [rad] of |theta| in Omega_L, by algebra; inf if the sampled loop is not contracting.

    theta+ = (1 - k_2 Ts) theta - Ts (k_2 eps_theta + eps_omega), so |theta| converges below
    Ts (k_2 eps_theta + eps_omega) / (1 - |1 - k_2 Ts|).
    """
    contraction = abs(1.0 - gains.k_2 * t_s)
    if contraction >= 1.0:
        return math.inf
    return t_s * (gains.k_2 * box.eps_theta + box.eps_omega) / (1.0 - contraction)


def _tanhc(rho: Array) -> Array:
    return np.where(rho < 1e-4, 1.0 - rho * rho / 3.0, np.tanh(rho) / np.maximum(rho, 1e-4))


def _product(a: Interval, b: Interval) -> Interval:
    corners = [a.low * b.low, a.low * b.high, a.high * b.low, a.high * b.high]
    return Interval(
        np.minimum(np.minimum(corners[0], corners[1]), np.minimum(corners[2], corners[3])),
        np.maximum(np.maximum(corners[0], corners[1]), np.maximum(corners[2], corners[3])),
    )


def _cosine(angle: Interval) -> Interval:
    """Cosine over an interval within [-pi, pi]."""
    ends = np.cos(angle.low), np.cos(angle.high)
    holds_zero = (angle.low <= 0.0) & (angle.high >= 0.0)
    return Interval(np.minimum(*ends), np.where(holds_zero, 1.0, np.maximum(*ends)))


def _sine(angle: Interval) -> Interval:
    """Sine over an interval within [-pi, pi]."""
    ends = np.sin(angle.low), np.sin(angle.high)
    holds_top = (angle.low <= HALF_PI) & (angle.high >= HALF_PI)
    holds_bottom = (angle.low <= -HALF_PI) & (angle.high >= -HALF_PI)
    return Interval(np.where(holds_bottom, -1.0, np.minimum(*ends)), np.where(holds_top, 1.0, np.maximum(*ends)))


def _sinc(angle: Interval) -> Interval:
    """Return the interval of sin(a)/a within [-pi, pi], where it decreases with |a|."""
    largest = np.maximum(np.abs(angle.low), np.abs(angle.high))
    smallest = np.where(
        (angle.low <= 0.0) & (angle.high >= 0.0), 0.0, np.minimum(np.abs(angle.low), np.abs(angle.high))
    )
    return Interval(np.sinc(largest / math.pi), np.sinc(smallest / math.pi))


def evaluate_grid(
    controller: ControllerConfig, box: NoiseBox, t_s: float, rho_max: float, number: int
) -> dict[str, Any]:
    """Evaluate the grid; return figures of its points, and under ``maps`` the arrays for the figure."""
    grid = make_grid(rho_max, number)
    c = step = farthest = 0.0
    failing = 0
    over_alpha, over_beta = [], []
    # In slabs of a few distances: the whole grid would need gigabytes.
    size = max(1, _POINTS_AT_A_TIME // (grid.alpha.size * grid.beta.size))
    for at in range(0, number, size):
        slab = Grid(grid.rho[at : at + size], grid.alpha, grid.beta)
        worst = worst_rate(slab, controller.gains, box, t_s)
        over_alpha.append(worst.max(axis=2))
        over_beta.append(worst.max(axis=1))
        bad = worst >= 0.0
        if bad.any():
            failing += int(bad.sum())
            c = max(c, highest_rise(level_of(slab, controller.gains), worst))
            # From inside, one step may raise V above c; after it V decreases again.
            step = max(step, t_s * float(worst[bad].max()))
            farthest = max(farthest, float(slab.rho[bad.any(axis=(1, 2))].max()))
    points = number * grid.alpha.size * grid.beta.size
    return {
        "grid_points": points,
        "share_decreasing": 1.0 - failing / points,
        "level": c,
        "distance_of_level": math.sqrt(2.0 * (c + step)),
        "largest_distance_without_decrease": farthest,
        "inside_grid": bool(math.sqrt(2.0 * (c + step)) < rho_max),
        "heading_bound_local": heading_bound(controller.gains, box, t_s),
        "radius_condition": smallest_radius(box.eps_x, box.eps_y, box.eps_v, controller.gains.gamma),
        "eps_P": controller.region_policy.fixed.eps_P,
        "maps": {
            "rho": grid.rho.ravel(),
            "angle": grid.alpha.ravel(),
            "over_alpha": np.concatenate(over_alpha),
            "over_beta": np.concatenate(over_beta),
        },
    }
