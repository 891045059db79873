"""The paper's simulations (section 4.2), 100 runs each: what ``diffbot experiment a`` and ``b`` run and count."""

from __future__ import annotations

import math
import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_control.filter.options import EKF, FilterConfig, options_of
from diffbot_control.law.controller import ControllerConfig
from diffbot_control.law.presets import PAPER, PRESETS
from diffbot_control.law.regions import FixedRegionPolicy
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.files import write_json
from diffbot_core.geometry import Pose
from diffbot_sim.compiled.batch import COLUMNS, FEEDBACK_CODES, HISTORY_COLUMNS, Starts, run_batch, run_histories
from diffbot_sim.compiled.closed_loop import Case
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig

Array = NDArray[np.float64]

STEPS = 300
"""30 s at the paper's sampling time of 0.1 s; the paper does not say how long its runs are"""
EPS_P = 0.5
"""[m] the paper gives a condition, met from 0.474 m on, and no value"""
GOAL = Pose(0.0, 0.0, 0.0)
START_A = (-2.0, -5.5, math.radians(30.0))
RADIUS_B = 12.0
HEADINGS_B = (0.0, 220.0)
"""[deg]"""
XY_TOLERANCE, YAW_TOLERANCE = 0.4, 0.1
PLAIN = options_of(FilterConfig(filter=EKF, gate_probability=1.0))
"""The textbook's filter, where one is in the loop: the runs have no faults."""
LAWS = ("law 13", "law 17")
QUANTILES = (0.01, 0.05, 0.5, 0.95, 0.99)

PAPER_END_STATES = {"law 13": (0.0071, -0.0097, 0.7519), "law 17": (0.0028, 0.1049, 0.0066)}
"""x [m], y [m], theta [rad] that the paper reports of single runs of A"""


class Setting(NamedTuple):
    """What disturbs the loop, and what the controller sees."""

    name: str
    text: str
    plant: PlantConfig
    sensors: SensorConfig
    feedback: str


SETTINGS = (
    Setting(
        "raw",
        "the paper's noise: uniform +-0.3 m, +-0.3 m, +-0.17 rad straight into the law, input noise added",
        PlantConfig(exact_arc=False, drive_noise=0.0, encoder_noise=0.0, eps_v_max=0.065, eps_omega_max=0.2167),
        SensorConfig(),
        "raw",
    ),
    Setting(
        "ekf",
        "the same fixes through the EKF, +-5 % per wheel in drive and encoder",
        PlantConfig(),
        SensorConfig(),
        "ekf",
    ),
    Setting(
        "quiet",
        "no noise",
        PlantConfig(exact_arc=False, drive_noise=0.0, encoder_noise=0.0),
        SensorConfig(eps_x_max=0.0, eps_y_max=0.0, eps_theta_max=0.0),
        "truth",
    ),
)


class Group(NamedTuple):
    """One set of runs that share everything but their noise."""

    label: str
    law: str
    setting: Setting
    starts: Starts
    outcomes: Array
    """(runs, 9) see batch.COLUMNS"""
    histories: Array
    """(runs, steps + 1, 8) see batch.HISTORY_COLUMNS"""


def controller_of(law: str) -> ControllerConfig:
    """Return the paper's gains and region for one of LAWS; without hysteresis, as the paper has it."""
    radius = {"law 13": 0.0, "law 17": EPS_P}[law]
    paper = PRESETS[PAPER]
    return paper._replace(region_policy=paper.region_policy._replace(fixed=FixedRegionPolicy(radius, radius)))


def case_of(law: str, setting: Setting, literal_rear: bool = False) -> Case:
    """Return the case of a law under a setting; ``literal_rear`` takes the printed sign of the rear sector."""
    return Case(
        setting.plant,
        setting.sensors,
        controller_of(law),
        GOAL,
        FEEDBACK_CODES[setting.feedback],
        literal_rear,
        STEPS,
        XY_TOLERANCE,
        YAW_TOLERANCE,
        filter=PLAIN,
    )


def starts_of(name: str, heading: float = 0.0) -> Starts:
    """Return the start of A, or the 8 starts of B on the circle with one heading [deg]."""
    if name == "a":
        return Starts(np.array([START_A]))
    angles = np.arange(8) * math.pi / 4.0
    column = np.full(8, math.radians(heading if heading <= 180.0 else heading - 360.0))
    return Starts(np.column_stack([RADIUS_B * np.cos(angles), RADIUS_B * np.sin(angles), column]))


def run_experiment(name: str, runs: int, seed: int) -> list[Group]:
    """Do all runs of experiment ``a`` or ``b``.

    Args:
        name: "a" or "b".
        runs: of each start, law and setting.
        seed: of all noise.

    Raises:
        InvalidValueError: for another name or less than one run.
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
    """Return what results.json holds."""
    return {
        "experiment": name,
        "runs": runs,
        "seed": seed,
        "steps": STEPS,
        "sampling_time": groups[0].setting.plant.sampling_time,
        "eps_P": EPS_P,
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
        "runs": len(position),
        "reached_local_region": int(np.isfinite(column["local_time"]).sum()),
        "settled": int(np.isfinite(column["settling_time"]).sum()),
        "max_speed": float(np.abs(group.histories[:, :, HISTORY_COLUMNS.index("v")]).max()),
        "position": _quantiles(position),
        "abs_theta": _quantiles(np.abs(column["theta"])),
        **{name: _quantiles(column[name]) for name in ("x", "y", "theta", "path_length")},
        "distance_at_10_s": _quantiles(_distance_at(group, 100)),
    }
    if len(group.starts.poses) == 1 and group.setting.name != "quiet":
        summary["paper"] = _paper_in_ours(group.law, column)
    return summary


def _quantiles(values: Array) -> dict[str, float]:
    return {f"{q:g}": float(value) for q, value in zip(QUANTILES, np.quantile(values, QUANTILES), strict=True)}


def _distance_at(group: Group, index: int) -> Array:
    return np.asarray(np.hypot(group.histories[:, index, 0], group.histories[:, index, 1]))


def _paper_in_ours(law: str, column: dict[str, Array]) -> dict[str, dict[str, Any]]:
    """Where the paper's single run falls in our distribution."""
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


def _literal_rear_sector(runs: int, seed: int) -> dict[str, dict[str, dict[str, float]]]:
    """Final |position| of B under law (17) with our reading and with the printed sign of the rear sector."""
    results = {}
    for setting in SETTINGS:
        for literal in (False, True):
            case = case_of("law 17", setting, literal)
            both = [run_batch(case, starts_of("b", heading), seed, 0, 8 * runs) for heading in HEADINGS_B]
            ends = np.concatenate(both)
            results[f"{setting.name} {'as printed' if literal else 'our reading'}"] = {
                "position": _quantiles(np.hypot(ends[:, 0], ends[:, 1])),
                "abs_theta": _quantiles(np.abs(ends[:, 2])),
            }
    return results


def run_and_report(names: tuple[str, ...], runs: int, seed: int, folder: Path, figures: bool) -> None:
    """Run experiments, write results.json and figures below ``folder``, and print a table.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    # Drawing pulls in matplotlib, and its workers should not wait for it.
    from diffbot_lab.paper.figures import figure_paths  # noqa: PLC0415

    try:
        with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
            drawn: list[Any] = []
            for name in names:
                target = folder / name
                target.mkdir(parents=True, exist_ok=True)
                groups = run_experiment(name, runs, seed)
                results = summarise(name, runs, seed, groups)
                write_json(target / "results.json", results)
                print(table(results))
                if figures:
                    drawn += figure_paths(groups, target, pool)
            for future in tqdm(drawn, desc="figures", unit="figure", disable=None):
                future.result()
    except OSError as error:
        raise DiffbotError(f"cannot write to {folder}: {error.strerror}") from None
    print(f"Results and figures in {folder}")


def table(results: dict[str, Any]) -> str:
    """Lay out the end states of an experiment for a terminal."""
    head = f"{'experiment ' + results['experiment']:<18}{'setting':<8}{'runs':>6}{'Omega_L':>9}"
    head += f"{'|pos| median':>14}{'p95 [m]':>9}{'|theta| median':>16}{'p95 [rad]':>11}{'max |v|':>9}"
    rows = [head, "-" * len(head)]
    rows += [
        f"{one['label']:<18}{one['setting']:<8}{one['runs']:>6}{one['reached_local_region']:>9}"
        f"{one['position']['0.5']:>14.4f}{one['position']['0.95']:>9.4f}{one['abs_theta']['0.5']:>16.4f}"
        f"{one['abs_theta']['0.95']:>11.4f}{one['max_speed']:>9.4f}"
        for one in results["groups"]
    ]
    return "\n".join(rows)
