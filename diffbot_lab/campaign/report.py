"""Results of a campaign: results.json, results.csv, results.parquet, heat maps and cumulative distributions."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path
from typing import Any

import numpy as np

from diffbot_core.errors import DiffbotError
from diffbot_core.files import replacing, write_json, write_text
from diffbot_lab.campaign.spec import Campaign, code_version
from diffbot_lab.campaign.statistics import CellStatistics
from diffbot_tools.plotting import new_figure, save

_ECDF_METRICS = (
    ("settling_time", "settling time [s]"),
    ("position_error", "final position error [m]"),
    ("heading_error", "final heading error [rad]"),
)
_MAX_CURVES = 12
"""Cells drawn in one figure of distributions; more are not legible."""
_MAX_LABELS = 30
"""Columns or rows of a heat map up to which each is labelled and each cell shows its number."""


def write_report(campaign: Campaign, statistics: list[CellStatistics], folder: Path) -> list[Path]:
    """Write all results below ``folder`` and return their paths.

    Raises:
        DiffbotError: if something cannot be written.
    """
    rows = [{**cell.values, **one.summary()} for cell, one in zip(campaign.cells, statistics, strict=True)]
    name = {"identity": campaign.identity, "sources": code_version(), "cases": campaign.resolved}
    results = {**name, "campaign": campaign.description, "cells": rows}
    try:
        write_json(folder / "results.json", results)
        write_text(folder / "results.csv", _csv(rows))
        written = [folder / "results.json", folder / "results.csv"]
        written += _write_parquet(rows, folder / "results.parquet")
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


def _write_parquet(rows: list[dict[str, Any]], path: Path) -> list[Path]:
    try:
        import pyarrow as pa  # noqa: PLC0415 - an extra
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError:
        print("pyarrow is not installed: results.parquet is not written")
        return []
    with replacing(path) as part:
        parquet.write_table(pa.Table.from_pylist(rows), part)
    return [path]


def _draw_heat_maps(campaign: Campaign, rows: list[dict[str, Any]], folder: Path) -> list[Path]:
    """Success and median settling time over the first two varying parameters; the others at their first value."""
    grid: dict[str, list[Any]] = campaign.description["grid"]
    varied = [name for name, values in grid.items() if len(values) > 1]
    if not varied:
        return []
    across = varied[0]
    down = varied[1] if len(varied) > 1 else None
    others = {name: values[0] for name, values in grid.items() if name not in (across, down)}
    paths = []
    for metric, label, limits in (
        ("success_rate", "share of runs that settled", (0.0, 1.0)),
        ("settling_time_q50", "median settling time [s]", (None, None)),
    ):
        table = np.full((len(grid[down]) if down else 1, len(grid[across])), np.nan)
        for row in rows:
            if all(row[name] == value for name, value in others.items()) and row[metric] is not None:
                place = grid[down].index(row[down]) if down else 0
                table[place, grid[across].index(row[across])] = row[metric]
        path = folder / f"heat_map_{metric}.png"
        _draw_heat_map(table, (across, grid[across]), (down, grid[down] if down else [""]), label, limits, path)
        paths.append(path)
    return paths


def _draw_heat_map(
    table: Any,
    across: tuple[str, list[Any]],
    down: tuple[str | None, list[Any]],
    label: str,
    limits: tuple[float | None, float | None],
    path: Path,
) -> None:
    rows, columns = table.shape
    width, height = min(2.6 + 0.8 * columns, 26.0), min(1.8 + 0.6 * rows, 20.0)
    figure, axes = new_figure(1, (max(width, 5.0), max(height, 2.4)))
    axes.grid(visible=False)
    image = axes.imshow(table, aspect="auto", origin="lower", cmap="viridis", vmin=limits[0], vmax=limits[1])
    for set_ticks, values in ((axes.set_xticks, across[1]), (axes.set_yticks, down[1])):
        shown = range(0, len(values), math.ceil(len(values) / _MAX_LABELS))
        set_ticks(shown, [f"{values[i]:g}" if isinstance(values[i], float) else f"{values[i]}" for i in shown])
    axes.set_xlabel(across[0])
    axes.set_ylabel(down[0] or "")
    low, high = image.get_clim()
    for (y, x), value in np.ndenumerate(table) if max(table.shape) <= _MAX_LABELS else ():
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
    if all_axes[1].get_lines():  # every run has a position error, but not each settles
        all_axes[1].legend(fontsize="x-small")
    left_out = len(campaign.cells) - len(shown)
    if left_out:
        all_axes[0].set_title(f"the first {len(shown)} of {len(campaign.cells)} cells")
    save(figure, path)


def table(campaign: Campaign, statistics: list[CellStatistics]) -> str:
    """Lay out the cells for a terminal, at most 40."""
    names = list(campaign.description["grid"])
    head = "".join(f"{name[-14:]:>16}" for name in names)
    head += f"{'runs':>10}{'success':>9}{'[95 %]':>16}{'settle q50':>12}{'q95 [s]':>9}"
    head += f"{'pos q95 [m]':>13}{'switches q99':>14}"
    lines = [campaign.heading, head, "-" * len(head)]
    for cell, one in list(zip(campaign.cells, statistics, strict=True))[:40]:
        figures = one.summary()
        line = "".join(f"{cell.values[name]!s:>16}" for name in names)
        interval = f"{figures['success_low']:.4f}-{figures['success_high']:.4f}"
        line += f"{one.runs:>10}{figures['success_rate']:>9.4f}{interval:>16}"
        for metric, width in (("settling_time_q50", 12), ("settling_time_q95", 9), ("position_error_q95", 13)):
            line += f"{figures[metric]:>{width}.3f}" if figures[metric] is not None else f"{'-':>{width}}"
        lines.append(line + f"{figures['switches_q99']:>14.0f}")
    if len(campaign.cells) > 40:
        lines.append(f"... and {len(campaign.cells) - 40} more cells in results.csv")
    return "\n".join(lines)
