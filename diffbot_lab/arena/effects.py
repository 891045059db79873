"""What each parameter of the default law changes: ``diffbot benchmark effects``.

One parameter at a time is halved and doubled, in two cases of the arena: the nominal one, and the realistic mix. In the
mix the data sheet is changed, too, while the robot stays as it is. All runs have the same starts and the same noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from diffbot_control.law.controller import ControllerConfig
from diffbot_core.errors import InvalidValueError
from diffbot_core.files import output_folder, write_json
from diffbot_core.schema import parameters_of, to_dict
from diffbot_lab.arena.cases import ArenaCase, arena_starts, cases_named
from diffbot_lab.arena.entries import OWN_NAME, entries_for
from diffbot_lab.arena.runs import run_case
from diffbot_lab.arena.statistics import figures_of
from diffbot_lab.arena.tuning import TRAINING_SEED
from diffbot_lab.targets import markdown_table

CASES = ("nominal", "mix")
PARAMETERS = (
    *("react", "turn_react", "hold_react", "brake", "turn_brake", "hold_brake", "bearing_weight", "sigma_known"),
    *("eps_P_sigmas", "eps_P_min", "xy_goal_tolerance", "yaw_goal_tolerance", "reached_probability", "settling_steps"),
    *("finish_wait", "finish_begin", "finish_heading", "finish_speed", "uncertainty_scale"),
)
SHEET = (
    *("angular.z.max_velocity", "linear.x.max_acceleration", "angular.z.max_acceleration"),
    *("command_latency", "drive_time_constant", "min_velocity", "min_rotation"),
)
FACTORS = (0.5, 2.0)
_LARGEST = {one.name: one.spec.maximum for one in parameters_of(ControllerConfig)}
UNCHANGED = ""


class Variant(NamedTuple):
    """One parameter with another value, in one case."""

    case: ArenaCase
    parameter: str
    """UNCHANGED: the case as it is"""
    value: float


def variants() -> Iterator[Variant]:
    """Yield each case as it is, then with each parameter halved and doubled."""
    defaults = to_dict(ControllerConfig())
    for case in cases_named(CASES):
        yield Variant(case, UNCHANGED, 1.0)
        for name in PARAMETERS:
            for factor in FACTORS:
                value = _scaled(name, defaults[name], factor)
                yield Variant(case._replace(own={**case.own, name: value}), name, value)
        for name in (one for one in SHEET if one in case.sheet):
            for factor in FACTORS:
                value = factor * case.sheet[name]
                yield Variant(case._replace(sheet={**case.sheet, name: value}), name, value)


def _scaled(name: str, value: float, factor: float) -> float:
    """Return a value times ``factor``, up to its bound; of a probability near 1, the chance of the opposite."""
    if name == "reached_probability":
        return 1.0 - factor * (1.0 - value)
    return type(value)(min(factor * value, _LARGEST[name]))


def run_effects(runs: int, seed: int) -> dict[str, Any]:
    """Run all variants, with a progress bar on a terminal; return the content of results.json.

    Raises:
        InvalidValueError: for fewer than one run, or the seed of the training.
    """
    if runs < 1:
        raise InvalidValueError("runs", runs, ">= 1")
    if seed == TRAINING_SEED:
        raise InvalidValueError("seed", seed, "another one than that of the tuning")
    (entry,) = (one for one in entries_for(()) if one.name == OWN_NAME)
    rows = []
    for one in tqdm(list(variants()), desc="effects", unit="variant", disable=None):
        found = figures_of(run_case(entry, one.case, {}, runs * len(arena_starts()), seed))
        rows.append({"case": one.case.name, "parameter": one.parameter, "value": one.value, **found})
    return {"runs_of_each_start": runs, "starts": len(arena_starts()), "seed": seed, "rows": rows}


def run_and_report(runs: int, seed: int, out: Path) -> int:
    """Write results.json to ``out`` and print the tables.

    Raises:
        DiffbotError: for a bad value or an unwritable folder.
    """
    results = run_effects(runs, seed)
    with output_folder(out):
        write_json(out / "results.json", results)
    print("law switching, preset tuned; in each row one parameter, or the data sheet, is changed\n")
    print("\n".join([*law_table(results), "", *sheet_table(results), "", f"{out / 'results.json'}"]))
    return 0


def law_table(results: dict[str, Any]) -> list[str]:
    """Lay out the parameters of the law in both cases as a Markdown table."""
    head = ["parameter", "value"]
    head += [f"{case}: {what}" for case in CASES for what in ("settled [%]", "median [s]", "95 % [m]")]
    found = {(row["case"], row["parameter"], row["value"]): row for row in results["rows"]}
    rows = [["as it is", "", *_figures(found, UNCHANGED, 1.0)]]
    for name in PARAMETERS:
        values = sorted({value for _, parameter, value in found if parameter == name})
        rows += [[f"`{name}`", f"{value:g}", *_figures(found, name, value)] for value in values]
    return markdown_table(head, rows)


def sheet_table(results: dict[str, Any]) -> list[str]:
    """Lay out the wrong data sheets in the realistic mix as a Markdown table."""
    case = CASES[-1]
    rows = []
    for row in (one for one in results["rows"] if one["case"] == case and one["parameter"] in (UNCHANGED, *SHEET)):
        name = f"`{row['parameter']}`" if row["parameter"] else "as it is"
        rows.append([name, f"{row['value']:g}" if row["parameter"] else "", *_cells(row)])
    return markdown_table(("data sheet says", "value", "settled [%]", "median [s]", "95 % [m]"), rows)


def _figures(found: dict[tuple[str, str, float], dict[str, Any]], name: str, value: float) -> list[str]:
    return [cell for case in CASES for cell in _cells(found[case, name, value])]


def _cells(row: dict[str, Any]) -> list[str]:
    time, error = row["settling_time"]["median"], row["position"]["p95"]
    share = 100.0 * row["settled"] / row["runs"]
    return [f"{share:.1f}", "-" if time is None or np.isnan(time) else f"{time:.1f}", f"{error:.3f}"]
