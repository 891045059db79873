"""Kernels of ``diffbot stability level``: branch and bound over cells, depth first, and the check of its tree.

The tree is one byte per node in the order of the walk: 0 for a leaf, d + 1 for a node halved in dimension d. So a tree
covers its root without gaps by its form alone; what has to be checked is each leaf.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from diffbot_lab.stability.level_bounds import Cell, LevelProblem, level_bounds, rise

Cells = NDArray[np.float64]
"""(n, 8), rows as :class:`Cell`"""

DEPTH = 90
"""halvings after which a cell is given up"""
WEIGHTS = (0.15, 1.0, 0.08, 1.0)
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
    return Cell(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7])


def widest_dimension(cell: Cell) -> int:
    """Return the dimension to halve."""
    widths = (
        WEIGHTS[0] * (cell.rho1 - cell.rho0),
        WEIGHTS[1] * (cell.alpha1 - cell.alpha0),
        WEIGHTS[2] * (cell.beta1 - cell.beta0),
        WEIGHTS[3] * (cell.measured1 - cell.measured0),
    )
    best = 0
    for one in range(1, 4):
        if widths[one] > widths[best]:
            best = one
    return best


def settled(cell: Cell, problem: LevelProblem, level: float, top_level: float) -> bool:
    """Whether V decreases for all noise in the part of the cell with level < V <= top_level."""
    low, high = level_bounds(cell, problem.h)
    return high <= level or low > top_level or rise(cell, problem, level) < 0.0


def search(
    stack: Cells, depths: NDArray[np.int64], state: NDArray[np.float64], tree: NDArray[np.uint8], problem: LevelProblem
) -> int:
    """Go on with the walk until the tree's array is full or the stack is empty.

    Args:
        stack: (DEPTH + 2, 8) cells to visit, the next one on top.
        depths: (DEPTH + 2,) halvings that led to each of them.
        state: number of cells on the stack, level, top level; the level rises to V of each cell that is given up.
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
        elif depths[top] >= DEPTH:
            level = max(level, level_bounds(cell, problem.h)[1])
            tree[written] = 0
            size -= 1
        else:
            dimension = widest_dimension(cell)
            halve(stack, top, dimension)
            tree[written] = dimension + 1
            depths[top] += 1
            depths[top + 1] = depths[top]
            size += 1
        written += 1
    state[0], state[1] = float(size), level
    return written


def first_open_leaf(root: Cells, tree: NDArray[np.uint8], level: float, top_level: float, problem: LevelProblem) -> int:
    """Check a tree: return the number of its first node that is wrong, -1 if the tree proves its claim.

    Wrong is a leaf in which V is not shown to decrease, an unknown byte, a node after the last leaf, or the end of the
    bytes before it.
    """
    stack = np.empty((256, 8))
    stack[0] = root
    size = 1
    for node in range(len(tree)):
        byte = tree[node]
        if size == 0 or size >= 255 or byte > 4:
            return node
        if byte > 0:
            halve(stack, size - 1, byte - 1)
            size += 1
        elif settled(cell_at(stack, size - 1), problem, level, top_level):
            size -= 1
        else:
            return node
    return -1 if size == 0 else len(tree)


def root_cell(problem: LevelProblem, rho_max: float) -> Cells:
    """Return the cell of all states up to ``rho_max`` [m] with beta >= 0, and all that may be measured there.

    Mirroring the plane changes the signs of alpha, beta, omega and of three noises, and V not at all: beta < 0 follows.
    """
    pi = math.nextafter(math.pi, 4.0)
    widest = math.nextafter(2.0 * pi + problem.eps_theta, 100.0)
    return np.array([0.0, rho_max, -pi, pi, 0.0, pi, -widest, widest])
