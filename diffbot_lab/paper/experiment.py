"""Reproduce the paper's simulations A and B (section 4.2): ``diffbot experiment a b``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.config import EKF, FilterConfig
from diffbot_control.law.configuration import PaperConfig
from diffbot_control.law.paper import PaperLaw
from diffbot_core.errors import InvalidValueError
from diffbot_core.files import output_folder, write_json
from diffbot_lab.cases import Configuration, changes, described, make_case
from diffbot_sim.batch import COLUMNS, Starts, run_batch, run_histories
from diffbot_sim.config import PlantConfig, SensorConfig
from diffbot_sim.robot_step import HISTORY_COLUMNS, Case
from diffbot_tools.filter_statistics import quantiles

Array = NDArray[np.float64]

DURATION = 30.0
"""[s] length of a run; the paper does not state it"""
EPS_P = 0.5
"""[m] radius of Omega_L; the paper does not state it, but its condition for the radius requires more than 0.474 m"""
VANISHING_EPS_P = 0.25
"""[m] radius of Omega_L in the setting ``vanishing``, see docs/results/reproduction.md"""
NEAR_GOAL = 1.0
"""[m] distance from the goal below which the position noise of the setting ``vanishing`` decreases"""
START_A = (-2.0, -5.5, math.radians(30.0))
"""[m, m, rad] start of simulation A"""
RADIUS_B = 12.0
"""[m] radius of the circle of starts of simulation B"""
HEADINGS_B = (0.0, 220.0)
"""[deg] start headings of simulation B"""
XY_TOLERANCE, YAW_TOLERANCE = 0.4, 0.1
"""[m], [rad] tolerances for the settling time"""
TEXTBOOK_FILTER = FilterConfig(filter=EKF, gate_probability=1.0, detect_correlation=False)
"""Filter without calibration, and with a gate that accepts every fix, because the runs have no faults."""
LAWS = ("law 13", "law 17")

PAPER_END_STATES = {"law 13": (0.0071, -0.0097, 0.7519), "law 17": (0.0028, 0.1049, 0.0066)}
"""x [m], y [m], theta [rad] at the end of simulation A in the paper, which shows one run of each law"""


class Setting(NamedTuple):
    """Noise of the plant and the sensors, and the pose that the controller receives."""

    name: str
    plant: PlantConfig
    sensors: SensorConfig
    feedback: str
    eps_P: float = EPS_P
    """[m] radius of Omega_L for law 17"""


_INPUT_NOISE = PlantConfig(exact_arc=False, drive_noise=0.0, encoder_noise=0.0, eps_v_max=0.065, eps_omega_max=0.2167)
_NO_NOISE = PlantConfig(exact_arc=False, drive_noise=0.0, encoder_noise=0.0)
_EXACT = SensorConfig(eps_xy_max=0.0, eps_theta_max=0.0)
SETTINGS = (
    # The paper's noise: the law receives fixes with uniform errors of +-0.3 m, +-0.3 m and +-0.17 rad.
    Setting("raw", _INPUT_NOISE, SensorConfig(), "raw"),
    # The EKF filters the same fixes. Drives and encoders have errors of +-5 %.
    Setting("ekf", PlantConfig(), SensorConfig(), "ekf"),
    Setting("quiet", _NO_NOISE, _EXACT, "truth"),
    # Like "raw", but within NEAR_GOAL the position noise is proportional to the distance from the goal.
    Setting("vanishing", _INPUT_NOISE, SensorConfig(eps_xy_distance=NEAR_GOAL), "raw", VANISHING_EPS_P),
)


class Group(NamedTuple):
    """Results of runs that differ only in start and noise."""

    label: str
    law: str
    setting: Setting
    starts: Starts
    outcomes: Array
    """(runs, 12), columns as batch.COLUMNS"""
    histories: Array
    """(runs, steps + 1, 12), columns as robot_step.HISTORY_COLUMNS"""


def controller_of(law: str, eps_P: float) -> PaperConfig:
    """Return the configuration of one of LAWS with the paper's gains.

    ``eps_P`` [m] is the radius of Omega_L for law 17. As in the paper, the region has no hysteresis.
    """
    radius = {"law 13": 0.0, "law 17": eps_P}[law]
    return PaperConfig(eps_P=radius, eps_P_leave=radius)


def case_of(law: str, setting: Setting, literal_rear: bool = False) -> Case:
    """Return the case of a law and a setting.

    If ``literal_rear`` is True, the sign of v in the rear sector is the sign that the paper prints.
    """
    return make_case(
        Configuration(setting.plant, setting.sensors, controller_of(law, setting.eps_P), TEXTBOOK_FILTER),
        DURATION,
        law=PaperLaw,
        feedback=setting.feedback,
        tolerance=(XY_TOLERANCE, YAW_TOLERANCE),
        literal_rear=literal_rear,
    )


def starts_of(name: str, heading: float = 0.0) -> Starts:
    """Return the start of simulation A, or the 8 starts of simulation B with a heading [deg]."""
    if name == "a":
        return Starts(np.array([START_A]))
    angles = np.arange(8) * math.pi / 4.0
    column = np.full(8, math.radians(heading if heading <= 180.0 else heading - 360.0))
    return Starts(np.column_stack([RADIUS_B * np.cos(angles), RADIUS_B * np.sin(angles), column]))


QUANTILES = {f"{q:g}": q for q in (0.01, 0.05, 0.5, 0.95, 0.99)}
"""Quantiles by their names in results.json."""
_TEN_SECONDS = 100
"""number of steps in 10 s; all settings have the same sampling time"""


def run_experiment(name: str, runs: int, seed: int) -> list[Group]:
    """Simulate all runs of experiment ``a`` or ``b``.

    Args:
        name: "a" or "b".
        runs: number of runs of each start, law and setting.
        seed: seed of all noise.

    Raises:
        InvalidValueError: for another name, or for fewer than one run.
    """
    if name not in ("a", "b"):
        raise InvalidValueError("experiment", name, "a or b")
    if runs < 1:
        raise InvalidValueError("runs", runs, ">= 1")
    if name == "a":
        sets = [(law, law, starts_of("a"), runs) for law in LAWS]
    else:
        sets = [(f"heading {one:.0f} deg", "law 17", starts_of("b", one), 8 * runs) for one in HEADINGS_B]
    return [
        _group(label, law, setting, starts, count, seed) for setting in SETTINGS for label, law, starts, count in sets
    ]


def _group(label: str, law: str, setting: Setting, starts: Starts, runs: int, seed: int) -> Group:
    case, given = case_of(law, setting), (starts, seed, 0, runs)
    outcomes, histories = run_batch(case, *given, law=PaperLaw), run_histories(case, *given, law=PaperLaw)
    return Group(label, law, setting, starts, outcomes, histories)


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
        "distance_at_10_s": quantiles(np.hypot(*group.histories[:, _TEN_SECONDS, :2].T), QUANTILES),
    }
    if len(group.starts.poses) == 1 and group.setting.name != "quiet":
        summary["paper"] = _rank_of_paper_run(group.law, column)
    return summary


def _rank_of_paper_run(law: str, column: dict[str, Array]) -> dict[str, dict[str, Any]]:
    """Return where each coordinate of the paper's end state lies in the distribution of our end states."""
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
    """Return final errors of simulation B with law 17, for our sign and for the printed sign in the rear sector."""
    results = {}
    for setting in SETTINGS:
        for literal in (False, True):
            case = case_of("law 17", setting, literal)
            both = [run_batch(case, starts_of("b", heading), seed, 0, 8 * runs, law=PaperLaw) for heading in HEADINGS_B]
            ends = np.concatenate(both)
            results[f"{setting.name} {'as printed' if literal else 'our reading'}"] = {
                "position": quantiles(np.hypot(ends[:, 0], ends[:, 1]), QUANTILES),
                "abs_theta": quantiles(np.abs(ends[:, 2]), QUANTILES),
            }
    return results


def run_and_report(names: tuple[str, ...], runs: int, seed: int, folder: Path) -> int:
    """Run the named experiments (``a``, ``b``), write results.json and figures to ``folder``, and print tables.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    # Matplotlib takes long to load.
    from diffbot_lab.paper.figures import draw_figures  # noqa: PLC0415

    with output_folder(folder):
        for name in names:
            target = folder / name
            target.mkdir(exist_ok=True)
            groups = run_experiment(name, runs, seed)
            results = summarise(name, runs, seed, groups)
            write_json(target / "results.json", results)
            print(f"{heading()}\n{table(results)}")
            draw_figures(groups, target)
    print(f"Results and figures in {folder}")
    return 0


def heading() -> str:
    """Return a line for each law and each setting, with the values that are not the defaults of the nodes."""
    lines = [f"{law}: preset paper; {changes(controller_of(law, EPS_P))}" for law in LAWS]
    for one in SETTINGS:
        lines.append(described(f"{one.name}: feedback {one.feedback}", plant=one.plant, sensors=one.sensors))
    return "\n".join([*lines, f"filter of the setting ekf: {changes(TEXTBOOK_FILTER)}"])


def table(results: dict[str, Any]) -> str:
    """Return a table of the end states of an experiment for a terminal."""
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
