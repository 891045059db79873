"""The law and its peers under equal conditions: ``diffbot benchmark switching``.

Every law has the same starts, the same noise (run i of each has the noise of (seed, i)), the same limits and the same
data sheet, and was tuned with the same budget on other starts and other noise (:mod:`diffbot_lab.arena.tuning`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_control.law.presets import TUNED
from diffbot_core.errors import InvalidValueError
from diffbot_core.files import output_folder, write_json
from diffbot_lab.arena.cases import (
    DURATION,
    LIMITS,
    OWN,
    XY_TOLERANCE,
    YAW_TOLERANCE,
    ArenaCase,
    arena_starts,
    cases_named,
    world_of,
)
from diffbot_lab.arena.entries import OWN_NAME, Entry, config_of, entries_for, is_own
from diffbot_lab.arena.report.ahead import peers_ahead
from diffbot_lab.arena.report.text import table
from diffbot_lab.arena.runs import case_of, run_case, run_paths
from diffbot_lab.arena.statistics import figures_of
from diffbot_lab.arena.tuning import TRAINING_SEED, read_tuning, tuned_values
from diffbot_lab.cases import changes
from diffbot_sim.compiled.batch import HISTORY_COLUMNS, Starts, run_histories

Array = NDArray[np.float64]

NOMINAL = "nominal"
RUNS_OF_FIGURE = 12
START_OF_FIGURE = 10
"""(0, 12 m), heading 220 deg"""


class ArenaOptions(NamedTuple):
    """What is run."""

    runs: int
    """of each of the 17 starts; as many in all of each case with other starts"""
    seed: int
    """of noise and random starts"""
    laws: tuple[str, ...] = ()
    """names of entries or ``package.module:Class``, beside this project's; none: all entries"""
    cases: tuple[str, ...] = ()
    """names; none: all"""
    tuning: Path | None = None
    """a tuning.json; None: the one installed"""
    own_runs: int = 0
    """of each start for this project's law, if more than ``runs``: its intervals are narrower"""

    def runs_of(self, entry: Entry) -> int:
        """Return the number of runs of a law in a case."""
        runs = max(self.runs, self.own_runs) if entry.name == OWN_NAME else self.runs
        return runs * len(arena_starts())


def still_moving(histories: Array, sampling_time: float) -> int:
    """Count runs that are commanded more than 0.05 m/s at any time in their last second."""
    last = max(1, round(1.0 / sampling_time))
    speed = np.abs(histories[:, -last:, HISTORY_COLUMNS.index("v")])
    return int((speed > 0.05).any(axis=1).sum())


def takes_part(entry: Entry, case: ArenaCase) -> bool:
    """Return True if a law is run in a case."""
    if case.table == OWN:
        return entry.name == OWN_NAME
    return entry.everywhere or case.name == NOMINAL


def run_benchmark(options: ArenaOptions) -> tuple[dict[str, Any], dict[str, Array]]:
    """Execute all runs, with a progress bar on a terminal.

    Returns:
        The content of results.json, and the outcomes of each law in the nominal case by its name.

    Raises:
        InvalidValueError: for fewer than one run, the seed of the training, an unknown law or case.
    """
    if options.runs < 1:
        raise InvalidValueError("runs", options.runs, ">= 1")
    if options.seed == TRAINING_SEED:
        raise InvalidValueError("seed", options.seed, "another one than that of the tuning")
    entries, cases = entries_for(options.laws), cases_named(options.cases)
    tuning = read_tuning(options.tuning)
    tuned = {entry.name: tuned_values(tuning, entry) for entry in entries}
    for case in cases:  # all values are checked before the first run
        world_of(case)
        for entry in entries:
            config_of(entry, case, tuned[entry.name])
    outcomes: dict[str, Array] = {}
    rows = []
    with tqdm(total=_number(entries, cases), desc="benchmark", unit="law", disable=None) as bar:
        for case in cases:
            laws = []
            for entry in (one for one in entries if takes_part(one, case)):
                count, most = options.runs_of(entry), options.runs_of(entries[0])
                found = run_case(entry, case, tuned[entry.name], count, options.seed, most)
                if case.name == NOMINAL:
                    outcomes[entry.name] = found
                laws.append({"name": entry.name} | figures_of(found))
                bar.update()
            row = {"name": case.name, "text": case.text, "table": case.table, "laws": laws}
            rows.append(row | _moving(case, entries, tuned, options))
    results = _arena(options) | {"tuning": tuning, "cases": rows}
    results["laws"] = [_described(entry, config_of(entry, cases[0], tuned[entry.name])) for entry in entries]
    return results | {"ahead": peers_ahead(results)}, outcomes


def _arena(options: ArenaOptions) -> dict[str, Any]:
    """Return what all laws and cases share."""
    return {
        "runs_of_each_start": options.runs,
        "own_runs_of_each_start": max(options.runs, options.own_runs),
        "starts": len(arena_starts()),
        "seed": options.seed,
        "duration": DURATION,
        "xy_tolerance": XY_TOLERANCE,
        "yaw_tolerance": YAW_TOLERANCE,
        "limits": dict(LIMITS),
    }


def _number(entries: tuple[Entry, ...], cases: tuple[ArenaCase, ...]) -> int:
    return sum(takes_part(entry, case) for entry in entries for case in cases)


def _described(entry: Entry, config: Any) -> dict[str, Any]:
    law = f"{entry.law}, preset {TUNED}" if is_own(entry) else entry.law
    runs_with = {"parameters": f"law {law}; {changes(config)}"}
    described = runs_with | {"name": entry.name, "label": entry.label, "source": entry.source, "purpose": entry.purpose}
    return described | {"ours": is_own(entry), "bound": entry.feedback != "ekf", "tuned": bool(entry.space)}


def _moving(
    case: ArenaCase, entries: tuple[Entry, ...], tuned: dict[str, Any], options: ArenaOptions
) -> dict[str, int]:
    """Count the runs that still move at the end, where the tolerance is so tight that they might."""
    if case.name != "precise":
        return {}
    shared = case_of(entries[0], case, tuned[OWN_NAME])
    histories = run_histories(shared, Starts(arena_starts()), options.seed, 0, options.runs * len(arena_starts()))
    return {"moving": still_moving(histories, shared.plant.sampling_time)}


def run_and_report(options: ArenaOptions, folder: Path, figures: bool) -> int:
    """Run the benchmark, write results.json and benchmark.png to ``folder``, and print the tables.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    with output_folder(folder):
        results, outcomes = run_benchmark(options)
        write_json(folder / "results.json", results)
        print(table(results))
        if figures and outcomes:
            draw(outcomes, options, folder / "benchmark.png")
    print(f"Results in {folder}")
    return 0


def draw(outcomes: dict[str, Array], options: ArenaOptions, path: Path) -> None:
    """Draw the paths of each law from one start, and the distributions over all its runs, in the nominal case."""
    # Loads matplotlib.
    from diffbot_lab.arena.report.figure import Sheet, draw_benchmark  # noqa: PLC0415

    (case,) = cases_named((NOMINAL,))
    tuning = read_tuning(options.tuning)
    start = arena_starts()[START_OF_FIGURE]
    sheets = []
    for entry in (one for one in entries_for(options.laws) if one.everywhere):
        values = tuned_values(tuning, entry)
        paths = run_paths(entry, case, values, start, RUNS_OF_FIGURE, options.seed)
        sheets.append(Sheet(entry.name, entry.label, outcomes[entry.name], paths[:, :, :3]))
    draw_benchmark(sheets, path)
