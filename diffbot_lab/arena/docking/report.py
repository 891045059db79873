"""The docking study as tables and a figure, and where the peer is ahead."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diffbot_core.files import output_folder, write_json
from diffbot_lab.arena.docking.study import (
    LAWS,
    OWN,
    PEER,
    XY_TOLERANCE,
    YAW_TOLERANCE,
    case_of,
    docking_cases,
    run_study,
)
from diffbot_lab.cases import described
from diffbot_lab.tables import markdown_table, number

Results = dict[str, Any]
Array = NDArray[np.float64]

LABELS = {OWN: "docking", PEER: "Nav2's docking server"}
_SCALES = {"lateral": (100.0, "cm", 2), "heading": (math.degrees(1.0), "degrees", 2), "speed": (1.0, "m/s", 2)}
"""Factor, unit and digits of a figure where it is shown; times are in s with one digit"""
_SHARES = ("docked", "no_contact")
_COMPARED = (
    *(("docked", "", "share docked"), ("no_contact", "", "runs without contact")),
    *(("lateral", "p95", "lateral error, 95 %"), ("heading", "p95", "heading error, 95 %")),
    *(("time", "median", "time, median"), ("time", "p99", "time, 99 %")),
)
_PATHS = 40
"""drawn of each law"""


def shown_value(figures: Results, part: str, level: str) -> float | None:
    """Return a figure in the unit it is shown in; shares of the runs in %."""
    if part in _SHARES:
        return 100.0 * float(figures[part]) / float(figures["runs"])
    value = figures[part][level]
    return None if value is None else _SCALES.get(part, (1.0, "s", 1))[0] * value


def unit_of(part: str) -> str:
    """Return the unit a figure is shown in."""
    return "%" if part in _SHARES else _SCALES.get(part, (1.0, "s", 1))[1]


def peer_ahead(results: Results) -> list[Results]:
    """Return the figures in which the peer is ahead, case by case."""
    found = []
    for row in results["cases"]:
        for part, level, text in _COMPARED:
            own, peer = (shown_value(row["laws"][name], part, level) for name in (OWN, PEER))
            sign = 1.0 if part == "docked" else -1.0
            if peer is not None and (own is None or sign * peer > sign * own):
                found.append({"case": row["name"], "figure": text, "unit": unit_of(part), "own": own, "peer": peer})
    return found


def share_text(figures: Results) -> str:
    """Return the share docked [%] with its 95 % interval."""
    low, high = figures["docked_interval"]
    return f"{shown_value(figures, 'docked', ''):.2f} [{100.0 * low:.2f}, {100.0 * high:.2f}]"


def spread_text(figures: Results, part: str, levels: tuple[str, ...] = ("median", "p95", "p99")) -> str:
    """Return quantiles of a figure, such as ``0.25/0.67/0.89``."""
    digits = _SCALES.get(part, (1.0, "s", 1))[2]
    return "/".join(number(shown_value(figures, part, level), digits) for level in levels)


def table(results: Results) -> list[str]:
    """Lay the figures of both laws in each case out as a Markdown table."""
    head = ["case", "law", "docked [%]", "beside", "no contact", "lateral [cm]: 50/95/99 %"]
    head += ["heading [degrees]: 50/95/99 %", "time [s]: 50/99 %", "from 1.5 m [s]: 50/99 %", "speed [m/s]: 50/99 %"]
    rows = []
    for row in results["cases"]:
        for name, one in row["laws"].items():
            cells = [f"`{row['name']}`: {row['text']}" if name == OWN else "", LABELS[name], share_text(one)]
            cells += [str(one["beside"]), str(one["no_contact"])]
            cells += [spread_text(one, part) for part in ("lateral", "heading")]
            cells += [spread_text(one, part, ("median", "p99")) for part in ("time", "middle_time", "speed")]
            rows.append(cells)
    return markdown_table(head, rows)


def ahead_lines(results: Results) -> list[str]:
    """Return a line for each figure in which the peer is ahead, over all cases."""
    found: dict[str, list[str]] = {}
    for one in peer_ahead(results):
        figures = f"{number(one['peer'], 2)} instead of {number(one['own'], 2)} {one['unit']}"
        found.setdefault(one["figure"], []).append(f"`{one['case']}` {figures}")
    return [f"{figure}: {'; '.join(cases)}" for figure, cases in found.items()]


def run_and_report(runs: int, seed: int, names: tuple[str, ...], folder: Path, figures: bool) -> int:
    """Run the study, write results.json and docking.png to ``folder``, and print the tables.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    with output_folder(folder):
        path = folder / "results.json"
        results, shown = run_study(runs, seed, names, lambda found: write_json(path, found))
        write_json(path, results | {"peer_ahead": peer_ahead(results)})
        for case in docking_cases(names):
            for name, law in LAWS.items():
                shared = case_of(case, law)
                print(described(f"{case.name}: law {name}", controller=shared.controller, plant=shared.plant))
            print(described(f"{case.name}: both", sensors=shared.sensors))
        print("\n".join(["", "Nav2's docking server is ahead in:", *ahead_lines(results), "", *table(results)]))
        if figures:
            draw(shown, folder / "docking.png")
    print(f"Results in {folder}")
    return 0


def draw(shown: dict[str, tuple[Array, Array]], path: Path) -> None:
    """Draw paths of each law, and the share of runs whose contact is within each error and time."""
    # Loads matplotlib.
    from diffbot_tools.plotting import BLUE, RED, new_grid, save  # noqa: PLC0415

    figure, panels, curves = new_grid(len(shown), 3, (12.0, 7.5), left=0.06)
    for axes, (name, (found, paths)), colour in zip(panels, shown.items(), (BLUE, RED), strict=True):
        for run in paths[:_PATHS]:
            axes.plot(run[:, 0], run[:, 1], color=colour, linewidth=0.8, alpha=0.5)
        axes.plot(0.0, 0.0, "o", color="black", markersize=4)
        axes.set_title(LABELS[name], fontsize="medium")
        axes.set_xlabel("x [m], dock at 0")
        axes.set_ylim(-0.75, 0.75)
        values = (100.0 * np.abs(found[:, 0]), np.degrees(np.abs(found[:, 1])), found[:, 2])
        for below, one in zip(curves, values, strict=True):
            reached = np.sort(one[np.isfinite(one)])
            shares = 100.0 * np.arange(1, len(reached) + 1) / len(found)
            below.step(reached, shares, where="post", color=colour, label=LABELS[name])
    panels[0].set_ylabel("y [m]")
    texts = ("lateral error at contact [cm]", "heading error at contact [degrees]", "time of contact [s]")
    for axes, text in zip(curves, texts, strict=True):
        axes.set_xlabel(text)
        axes.set_ylim(0.0, 102.0)
        axes.set_xlim(left=0.0)
    for axes, bound in zip(curves, (100.0 * XY_TOLERANCE, math.degrees(YAW_TOLERANCE)), strict=False):
        axes.axvline(bound, color="black", linewidth=0.8)
    curves[0].set_ylabel("share of all runs [%]")
    curves[-1].legend(loc="lower right", fontsize="small")
    save(figure, path)
