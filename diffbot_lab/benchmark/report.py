"""Results of ``diffbot benchmark switching``: tables, the quantities in which a peer is ahead, and a figure."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diffbot_core.files import output_folder, write_json
from diffbot_lab.benchmark.cases import arena_starts, cases_named
from diffbot_lab.benchmark.entries import OWN_NAME, entries_for, read_tuning, tuned_values
from diffbot_lab.benchmark.runs import NOMINAL, BenchmarkOptions, run_benchmark, run_paths
from diffbot_lab.benchmark.statistics import ANSWER_TIMES
from diffbot_lab.tables import number
from diffbot_sim.batch import COLUMNS

Array = NDArray[np.float64]
Results = dict[str, Any]

COMPARED = (
    ("reached_time", "median", "time of the answer, median", "s"),
    ("reached_time", "p99", "time of the answer, 99 %", "s"),
    ("settling_time", "median", "settling time, median", "s"),
    ("settling_time", "p99", "settling time, 99 %", "s"),
    ("position", "p95", "final position error, 95 %", "m"),
)
"""Compared quantities: key and quantile in the statistics, text and unit. The shares of answered and of settled runs
are compared as well."""
RUNS_OF_FIGURE = 12
START_OF_FIGURE = 10
"""index of the start at (0, 12 m) with the heading 220 degrees"""
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_TITLE_WIDTH = 17
"""number of characters in a line above a narrow panel"""


def run_and_report(options: BenchmarkOptions, folder: Path) -> int:
    """Run the benchmark, write results.json and benchmark.png to ``folder``, and print the tables.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    with output_folder(folder):
        results, outcomes = run_benchmark(options)
        results["ahead"] = peers_ahead(results)
        write_json(folder / "results.json", results)
        print(table(results))
        if outcomes:
            draw(outcomes, options, folder / "benchmark.png")
    print(f"Results in {folder}")
    return 0


def better(ours: Results, peer: Results) -> list[tuple[str, str, float, float, bool]]:
    """List the quantities in which a peer is better than this project's law.

    If no run of a peer settles or is answered, its times are None, and the peer is not better in these times.

    Returns:
        For each quantity: text, unit, the peer's value, our value, and True if the intervals do not overlap.
    """
    ahead = []
    shares = (
        ("share answered by 60 s", _answered, "answered_interval"),
        ("share settled", _settled, "settled_interval"),
    )
    for text, share, interval in shares:
        if share(peer) > share(ours):
            ahead.append((text, "", share(peer), share(ours), peer[interval][0] > ours[interval][1]))
    for part, key, text, unit in COMPARED:
        own, other = ours[part][key], peer[part][key]
        if other is not None and (own is None or other < own):
            apart = own is None or peer[part][f"{key}_interval"][1] < ours[part][f"{key}_interval"][0]
            ahead.append((text, unit, other, own, apart))
    return ahead


def peers_ahead(results: Results) -> list[Results]:
    """List the quantities of all cases in which a peer is better than this project's law."""
    labels = {one["name"]: one["label"] for one in results["laws"]}
    keys = ("figure", "unit", "peers", "ours", "apart")
    ahead = []
    for row in results["cases"]:
        (ours,) = (one for one in row["laws"] if one["name"] == OWN_NAME)
        for peer in row["laws"]:
            head = {"case": row["name"], "peer": labels[peer["name"]]}
            ahead += [head | dict(zip(keys, one, strict=True)) for one in better(ours, peer)]
    return ahead


def _settled(one: Results) -> float:
    return float(one["settled"] / one["runs"])


def _answered(one: Results, time: int = 60) -> float:
    """Return the share of all runs that are answered by ``time`` [s], one of ANSWER_TIMES."""
    return float(one["answered_by"][str(time)] / one["runs"])


def table(results: Results) -> str:
    """Return the results of all cases as a table for a terminal."""
    labels = {one["name"]: one["label"] for one in results["laws"]}
    head = f"{'':<42}{'answered: 20 s':>15}{'30 s':>8}{'60 s':>8}{'false':>8}{'time [s]: median':>18}{'99 %':>7}"
    head += f"{'settled':>10}{'99 % [s]':>10}{'|pos| [m]: 95 %':>17}{'turns':>7}"
    lines = [f"{one['label']}: {one['parameters']}" for one in results["laws"]]
    lines += [f"(parameters in the case {results['cases'][0]['name']})", ""]
    lines.append("A peer is ahead of the switching law in:" if results["ahead"] else "No peer is ahead in any case.")
    lines += [f"  {one['case']}: {one['peer']}, {one['figure']} {_pair(one)}" for one in results["ahead"]]
    for row in results["cases"]:
        lines += ["", f"{row['name']}: {row['text']}", head, "-" * len(head)]
        lines += [_terminal_row(labels[one["name"]], one) for one in row["laws"]]
    return "\n".join(lines)


def _terminal_row(label: str, one: Results) -> str:
    answer, by = one["reached_time"], [f"{100.0 * _answered(one, time):.2f}" for time in ANSWER_TIMES]
    return (
        f"{label:<42}{by[0]:>15}{by[1]:>8}{by[2]:>8}{100.0 * one['false_reached'] / one['runs']:>8.2f}"
        f"{number(answer['median'], 1):>18}{number(answer['p99'], 1):>7}"
        f"{100.0 * _settled(one):>10.2f}{number(one['settling_time']['p99'], 1):>10}"
        f"{number(one['position']['p95']):>17}{one['revolutions']:>7.2f}"
    )


def _pair(one: Results) -> str:
    """Return the values of the peer and of this project's law, with enough digits to show that they differ."""
    ours, peers = one["ours"], one["peers"]
    unit = f" {one['unit']}" if one["unit"] else ""
    if ours is None:
        return f"{peers:.3f}{unit}, ours has no value"
    digits = next((d for d in (3, 4, 5) if f"{peers:.{d}f}" != f"{ours:.{d}f}"), 6)
    sure = "" if one["apart"] else " (intervals overlap)"
    return f"{peers:.{digits}f}{unit}, ours {ours:.{digits}f}{unit}{sure}"


def draw(outcomes: dict[str, Array], options: BenchmarkOptions, path: Path) -> None:
    """Draw paths of each law from one start, and the distributions of all runs, in the nominal case.

    Raises:
        OSError: if the file cannot be written.
    """
    # Imports matplotlib.
    from diffbot_tools.plotting import new_grid, save  # noqa: PLC0415

    (case,) = cases_named((NOMINAL,))
    tuning, start, entries = read_tuning(options.tuning), arena_starts()[START_OF_FIGURE], entries_for(options.laws)
    figure, panels, curves = new_grid(len(entries), 4, (15.0, 7.8))
    for index, (axes, entry) in enumerate(zip(panels, entries, strict=True)):
        # The first law has a wider line. If all colours are used, further laws have dashed lines.
        colour, line, width = _COLOURS[index % len(_COLOURS)], ("-", "--")[index // len(_COLOURS) % 2], 1.4
        width = 2.4 if index == 0 else width
        paths = run_paths(entry, case, tuned_values(tuning, entry), start, RUNS_OF_FIGURE, options.seed)
        _draw_paths(axes, paths, colour)
        axes.set_title(textwrap.fill(entry.label, _TITLE_WIDTH), fontsize="small")
        for below, values in zip(curves, _distributed(outcomes[entry.name]), strict=True):
            finite = np.sort(values[np.isfinite(values)])
            shares = 100.0 * np.arange(1, len(finite) + 1) / len(values)
            below.step(finite, shares, where="post", color=colour, linestyle=line, linewidth=width, label=entry.label)
    panels[0].set_ylabel("y [m]")
    labels = ("time of the answer [s]", "settling time [s]", "final position error [m]", "final heading error [rad]")
    for axes, label in zip(curves, labels, strict=True):
        axes.set_xlabel(label)
        axes.set_ylim(0.0, 102.0)
    curves[0].set_ylabel("share of all runs [%]")
    for axes in curves[:2]:
        axes.set_xlim(0.0, 60.0)
    for axes, lowest in ((curves[2], 2e-3), (curves[3], 2e-4)):
        axes.set_xscale("log")
        axes.set_xlim(left=lowest)
        axes.axvline(0.1, color="black", linewidth=0.8)
    figure.legend(*curves[0].get_legend_handles_labels(), loc="lower center", ncols=5, fontsize="small")
    save(figure, path)


def _draw_paths(axes: Any, paths: Array, colour: str) -> None:
    """Draw paths (runs, steps + 1, >= 3) from one start to the goal at the origin."""
    for run in paths:
        axes.plot(run[:, 0], run[:, 1], color=colour, linewidth=0.8, alpha=0.4)
    for x, y, heading, shade in ((*paths[0, 0, :3], "black"), (0.0, 0.0, 0.0, "#666666")):
        axes.plot(x, y, "o", color=shade, markersize=4)
        axes.arrow(x, y, 1.2 * np.cos(heading), 1.2 * np.sin(heading), width=0.12, color=shade, zorder=3)
    axes.set_xlim(-6.0, 4.0)
    axes.set_ylim(-3.0, 13.5)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_xticks([-4.0, 0.0])
    axes.tick_params(labelsize="small", labelleft=axes.get_subplotspec().is_first_col())


def _distributed(outcomes: Array) -> tuple[Array, ...]:
    """Return the quantities whose distributions are drawn, for outcomes (runs, 12), columns as batch.COLUMNS."""
    column = {name: outcomes[:, index] for index, name in enumerate(COLUMNS)}
    position = np.maximum(np.hypot(column["x"], column["y"]), 1e-4)
    return column["reached_time"], column["settling_time"], position, np.maximum(np.abs(column["theta"]), 1e-5)
