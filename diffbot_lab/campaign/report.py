"""``diffbot campaign``: run or resume a campaign, and write its results as JSON, CSV, figures and a table."""

from __future__ import annotations

import csv
import io
import math
import os
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np

from diffbot_core.errors import DiffbotError
from diffbot_core.files import output_folder, write_json, write_text
from diffbot_lab.campaign.journal import JOURNAL, Journal
from diffbot_lab.campaign.runner import cluster_executor, process_pool, run_campaign
from diffbot_lab.campaign.spec import Campaign, code_version, read_campaign
from diffbot_lab.campaign.statistics import CellStatistics
from diffbot_tools.plotting import new_figure, save

RESULTS, TABLE = "results.json", "results.csv"
_ECDF_METRICS = (
    ("settling_time", "settling time [s]"),
    ("position_error", "final position error [m]"),
    ("heading_error", "final heading error [rad]"),
)
_MAX_CURVES = 12
"""largest number of cells in the figure of distributions"""
_MAX_LABELS = 30
"""largest number of rows or columns of a heat map whose rows, columns and cells are all labelled"""


def run_and_report(
    file: Path | None, flags: Mapping[str, Any], out: Path, workers: int | None, scheduler: str | None
) -> int:
    """Run or resume the campaign of a YAML file and flags, and write its results to ``out``.

    Returns:
        Exit status: 0, or 130 if the campaign was interrupted. Finished chunks are kept.

    Raises:
        DiffbotError: if the description is wrong, the folder belongs to another campaign, or no scheduler answers.
    """
    campaign = read_campaign(file, flags)
    if scheduler is not None:
        with cluster_executor(scheduler) as (make_executor, number):
            return _run_on(make_executor, number, campaign, out)
    number = workers or len(os.sched_getaffinity(0))
    return _run_on(lambda: process_pool(number), number, campaign, out)


def _run_on(make_executor: Callable[[], Executor], number: int, campaign: Campaign, out: Path) -> int:
    """Run a campaign with ``number`` workers; see :func:`run_and_report`."""
    with output_folder(out):
        for path in (out / RESULTS, out / TABLE):
            if path.exists() and not (out / JOURNAL).exists():
                raise DiffbotError(f"{path} was not written by a campaign: choose another --out")
        journal = Journal(out / JOURNAL, campaign)
    if journal.damaged:
        print(f"{out / JOURNAL} has {journal.damaged} damaged lines: their runs are repeated", file=sys.stderr)
    try:
        run_campaign(campaign, journal, make_executor, number)
    except KeyboardInterrupt:
        done, total = sum(one.runs for one in journal.statistics), campaign.options.runs * len(campaign.cells)
        print(f"interrupted: {done} of {total} runs are kept; repeat the command to continue", file=sys.stderr)
        return 130
    finally:
        journal.close()
    print(table(campaign, journal.statistics))
    for path in write_report(campaign, journal.statistics, out):
        print(path)
    return 0


def write_report(campaign: Campaign, statistics: list[CellStatistics], folder: Path) -> list[Path]:
    """Write all results to ``folder`` and return their paths.

    Raises:
        DiffbotError: if a file cannot be written.
    """
    rows = [{**cell.values, **one.summary()} for cell, one in zip(campaign.cells, statistics, strict=True)]
    name = {"identity": campaign.identity, "sources": code_version()}
    written = [folder / RESULTS, folder / TABLE]
    try:
        write_json(folder / RESULTS, {**name, "campaign": campaign.description, "cells": rows})
        write_text(folder / TABLE, _csv(rows))
        written += _draw_heat_maps(campaign, rows, folder)
        _draw_distributions(campaign, statistics, folder / "distributions.png")
    except OSError as error:
        raise DiffbotError(f"cannot write the results to {folder}: {error.strerror}") from None
    return [*written, folder / "distributions.png"]


def _csv(rows: list[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _draw_heat_maps(campaign: Campaign, rows: list[dict[str, Any]], folder: Path) -> list[Path]:
    """Draw heat maps of the success rate and of the median settling time. Return their paths.

    The axes are the first two parameters of the grid that have several values. Only cells in which every other
    parameter has its first value are shown.
    """
    grid: dict[str, list[Any]] = campaign.description["grid"]
    varied = [name for name, values in grid.items() if len(values) > 1]
    if not varied:
        return []
    across, down = varied[0], varied[1] if len(varied) > 1 else ""
    heights = grid.get(down, [""])
    paths = []
    for metric, label, limits in (
        ("success_rate", "share of runs that settled", (0.0, 1.0)),
        ("settling_time_q50", "median settling time [s]", (None, None)),
    ):
        shown = np.full((len(heights), len(grid[across])), np.nan)
        for row in rows:
            first = all(row[name] == grid[name][0] for name in grid if name not in (across, down))
            if first and row[metric] is not None:
                shown[heights.index(row.get(down, "")), grid[across].index(row[across])] = row[metric]
        paths.append(folder / f"heat_map_{metric}.png")
        _draw_heat_map(shown, (across, grid[across]), (down, heights), (label, *limits), paths[-1])
    return paths


def _draw_heat_map(
    shown: Any,
    across: tuple[str, list[Any]],
    down: tuple[str, list[Any]],
    colours: tuple[str, float | None, float | None],
    path: Path,
) -> None:
    """Draw a heat map of ``shown`` (rows, columns).

    Args:
        shown: values of the cells.
        across: name and values of the parameter of the columns.
        down: name and values of the parameter of the rows.
        colours: label, minimum and maximum of the colour scale.
        path: file to write.
    """
    rows, columns = shown.shape
    width, height = min(2.6 + 0.8 * columns, 26.0), min(1.8 + 0.6 * rows, 20.0)
    figure, axes = new_figure(1, (max(width, 5.0), max(height, 2.4)))
    axes.grid(visible=False)
    label, lowest, highest = colours
    image = axes.imshow(shown, aspect="auto", origin="lower", cmap="viridis", vmin=lowest, vmax=highest)
    for set_ticks, values in ((axes.set_xticks, across[1]), (axes.set_yticks, down[1])):
        places = range(0, len(values), math.ceil(len(values) / _MAX_LABELS))
        set_ticks(places, [f"{values[i]:g}" if isinstance(values[i], float) else f"{values[i]}" for i in places])
    axes.set_xlabel(across[0])
    axes.set_ylabel(down[0])
    low, high = image.get_clim()
    for (y, x), value in np.ndenumerate(shown) if max(shown.shape) <= _MAX_LABELS else ():
        text = "none" if np.isnan(value) else f"{value:.3g}"
        dark = not np.isnan(value) and value < 0.5 * (low + high)
        axes.text(x, y, text, ha="center", va="center", color="white" if dark else "black", fontsize="small")
    figure.colorbar(image, label=label)
    save(figure, path)


def _draw_distributions(campaign: Campaign, statistics: list[CellStatistics], path: Path) -> None:
    figure, all_axes = new_figure(len(_ECDF_METRICS), (7.0, 8.0), sharex=False)
    shown = list(zip(campaign.cells, statistics, strict=True))[:_MAX_CURVES]
    for axes, (metric, label) in zip(all_axes, _ECDF_METRICS, strict=True):
        for cell, one in shown:
            values, shares = one.ecdf(metric)
            if values:
                name = ", ".join(f"{key} {value}" for key, value in cell.values.items()) or "all runs"
                axes.step([values[0], *values], [0.0, *shares], where="post", label=name, linewidth=1.2)
        axes.set_xlabel(label)
        axes.set_ylabel("share of runs")
        axes.set_ylim(0.0, 1.02)
        if metric != "settling_time":
            axes.set_xscale("symlog", linthresh=1e-3)
    if all_axes[1].get_lines():  # every run has a position error, but not every run settles
        all_axes[1].legend(fontsize="x-small")
    left_out = len(campaign.cells) - len(shown)
    if left_out:
        all_axes[0].set_title(f"the first {len(shown)} of {len(campaign.cells)} cells")
    save(figure, path)


def table(campaign: Campaign, statistics: list[CellStatistics]) -> str:
    """Return a table of the first 40 cells for a terminal."""
    grid = campaign.description["grid"]
    widths = {name: max(16, *(len(str(cell)) + 2 for cell in (name, *values))) for name, values in grid.items()}
    head = "".join(f"{name:>{width}}" for name, width in widths.items())
    head += f"{'runs':>10}{'success':>9}{'[95 %]':>16}{'settle q50':>12}{'q95 [s]':>9}"
    head += f"{'pos q95 [m]':>13}{'switches q99':>14}"
    lines = [campaign.heading, head, "-" * len(head)]
    for cell, one in list(zip(campaign.cells, statistics, strict=True))[:40]:
        figures = one.summary()
        line = "".join(f"{cell.values[name]!s:>{width}}" for name, width in widths.items())
        interval = f"{figures['success_low']:.4f}-{figures['success_high']:.4f}"
        line += f"{one.runs:>10}{figures['success_rate']:>9.4f}{interval:>16}"
        for metric, width in (("settling_time_q50", 12), ("settling_time_q95", 9), ("position_error_q95", 13)):
            line += f"{figures[metric]:>{width}.3f}" if figures[metric] is not None else f"{'-':>{width}}"
        lines.append(line + f"{figures['switches_q99']:>14.0f}")
    if len(campaign.cells) > 40:
        lines.append(f"... and {len(campaign.cells) - 40} more cells in {TABLE}")
    return "\n".join(lines)
