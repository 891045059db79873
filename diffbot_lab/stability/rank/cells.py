"""Cells of (rho, alpha) that cover the surroundings of the goal, and the blocks of cells that a box of states meets."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_core.errors import InvalidValueError

Array = NDArray[np.float64]

MAX_ROWS, MAX_COLUMNS, MAX_CELLS = 20_000, 16_000, 10_000_000
"""Indices of blocks, columns counted twice around, are kept in 16 bits; 10^7 cells need some 4 GiB."""
_BEYOND_PI = math.nextafter(math.pi, 4.0)
"""The float math.pi is below pi."""
PADDING = 2e-5
"""[m] and [rad] by which an image is widened on each side before its cells are listed. It stands for more than
all rounding, of the law in the robot, of the images, and of the indices here: a checker with other formulas needs the
same cells."""


class CellPlan(NamedTuple):
    """How the plane is divided."""

    inside: float
    """[m] everything nearer is one set, whose states are not told apart"""
    fine_to: float
    """[m] up to here rows have the width ``width``"""
    to: float
    """[m] the cells reach at least that far"""
    width: float
    """[m] of the innermost rows"""
    growth: float
    """[-] growth of the width per metre beyond ``fine_to``"""
    columns: int
    """number of equal columns of alpha"""


class Cells(NamedTuple):
    """Edges of the cells; row i is rho in [rho[i], rho[i + 1]), column j alpha in [alpha[j], alpha[j + 1])."""

    rho: Array
    """(rows + 1,) [m], increasing"""
    alpha: Array
    """(columns + 1,) [rad], from below -pi to above pi"""


class Cell(NamedTuple):
    """One cell, closed."""

    rho_low: float
    rho_high: float
    alpha_low: float
    alpha_high: float


class Block(NamedTuple):
    """Rows ``first_row`` to ``last_row`` and columns ``first_column`` to ``last_column``, inclusive.

    A last row of ``rows`` or more reaches beyond the cells, and a negative one is wholly inside. Columns are counted on
    beyond the cut, and start in 0 .. columns - 1.
    """

    first_row: int
    last_row: int
    first_column: int
    last_column: int


def make_cells(plan: CellPlan) -> Cells:
    """Divide the plane.

    Raises:
        InvalidValueError: if the plan has too many rows or columns, or none.
    """
    if not (plan.width > 0.0 and plan.growth >= 0.0):
        raise InvalidValueError("width", plan.width, "> 0, with growth >= 0")
    if not 4 <= plan.columns <= MAX_COLUMNS:
        raise InvalidValueError("columns", plan.columns, f"from 4 to {MAX_COLUMNS}")
    rho = [plan.inside]
    while rho[-1] < plan.to:
        if len(rho) > MAX_ROWS:
            raise InvalidValueError("width", plan.width, f"a wider one: this makes more than {MAX_ROWS} rows")
        rho.append(rho[-1] + plan.width + plan.growth * max(0.0, rho[-1] - plan.fine_to))
    if (len(rho) - 1) * plan.columns > MAX_CELLS:
        raise InvalidValueError("width", plan.width, f"a wider one: this makes more than {MAX_CELLS} cells")
    if len(rho) < 2:
        raise InvalidValueError("to", plan.to, f"> {plan.inside:g} m, where the cells begin")
    alpha = -math.pi + 2.0 * math.pi * np.arange(plan.columns + 1) / plan.columns
    alpha[0], alpha[-1] = -_BEYOND_PI, _BEYOND_PI
    return Cells(np.array(rho), alpha)


def block_of(rho: Any, columns: int, rho_low: float, rho_high: float, alpha_low: float, alpha_high: float) -> Block:
    """Return the cells that meet a box of states, widened by PADDING; a cell that is only touched counts.

    Args:
        rho: (rows + 1,) edges [m].
        columns: number of equal columns of alpha.
        rho_low: [m]
        rho_high: [m]
        alpha_low: [rad] not wrapped
        alpha_high: [rad]
    """
    first_row = row_of(rho, rho_low - PADDING)
    last_row = row_of(rho, rho_high + PADDING)
    per_column = columns / (2.0 * math.pi)
    # PADDING is more than the rounding of the next two lines.
    first = math.floor((alpha_low - PADDING + math.pi) * per_column)
    last = math.floor((alpha_high + PADDING + math.pi) * per_column)
    if not last - first < columns - 1:
        return Block(max(first_row, 0), last_row, 0, columns - 1)
    start = first % columns
    return Block(max(first_row, 0), last_row, start, start + last - first)


def row_of(rho: Any, distance: float) -> int:
    """Return the row that a distance [m] is in; -1 inside, the number of rows beyond them."""
    low, high = -1, len(rho) - 1
    while low < high:
        middle = (low + high + 1) // 2
        if rho[middle] <= distance:
            low = middle
        else:
            high = middle - 1
    return low
