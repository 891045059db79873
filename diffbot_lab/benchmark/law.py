"""The law and its peers under equal conditions: ``diffbot benchmark switching``.

Every law has the same starts and the same noise: run i of each has the noise of (seed, i). The laws receive the
filter's estimate.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_control.filter.localization import LocalizationConfig
from diffbot_control.filter.options import FilterConfig
from diffbot_core.errors import InvalidValueError
from diffbot_core.files import output_folder, write_json
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_lab.benchmark.law_cases import (
    CHALLENGES,
    DELAYED,
    DURATION,
    LAWS,
    TUNED_CONTROLLER,
    V_MAX,
    XY_TOLERANCE,
    YAW_TOLERANCE,
    Challenge,
    Law,
    arena_starts,
    case_of,
)
from diffbot_lab.benchmark.law_report import conclusions, table
from diffbot_lab.metrics import quantiles
from diffbot_lab.paper.scenarios import GOAL
from diffbot_sim.compiled.batch import COLUMNS, HISTORY_COLUMNS, Starts, run_batch, run_histories
from diffbot_sim.compiled.peer_laws import OURS
from diffbot_sim.model.simulator import StartPose, WorldConfig
from diffbot_sim.reference_loop import simulate

Array = NDArray[np.float64]

FAR, NEAR = 15.0, 1.0
"""[m] radii of the random starts"""
DELAY_SHARE = 25
"""One in this many runs is simulated with late fixes, which need the slower uncompiled loop."""
RUNS_OF_FIGURE = 12
START_OF_FIGURE = 10
"""(0, 12 m), heading 220 deg"""


def figures_of(outcomes: Array, distances: Array) -> dict[str, Any]:
    """Turn outcomes (runs, 9), see batch.COLUMNS, into the figures of one row.

    Args:
        outcomes: of the runs.
        distances: (runs,) [m] of start and goal.
    """
    column = {name: outcomes[:, index] for index, name in enumerate(COLUMNS)}
    settled = np.isfinite(column["settling_time"])
    # Whole steps: 117 of 0.1 s are 11.7 s, without the rounding error of the product.
    time = np.round(column["settling_time"][settled], 9)
    bound = distances[settled] / V_MAX
    return {
        "runs": len(outcomes),
        "settled": int(settled.sum()),
        "settling_time": _spread(time),
        "over_bound": _spread(time / bound),
        "bound": float(np.median(distances)) / V_MAX,
        "position": _spread(np.hypot(column["x"], column["y"])),
        "heading": _spread(np.abs(column["theta"])),
        "filter": _spread(column["estimation_error"]),
        "path_ratio": _spread(column["path_length"] / distances),
        "effort": _spread(column["effort"]),
        "switches": _spread(column["switches"]),
        "one_switch": float((column["switches"] == 1.0).mean()),
    }


def _spread(values: Array) -> dict[str, float | None]:
    """Median, 95 %, 99 % and maximum; None if there are no values."""
    return quantiles(values, {"median": 0.5, "p95": 0.95, "p99": 0.99, "max": 1.0})


def still_moving(histories: Array, sampling_time: float) -> int:
    """Count runs that are commanded more than 0.05 m/s at any time in their last second."""
    last = max(1, round(1.0 / sampling_time))
    speed = np.abs(histories[:, -last:, HISTORY_COLUMNS.index("v")])
    return int((speed > 0.05).any(axis=1).sum())


def run_benchmark(runs: int, seed: int) -> tuple[dict[str, Any], dict[str, Array]]:
    """Execute all runs, with a progress bar on a terminal.

    Args:
        runs: of each start; ten times as many of each random case.
        seed: of all noise.

    Returns:
        The content of results.json, and the outcomes of each law by its name.

    Raises:
        InvalidValueError: for fewer than one run.
    """
    if runs < 1:
        raise InvalidValueError("runs", runs, ">= 1")
    starts = arena_starts()
    outcomes: dict[str, Array] = {}
    laws, challenges = [], []
    with tqdm(total=len(LAWS) + len(CHALLENGES) + 3, desc="benchmark", unit="case", disable=None) as bar:
        for law in LAWS:
            outcomes[law.name] = run_batch(case_of(law), Starts(starts), seed, 0, runs * len(starts))
            described = {"name": law.name, "label": law.label, "source": law.source, "purpose": law.purpose}
            laws.append(described | {"ours": law.peer == OURS} | _arena_figures(outcomes[law.name], starts))
            bar.update()
        for name, figures in _challenges(runs, seed, starts):
            challenges.append({"name": name} | figures)
            bar.update()
    results: dict[str, Any] = {
        "runs_of_each_start": runs,
        "starts": len(starts),
        "seed": seed,
        "duration": DURATION,
        "xy_tolerance": XY_TOLERANCE,
        "yaw_tolerance": YAW_TOLERANCE,
        "v_max": V_MAX,
        "laws": laws,
        "challenges": challenges,
    }
    return results | conclusions(results), outcomes


def _arena_figures(outcomes: Array, starts: Array) -> dict[str, Any]:
    distances = np.resize(np.hypot(starts[:, 0], starts[:, 1]), len(outcomes))
    return figures_of(outcomes, distances)


def _challenges(runs: int, seed: int, starts: Array) -> Iterator[tuple[str, dict[str, Any]]]:
    count = runs * len(starts)
    for one in CHALLENGES:
        case = case_of(one)
        figures = {"text": one.text} | _arena_figures(run_batch(case, Starts(starts), seed, 0, count), starts)
        if one.name == "precise":
            histories = run_histories(case, Starts(starts), seed, 0, count)
            figures["moving"] = still_moving(histories, case.plant.sampling_time)
        yield one.name, figures
    for name, radius in (("random_far", FAR), ("random_near", NEAR)):
        text = f"starts within {radius:g} m of random goals, any heading"
        yield name, {"text": text} | _random(Challenge(name, text, TUNED_CONTROLLER), radius, 10 * runs, seed)
    few = max(1, runs // DELAY_SHARE) * len(starts)
    late = np.array([_delayed(starts[run % len(starts)], seed, run) for run in range(few)])
    yield DELAYED.name, {"text": DELAYED.text} | _arena_figures(late, starts)


def _random(challenge: Challenge, radius: float, runs: int, seed: int) -> dict[str, Any]:
    """Simulate runs that start uniformly in a disc about a goal of their own, uniform in a 20 m x 20 m square."""
    rng = np.random.default_rng((seed, round(1000.0 * radius)))
    distances = radius * np.sqrt(rng.random(runs))
    bearings, headings, turns = rng.uniform(-math.pi, math.pi, (3, runs))
    goals = rng.uniform(-10.0, 10.0, (runs, 2))
    rows = []
    for run in range(runs):
        goal = Pose(goals[run, 0], goals[run, 1], turns[run])
        x = goal.x + distances[run] * math.cos(bearings[run])
        y = goal.y + distances[run] * math.sin(bearings[run])
        start = np.array([(x, y, wrap_angle(headings[run]))])
        rows.append(run_batch(case_of(challenge, goal), Starts(start), seed, run, 1, 1)[0])
    return figures_of(np.array(rows), distances)


def _delayed(start: Array, seed: int, run: int) -> Array:
    """Simulate one run with late fixes in the uncompiled loop, whose filter keeps a history."""
    world = WorldConfig(DELAYED.plant, DELAYED.sensors, StartPose(*start.tolist()), seed, run)
    steps = round(DURATION / DELAYED.plant.sampling_time)
    config = LocalizationConfig(filter=FilterConfig(filter=DELAYED.filter))
    recording = simulate(world, DELAYED.controller, GOAL, steps, localization=config)
    return np.array(recording.outcome(GOAL, XY_TOLERANCE, YAW_TOLERANCE))


def paths_of(law: Law, seed: int) -> Array:
    """Return histories (RUNS_OF_FIGURE, steps + 1, 8) from the start that the figure shows."""
    starts = Starts(arena_starts()[START_OF_FIGURE : START_OF_FIGURE + 1])
    return run_histories(case_of(law), starts, seed, 0, RUNS_OF_FIGURE)


def run_and_report(runs: int, seed: int, folder: Path, figures: bool) -> int:
    """Run the benchmark, write results.json and benchmark.png to ``folder``, and print the tables.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    with output_folder(folder):
        results, outcomes = run_benchmark(runs, seed)
        write_json(folder / "results.json", results)
        print(table(results))
        if figures:
            draw(outcomes, seed, folder / "benchmark.png")
    print(f"Results in {folder}")
    return 0


def draw(outcomes: dict[str, Array], seed: int, path: Path) -> None:
    """Draw the paths of each law from one start, and the distributions over all its runs."""
    # Loads matplotlib.
    from diffbot_lab.benchmark.law_figure import Sheet, draw_benchmark  # noqa: PLC0415

    sheets = [Sheet(law.name, law.label, outcomes[law.name], paths_of(law, seed)[:, :, :3]) for law in LAWS]
    draw_benchmark(sheets, path)
