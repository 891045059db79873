"""Runs, results and table of ``diffbot experiment a`` and ``b``: the paper's simulations (section 4.2)."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_control.law.presets import PAPER, PRESETS
from diffbot_core.errors import InvalidValueError
from diffbot_core.files import output_folder, write_json
from diffbot_lab.cases import changes, described
from diffbot_lab.paper.scenarios import (
    EPS_P,
    HEADINGS_B,
    LAWS,
    PAPER_END_STATES,
    SETTINGS,
    TEXTBOOK_FILTER,
    Group,
    Setting,
    case_of,
    controller_of,
    starts_of,
)
from diffbot_sim.compiled.batch import COLUMNS, HISTORY_COLUMNS, Starts, run_batch, run_histories
from diffbot_tools.metrics import quantiles

Array = NDArray[np.float64]

QUANTILES = {f"{q:g}": q for q in (0.01, 0.05, 0.5, 0.95, 0.99)}
"""Names in results.json and levels."""
_TEN_SECONDS = 100
"""[steps] at the sampling time of all settings"""


def run_experiment(name: str, runs: int, seed: int) -> list[Group]:
    """Execute all runs of experiment ``a`` or ``b``.

    Args:
        name: "a" or "b".
        runs: of each start, law and setting.
        seed: of all noise.

    Raises:
        InvalidValueError: for another name or fewer than one run.
    """
    if name not in ("a", "b"):
        raise InvalidValueError("experiment", name, "a or b")
    if runs < 1:
        raise InvalidValueError("runs", runs, ">= 1")
    groups = []
    for setting in SETTINGS:
        if name == "a":
            groups += [_group(law, law, setting, starts_of("a"), runs, seed) for law in LAWS]
        else:
            groups += [
                _group(f"heading {heading:.0f} deg", "law 17", setting, starts_of("b", heading), 8 * runs, seed)
                for heading in HEADINGS_B
            ]
    return groups


def _group(label: str, law: str, setting: Setting, starts: Starts, runs: int, seed: int) -> Group:
    case = case_of(law, setting)
    return Group(
        label,
        law,
        setting,
        starts,
        run_batch(case, starts, seed, 0, runs),
        run_histories(case, starts, seed, 0, runs),
    )


def summarise(name: str, runs: int, seed: int, groups: list[Group]) -> dict[str, Any]:
    """Return the content of results.json."""
    return {
        "experiment": name,
        "runs": runs,
        "seed": seed,
        "steps": groups[0].histories.shape[1] - 1,
        "sampling_time": groups[0].setting.plant.sampling_time,
        "groups": [_summary(group) for group in groups],
        "literal_rear_sector": _literal_rear_sector(runs, seed),
    }


def _summary(group: Group) -> dict[str, Any]:
    column = {name: group.outcomes[:, index] for index, name in enumerate(COLUMNS)}
    position = np.hypot(column["x"], column["y"])
    summary: dict[str, Any] = {
        "label": group.label,
        "law": group.law,
        "setting": group.setting.name,
        "eps_P": group.setting.eps_P if group.law == "law 17" else 0.0,
        "runs": len(position),
        "reached_local_region": int(np.isfinite(column["local_time"]).sum()),
        "settled": int(np.isfinite(column["settling_time"]).sum()),
        "max_speed": float(np.abs(group.histories[:, :, HISTORY_COLUMNS.index("v")]).max()),
        "position": quantiles(position, QUANTILES),
        "abs_theta": quantiles(np.abs(column["theta"]), QUANTILES),
        **{name: quantiles(column[name], QUANTILES) for name in ("x", "y", "theta", "path_length")},
        "distance_at_10_s": quantiles(_distance_at(group, _TEN_SECONDS), QUANTILES),
    }
    if len(group.starts.poses) == 1 and group.setting.name != "quiet":
        summary["paper"] = _rank_of_the_papers_run(group.law, column)
    return summary


def _distance_at(group: Group, index: int) -> Array:
    return np.asarray(np.hypot(group.histories[:, index, 0], group.histories[:, index, 1]))


def _rank_of_the_papers_run(law: str, column: dict[str, Array]) -> dict[str, dict[str, Any]]:
    """Rank the end state of the paper's single run among ours."""
    found = {}
    for name, value in zip(("x", "y", "theta"), PAPER_END_STATES[law], strict=True):
        low, high = np.quantile(column[name], (0.01, 0.99))
        found[name] = {
            "value": value,
            "share_below": float((column[name] < value).mean()),
            "inside_1_99": bool(low <= value <= high),
            "magnitude_share_below": float((np.abs(column[name]) < abs(value)).mean()),
        }
    return found


def _literal_rear_sector(runs: int, seed: int) -> dict[str, dict[str, Any]]:
    """Final errors of B under law (17), with the rear sector as implemented here and with the printed sign."""
    results = {}
    for setting in SETTINGS:
        for literal in (False, True):
            case = case_of("law 17", setting, literal)
            both = [run_batch(case, starts_of("b", heading), seed, 0, 8 * runs) for heading in HEADINGS_B]
            ends = np.concatenate(both)
            results[f"{setting.name} {'as printed' if literal else 'our reading'}"] = {
                "position": quantiles(np.hypot(ends[:, 0], ends[:, 1]), QUANTILES),
                "abs_theta": quantiles(np.abs(ends[:, 2]), QUANTILES),
            }
    return results


def run_and_report(names: tuple[str, ...], runs: int, seed: int, folder: Path, figures: bool) -> None:
    """Run experiments ``a`` and ``b``, write results.json and figures below ``folder``, and print a table.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    # Loads matplotlib, which the worker processes should start without.
    from diffbot_lab.paper.figures import figure_paths  # noqa: PLC0415

    with output_folder(folder), ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        drawn: list[Any] = []
        for name in names:
            target = folder / name
            target.mkdir(exist_ok=True)
            groups = run_experiment(name, runs, seed)
            results = summarise(name, runs, seed, groups)
            write_json(target / "results.json", results)
            print(f"{heading()}\n{table(results)}")
            if figures:
                drawn += figure_paths(groups, target, pool)
        for future in tqdm(drawn, desc="figures", unit="figure", disable=None):
            future.result()
    print(f"Results and figures in {folder}")


def heading() -> str:
    """Say what runs: laws, settings, and all that is not the default of the nodes."""
    lines = [f"{law}: preset paper; beside it, {changes(controller_of(law, EPS_P), PRESETS[PAPER])}" for law in LAWS]
    for one in SETTINGS:
        lines.append(described(f"{one.name}: feedback {one.feedback}", plant=one.plant, sensors=one.sensors))
    return "\n".join([*lines, f"filter of ekf: {changes(TEXTBOOK_FILTER)}"])


def table(results: dict[str, Any]) -> str:
    """Lay out the end states of an experiment for a terminal."""
    head = f"{'experiment ' + results['experiment']:<18}{'setting':<10}{'runs':>6}{'Omega_L':>9}"
    head += f"{'|pos| median':>14}{'p95 [m]':>9}{'|theta| median':>16}{'p95 [rad]':>11}{'max |v|':>9}"
    rows = [head, "-" * len(head)]
    rows += [
        f"{one['label']:<18}{one['setting']:<10}{one['runs']:>6}{one['reached_local_region']:>9}"
        f"{one['position']['0.5']:>14.4f}{one['position']['0.95']:>9.4f}{one['abs_theta']['0.5']:>16.4f}"
        f"{one['abs_theta']['0.95']:>11.4f}{one['max_speed']:>9.4f}"
        for one in results["groups"]
    ]
    return "\n".join(rows)
