"""Kernels of ``diffbot stability level``: branch and bound over cells, depth first.

The tree is one byte per node in the order of the walk: 0 for a leaf, d + 1 for a node halved in dimension d. So a tree
covers its root without gaps by its form alone; what has to be checked is each leaf.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diffbot_lab.stability.interval.outward import PI_HIGH, down, sqrt, up
from diffbot_lab.stability.level.bounds import Cell, level_bounds, rise
from diffbot_lab.stability.level.problem import LevelProblem

Cells = NDArray[np.float64]
"""(n, 12), rows as :class:`Cell`"""

NO_LEVEL = -1.0
"""below every V"""
DEPTH = 120
"""halvings after which a cell is given up"""
WEIGHTS = (0.15, 1.0, 0.08, 1.0, 0.05, 0.02)
"""How much a dimension's width matters for the bound, roughly dV over the dimension; the widest is halved."""


def halve(stack: Cells, top: int, dimension: int) -> None:
    """Replace the cell ``top`` of the stack by its halves, the lower one on top."""
    low, high = 2 * dimension, 2 * dimension + 1
    middle = 0.5 * (stack[top, low] + stack[top, high])
    stack[top + 1] = stack[top]
    stack[top, low] = middle
    stack[top + 1, high] = middle


def cell_at(stack: Cells, at: int) -> Cell:
    """Return one cell of the stack."""
    row = stack[at]
    return Cell(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9], row[10], row[11])


def widest_dimension(cell: Cell) -> int:
    """Return the dimension to halve."""
    widths = (
        WEIGHTS[0] * (cell.rho1 - cell.rho0),
        WEIGHTS[1] * (cell.alpha1 - cell.alpha0),
        WEIGHTS[2] * (cell.beta1 - cell.beta0),
        WEIGHTS[3] * (cell.measured1 - cell.measured0),
        WEIGHTS[4] * (cell.eps_v1 - cell.eps_v0),
        WEIGHTS[5] * (cell.eps_omega1 - cell.eps_omega0),
    )
    best = 0
    for one in range(1, 6):
        if widths[one] > widths[best]:
            best = one
    return best


def settled(cell: Cell, problem: LevelProblem, level: float, top_level: float) -> bool:
    """Whether it is shown for a cell, for every noise: V decreases if level < V <= top level, and V <= level stays."""
    low, high = level_bounds(cell, problem.h)
    if low > top_level:
        return True
    if high > level and not rise(cell, problem, level) < 0.0:
        return False
    return low > level or rise(cell, problem, NO_LEVEL) <= down(level - min(high, level))


def search(
    stack: Cells, depths: NDArray[np.int64], state: NDArray[np.float64], tree: NDArray[np.uint8], problem: LevelProblem
) -> int:
    """Go on with the walk until the tree's array is full, the stack is empty, or a cell is too small to go on.

    Args:
        stack: (DEPTH + 2, 12) cells to visit, the next one on top.
        depths: (DEPTH + 2,) halvings that led to each of them.
        state: number of cells on the stack, -1 after a failure; level; top level; share of the root that is settled.
        tree: (n,) bytes to write.
        problem: law, plant and noise.

    Returns:
        The number of nodes written.
    """
    size, level, top_level = int(state[0]), state[1], state[2]
    written = 0
    while size > 0 and written < len(tree):
        top = size - 1
        cell = cell_at(stack, top)
        if settled(cell, problem, level, top_level):
            tree[written] = 0
            size -= 1
            state[3] += 0.5 ** depths[top]
        elif depths[top] >= DEPTH:
            state[0] = -1.0
            return written
        else:
            dimension = widest_dimension(cell)
            halve(stack, top, dimension)
            tree[written] = dimension + 1
            depths[top] += 1
            depths[top + 1] = depths[top]
            size += 1
        written += 1
    state[0] = float(size)
    return written


def top_level(problem: LevelProblem, rho_max: float) -> float:
    """Upper bound of V at the distance ``rho_max`` [m], with any angles."""
    return level_bounds(Cell(rho_max, rho_max, 0.0, PI_HIGH, 0.0, PI_HIGH, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), problem.h)[1]


def root_cell(problem: LevelProblem, top: float) -> Cells:
    """Return a cell (12,) of all states with V <= ``top`` and beta >= 0, and all noise there.

    Mirroring the plane changes the signs of alpha, beta, omega and of three noises, and V not at all: beta < 0 follows.
    """
    farthest = sqrt(2.0 * top, 2.0 * top)[1]
    widest = up(up(2.0 * PI_HIGH) + problem.eps_theta)
    angles = (-PI_HIGH, PI_HIGH, 0.0, PI_HIGH, -widest, widest)
    return np.array([0.0, farthest, *angles, -problem.eps_v, problem.eps_v, -problem.eps_omega, problem.eps_omega])
