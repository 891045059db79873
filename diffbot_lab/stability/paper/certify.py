"""Makes a certificate of the paper's loop: cells, images, ranks, and what follows from them."""

from __future__ import annotations

import math
import platform
import time
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_lab.stability.paper.file import EXACT_ARC, Certificate, Claims, Loop
from diffbot_lab.stability.paper.graph import build_graph
from diffbot_lab.stability.paper.images import PaperLoop
from diffbot_lab.stability.rank.cells import PADDING, CellPlan, Cells, make_cells
from diffbot_lab.stability.rank.ranking import Graph, Ranking, rank_cells

_OUTSIDE = 0.4
"""[m] by which the cells reach beyond the starts: noise may drive the robot away for a while"""
_INSIDE_MARGIN = 0.15
"""[m] by which the first edge lies beyond the bound of the position error"""
ROUNDING = f"images: interval arithmetic in plain floats, then widened by {PADDING:g} m and rad"


class Resolution(NamedTuple):
    """How fine the cells are."""

    width: float = 0.0025
    """[m] of the rows near the goal"""
    columns: int = 1256
    """of alpha"""
    growth: float = 0.0025
    """growth of the width per metre farther out"""
    slice_width: float = 0.05
    """[rad] of the measured bearing"""
    fine_to: float = 1.15
    """[m] where the width begins to grow"""


FINE = Resolution()


def images_loop(loop: Loop, slice_width: float) -> PaperLoop:
    """Return the loop as the images need it."""
    return PaperLoop(
        *loop[:6],
        math.hypot(loop.eps_x, loop.eps_y),
        *loop[8:12],
        loop.plant == EXACT_ARC,
        slice_width,
    )


def inner_edge(loop: Loop) -> float:
    """Distance [m] inside which states are not told apart: beyond the position error and the longest step."""
    return max(math.hypot(loop.eps_x, loop.eps_y) + _INSIDE_MARGIN, 1.5 * loop.t_s * (loop.gamma + loop.eps_v))


def longest_step(loop: Loop, rho: float) -> float:
    """Upper bound [m] of the length of a step that starts within ``rho`` [m]."""
    speed = loop.gamma * math.tanh(rho + math.hypot(loop.eps_x, loop.eps_y)) + loop.eps_v
    return loop.t_s * speed + 1e-9


def certify(
    loop: Loop,
    start: float,
    resolution: Resolution = FINE,
    threads: int | None = None,
) -> tuple[Certificate, dict[str, Any]]:
    """Compute a certificate and notes about it.

    Args:
        loop: law, noise and plant.
        start: [m] trajectories are to start within this distance.
        resolution: of the cells.
        threads: how many at a time; None for one on each core.

    Raises:
        DiffbotError: if the loop has no certificate with these cells.
    """
    began = time.monotonic()
    inside = inner_edge(loop)
    if not start > inside:
        raise InvalidValueError("rho_max", start, f"> {inside:.3g} m, inside which states are not told apart")
    to = start + _OUTSIDE
    plan = CellPlan(inside, resolution.fine_to, to, resolution.width, resolution.growth, resolution.columns)
    cells = make_cells(plan)
    graph = build_graph(images_loop(loop, resolution.slice_width), cells, threads)
    inside_rows = int(np.searchsorted(cells.rho, inside + longest_step(loop, inside), side="right"))
    ranking = _ranking(graph, inside_rows)
    claims = _claims(cells, ranking, start)
    notes = _notes(resolution, graph) | {
        "recurrent_within": _farthest(cells, ranking.recurrent > 0),
        "seconds": round(time.monotonic() - began, 1),
    }
    return Certificate(loop, cells.rho, cells.alpha, ranking.ranks, claims), notes


def _notes(resolution: Resolution, graph: Graph) -> dict[str, Any]:
    versions = {name: version(name) for name in ("diffbot", "numpy", "numba")}
    return {
        "rounding": ROUNDING,
        "resolution": resolution._asdict(),
        "cells": graph.rows * graph.columns,
        "blocks": len(graph.blocks),
        "versions": {"python": platform.python_version(), **versions},
    }


def _ranking(graph: Graph, inside_rows: int) -> Ranking:
    """Rank the cells with a progress bar."""
    with tqdm(desc="ranks", unit="sweep", disable=None) as bar:

        def show(alive: NDArray[np.uint8]) -> None:
            bar.update()
            if bar.n % 10 == 0:
                bar.set_postfix(cells=int(alive.sum()))

        return rank_cells(graph, inside_rows, show)


def _claims(cells: Cells, ranking: Ranking, start: float) -> Claims:
    ranks = ranking.ranks[cells.rho[:-1] <= start]
    if (ranks < 0).any():
        raise DiffbotError(f"no certificate: trajectories from within {start:g} m may leave the cells")
    return Claims(_farthest(cells, ranking.ranks == 0), start, int(ranks.max()))


def _farthest(cells: Cells, some: NDArray[np.bool_]) -> float:
    """Return the outer edge [m] of the farthest of some cells, the inner edge of all for none."""
    rows = np.flatnonzero(some.any(axis=1))
    return float(cells.rho[rows[-1] + 1] if len(rows) else cells.rho[0])
