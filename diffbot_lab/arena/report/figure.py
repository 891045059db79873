"""The benchmark's figure: paths of each law from one start, and distributions over all runs."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_sim.compiled.batch import COLUMNS
from diffbot_tools.plotting import new_grid, save

Array = NDArray[np.float64]

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_LINES = ("-", "--", ":")
_TITLE_WIDTH = 17
"""characters in a line above a narrow panel"""


def _style_of(index: int) -> tuple[str, str, float]:
    """Return colour, line and width of the law with this place in the figure; the first one stands out."""
    line = _LINES[index // len(_COLOURS) % len(_LINES)]
    return _COLOURS[index % len(_COLOURS)], line, 2.4 if index == 0 else 1.4


class Sheet(NamedTuple):
    """What the figure shows of one law."""

    name: str
    label: str
    outcomes: Array
    """(runs, 12) see batch.COLUMNS"""
    paths: Array
    """(runs, steps + 1, 3) [m, m, rad]"""


def draw_benchmark(sheets: list[Sheet], path: Path) -> None:
    """Draw a panel of paths for each law, and the share of runs below each time and final error.

    Raises:
        OSError: if the file cannot be written.
    """
    figure, panels, curves = new_grid(len(sheets), 4, (15.0, 7.8))
    low = np.min([sheet.paths.min(axis=(0, 1)) for sheet in sheets], axis=0)[:2] - np.array((0.8, 0.8))
    high = np.max([sheet.paths.max(axis=(0, 1)) for sheet in sheets], axis=0)[:2] + np.array((2.0, 0.8))
    for index, (axes, sheet) in enumerate(zip(panels, sheets, strict=True)):
        _draw_paths(axes, sheet, _style_of(index)[0])
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        axes.set_aspect("equal")
        axes.set_xlabel("x [m]")
        axes.set_xticks([-4.0, 0.0])
    for axes in panels[1:]:
        axes.tick_params(labelleft=False)
    panels[0].set_ylabel("y [m]")
    _draw_shares(curves, sheets)
    handles, labels = curves[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=5, fontsize="small")
    save(figure, path)


def _draw_paths(axes: Any, sheet: Sheet, colour: str) -> None:
    for run in sheet.paths:
        axes.plot(run[:, 0], run[:, 1], color=colour, linewidth=0.8, alpha=0.4)
    for x, y, heading, shade in ((*sheet.paths[0, 0], "black"), (0.0, 0.0, 0.0, "#666666")):
        axes.plot(x, y, "o", color=shade, markersize=4)
        axes.arrow(x, y, 1.2 * np.cos(heading), 1.2 * np.sin(heading), width=0.12, color=shade, zorder=3)
    axes.set_title(textwrap.fill(sheet.label, _TITLE_WIDTH), fontsize="small")
    axes.tick_params(labelsize="small")


def _draw_shares(curves: list[Any], sheets: list[Sheet]) -> None:
    column = COLUMNS.index
    for index, sheet in enumerate(sheets):
        out = sheet.outcomes
        colour, line, width = _style_of(index)
        quantities = (
            out[:, column("reached_time")],
            out[:, column("settling_time")],
            np.maximum(np.hypot(out[:, column("x")], out[:, column("y")]), 1e-4),
            np.maximum(np.abs(out[:, column("theta")]), 1e-5),
        )
        for axes, values in zip(curves, quantities, strict=True):
            finite = np.sort(values[np.isfinite(values)])
            shares = 100.0 * np.arange(1, len(finite) + 1) / len(out)
            axes.step(finite, shares, where="post", color=colour, linestyle=line, linewidth=width, label=sheet.label)
    labels = ("time of the answer [s]", "settling time [s]", "final position error [m]", "final heading error [rad]")
    for axes, label in zip(curves, labels, strict=True):
        axes.set_xlabel(label)
        axes.set_ylim(0.0, 102.0)
    for axes in curves[:2]:
        axes.set_xlim(0.0, 60.0)
    curves[0].set_ylabel("share of all runs [%]")
    for axes, lowest in ((curves[2], 2e-3), (curves[3], 2e-4)):
        axes.set_xscale("log")
        axes.set_xlim(left=lowest)
        axes.axvline(0.1, color="black", linewidth=0.8)
