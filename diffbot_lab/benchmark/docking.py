"""Compare this project's docking law with Nav2's docking server: ``diffbot benchmark docking``.

Run i has the same start and the same noise for both laws. Both laws receive the estimate of the same filter, in the
frame of the dock. Contact is the first time at which the true pose crosses x = 0 of this frame towards the dock.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_control.filter.config import CALIBRATING, FilterConfig
from diffbot_control.law.docking import Docking
from diffbot_control.law.law import Law
from diffbot_core.files import output_folder, write_json
from diffbot_core.schema import build, parameters_of
from diffbot_lab.benchmark.cases import DURATION, LIMITS, NONE, Values, cases_named
from diffbot_lab.benchmark.statistics import spread
from diffbot_lab.campaign.statistics import wilson
from diffbot_lab.cases import Configuration, described, make_case
from diffbot_lab.laws.nav2_docking import Nav2Docking
from diffbot_lab.tables import markdown_table, number
from diffbot_sim.batch import Starts, run_histories
from diffbot_sim.config import PlantConfig, SensorConfig
from diffbot_sim.robot_step import Case

Array = NDArray[np.float64]

XY_TOLERANCE, YAW_TOLERANCE = 0.02, math.radians(2.0)
"""[m], [rad] largest lateral error and heading error at contact with which a robot counts as docked"""
FILTER = FilterConfig(filter=CALIBRATING, wheels_as_configured=0.0, wheel_radius_sigma=0.02)
"""The filter assumes that the wheels differ from their parameters, as it should on a robot that docks."""
LAWS: dict[str, type[Law]] = {"docking": Docking, "nav2_docking": Nav2Docking}
LABELS = {"docking": "docking", "nav2_docking": "Nav2's docking server"}
CONTACT_COLUMNS = ("lateral", "heading", "time", "speed")
"""Columns of an array of contacts: lateral error [m], heading error [rad], time [s], speed along the axis [m/s]. All
are nan if there is no contact."""
_CHUNK = 500
"""number of runs whose histories are in memory at a time"""
_PATHS = 40
"""number of paths of each law in the figure"""


class DockingCase(NamedTuple):
    """One case. By default, 20 % of the detections are lost, and the actuators are those of the case ``mix``."""

    name: str
    text: str
    detector: Values = NONE
    """parameters of the detector that differ from the default"""
    is_mixed: bool = True
    """True for the actuators of the case ``mix``, False for ideal actuators with limited speeds"""
    backward: bool = False
    """True if the robot docks with its back"""
    sampling_time: float = 0.1
    """[s]"""


CASES = (
    DockingCase("docking", "realistic mix of actuators, 20 % of the detections lost"),
    DockingCase("docking_no_loss", "no detection lost", {"detection_dropout": 0.0}),
    DockingCase("docking_outliers", "5 % of the detections 0.5 m off", {"detection_outlier": 0.05}),
    DockingCase("docking_backward", "the back of the robot docks", backward=True),
    DockingCase("docking_no_mix", "ideal actuators", is_mixed=False),
    DockingCase("docking_50_hz", "control at 50 Hz instead of 10 Hz", sampling_time=0.02),
)


def case_of(case: DockingCase, law: type[Law]) -> Case:
    """Return the simulation case of a law. The data sheet of the law describes the actuators."""
    (mix,) = cases_named(("mix",))
    actuators = {name: value for name, value in mix.world.items() if not name.startswith("fix_")}
    plant = {"wheel_speed_max": LIMITS["wheel.max_velocity"], "sampling_time": case.sampling_time}
    plant |= actuators if case.is_mixed else {}
    sensors = {"fix_rate": 0.0, "detection_rate": 10.0, **case.detector}
    names = {one.name for one in parameters_of(law.Config)}
    sheet = {**LIMITS, **(mix.sheet if case.is_mixed else {}), "dock_backward": case.backward}
    config = build(law.Config, {name: value for name, value in sheet.items() if name in names})
    shared = Configuration(build(PlantConfig, plant), build(SensorConfig, sensors), config, FILTER)
    return make_case(shared, DURATION, law=law, tolerance=(XY_TOLERANCE, YAW_TOLERANCE))


def docking_starts(count: int, seed: int) -> Array:
    """Return starts (count, 3) [m, m, rad] before a dock at the origin: 0.5 to 3 m, +-0.5 m lateral, +-45 degrees."""
    low, high = (-3.0, -0.5, -math.pi / 4.0), (-0.5, 0.5, math.pi / 4.0)
    return np.random.default_rng((seed, 1)).uniform(low, high, (count, 3))


def turned(poses: Array) -> Array:
    """Transform poses (..., n >= 3) of a robot that docks with its back to those of a robot that docks with its front.

    The dock's frame is turned by pi, and so is the robot.
    """
    result: Array = poses.copy()
    result[..., :2] *= -1.0
    return result


def contacts(histories: Array, sampling_time: float) -> Array:
    """Return the contacts (runs, 4), columns as CONTACT_COLUMNS.

    The robot docks in the direction of x. All values are interpolated linearly between the steps before and after the
    contact.

    Args:
        histories: (runs, steps + 1, >= 3); the first columns are x, y and theta.
        sampling_time: [s]
    """
    x = histories[:, :, 0]
    crossing = (x[:, :-1] < 0.0) & (x[:, 1:] >= 0.0)
    runs = np.flatnonzero(crossing.any(axis=1))
    at = crossing[runs].argmax(axis=1)
    before, after = histories[runs, at, :3], histories[runs, at + 1, :3]
    change = after - before
    change[:, 2] = (change[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    share = -before[:, 0] / change[:, 0]
    result: Array = np.full((len(histories), len(CONTACT_COLUMNS)), np.nan)
    pose = before + share[:, np.newaxis] * change
    result[runs] = np.column_stack((pose[:, 1], pose[:, 2], (at + share) * sampling_time, change[:, 0] / sampling_time))
    return result


def run_docking(case: DockingCase, law: type[Law], starts: Array, seed: int, bar: Any = None) -> tuple[Array, Array]:
    """Simulate one run from each start. Return all contacts (runs, 4) and some paths (<= 500, steps + 1, 3).

    Both are in the frame of the dock; see :func:`turned` if the robot docks with its back. The progress bar counts the
    finished runs.
    """
    shared, chunks, paths = case_of(case, law), [], np.empty((0, 0, 3))
    rows = Starts(turned(starts) if case.backward else starts)
    for first in range(0, len(starts), _CHUNK):
        count = min(_CHUNK, len(starts) - first)
        histories = run_histories(shared, rows, seed, first, count, law=law)[:, :, :3]
        histories = turned(histories) if case.backward else histories
        chunks.append(contacts(histories, shared.robot.plant.sampling_time))
        paths = histories if first == 0 else paths
        if bar is not None:
            bar.update(count)
    return np.concatenate(chunks), paths


def figures_of(runs: Array) -> dict[str, Any]:
    """Return the statistics of contacts (runs, 4)."""
    touched = runs[~np.isnan(runs[:, 0])]
    docked = int(((np.abs(touched[:, 0]) <= XY_TOLERANCE) & (np.abs(touched[:, 1]) <= YAW_TOLERANCE)).sum())
    return {
        "runs": len(runs),
        "docked": docked,
        "docked_interval": list(wilson(docked, len(runs))),
        "beside": len(touched) - docked,
        "no_contact": len(runs) - len(touched),
        "lateral": spread(np.abs(touched[:, 0])),
        "heading": spread(np.abs(touched[:, 1])),
        "time": spread(touched[:, 2]),
        "speed": spread(touched[:, 3]),
    }


def run_and_report(runs: int, seed: int, names: tuple[str, ...], folder: Path) -> int:
    """Run both laws in the named cases, write results.json and docking.png, and print the table.

    Args:
        runs: number of runs of each law in each case.
        seed: seed of starts and noise.
        names: names of cases; empty for all cases.
        folder: folder of results.json and docking.png.

    Raises:
        DiffbotError: for an unknown case, or if the folder cannot be written.
    """
    cases, starts = cases_named(names, CASES), docking_starts(runs, seed)
    results: dict[str, Any] = {"runs": runs, "seed": seed, "duration": DURATION, "cases": []}
    shown: dict[str, tuple[Array, Array]] = {}
    total = runs * len(cases) * len(LAWS)
    with output_folder(folder), tqdm(total=total, desc="docking", unit="run", disable=None) as bar:
        for case in cases:
            done = {name: run_docking(case, law, starts, seed, bar) for name, law in LAWS.items()}
            shown = shown or done
            figures = {name: figures_of(contact) for name, (contact, _) in done.items()}
            results["cases"].append({"name": case.name, "text": case.text, "laws": figures})
            # Write after each case, so that an interrupt loses at most one case.
            write_json(folder / "results.json", results)
        draw(shown, folder / "docking.png")
    for case in cases:
        for name, law in LAWS.items():
            shared = case_of(case, law)
            print(described(f"{case.name}: law {name}", controller=shared.controller, plant=shared.robot.plant))
        print(described(f"{case.name}: both", sensors=shared.robot.sensors))
    print("\n".join(["", *table(results), f"Results in {folder}"]))
    return 0


def table(results: dict[str, Any]) -> list[str]:
    """Return the lines of a Markdown table with the statistics of both laws in each case."""
    head = ["case", "law", "docked [%]", "beside", "no contact", "lateral [cm]: 50/95/99 %"]
    head += ["heading [degrees]: 50/95/99 %", "time [s]: 50/95/99 %", "speed [m/s]: 50/95/99 %"]
    scales = {"lateral": (100.0, 2), "heading": (math.degrees(1.0), 2), "time": (1.0, 1), "speed": (1.0, 2)}
    rows = []
    for row in results["cases"]:
        for name, one in row["laws"].items():
            low, high = (100.0 * bound for bound in one["docked_interval"])
            cells = [f"`{row['name']}`: {row['text']}", LABELS[name]]
            cells += [f"{100.0 * one['docked'] / one['runs']:.2f} [{low:.2f}, {high:.2f}]"]
            cells += [str(one["beside"]), str(one["no_contact"])]
            for part, (scale, digits) in scales.items():
                values = [one[part][level] for level in ("median", "p95", "p99")]
                cells.append("/".join(number(None if value is None else scale * value, digits) for value in values))
            rows.append(cells)
    return markdown_table(head, rows)


def draw(shown: dict[str, tuple[Array, Array]], path: Path) -> None:
    """Draw paths of each law, and the distributions of lateral error, heading error and time at contact."""
    # Imports matplotlib.
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
