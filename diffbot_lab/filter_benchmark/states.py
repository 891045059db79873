"""What an estimated error costs where there is none, and gains where there is one: ``diffbot benchmark states``.

The filter of the node, with and without the states, on the same random drives of the simulated robot.
"""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from diffbot_control.filter.landmark_calibration import NO_ERRORS, LandmarkErrors
from diffbot_control.filter.landmark_map import LandmarkMap
from diffbot_control.filter.options import EKF, FilterConfig
from diffbot_core.errors import InvalidValueError
from diffbot_core.files import output_folder, write_json
from diffbot_lab.filter_benchmark.peer import Errors, errors_of, interval_of, ratio_of
from diffbot_lab.filter_benchmark.peer_drives import GYRO, RATE, PeerCase, record_drive
from diffbot_lab.filter_benchmark.peer_filters import run_ours
from diffbot_lab.targets import markdown_table, number
from diffbot_sim.model.actuators import ActuatorConfig
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig

Results = dict[str, Any]

DURATION, SKIPPED = 60.0, 10.0
"""[s] of a drive, and at its start what does not count."""
_FIXES = SensorConfig(fix_rate=1.0)
_LANDMARKS = _FIXES._replace(landmark_rate=5.0, landmark_range=100.0)
_TWO = LandmarkMap((1, 2), (-5.0, 5.0), (5.0, 5.0))
_FIVE = LandmarkMap((1, 2, 3, 4, 5), (-5.0, 5.0, 0.0, 12.0, 25.0), (5.0, 5.0, -8.0, 0.0, -10.0))
_RIGHT = "nothing"


class Option(NamedTuple):
    """States that are judged, and the drives that they are judged on."""

    name: str
    with_states: FilterConfig
    without: FilterConfig
    cases: tuple[PeerCase, ...]


def _seen(name: str, landmarks: LandmarkMap, errors: LandmarkErrors = NO_ERRORS) -> PeerCase:
    text = f"{name}; {len(landmarks.landmark_ids)} landmarks"
    return PeerCase(name, text, _LANDMARKS, landmarks=landmarks, landmark_errors=errors)


def _driven(name: str, plant: PlantConfig, sensors: SensorConfig = _FIXES) -> PeerCase:
    return PeerCase(name, name, sensors, plant)


OPTIONS = (
    Option(
        "errors of the radii (`ekf_calibrating` beside `ekf`)",
        FilterConfig(),
        FilterConfig(filter=EKF),
        (_driven(_RIGHT, PlantConfig()), _driven("left radius 2 %", PlantConfig(left_radius_error=0.02))),
    ),
    Option(
        "error of the separation (`wheel_separation_sigma`)",
        FilterConfig(),
        FilterConfig(wheel_separation_sigma=0.0),
        (
            _driven(_RIGHT, PlantConfig()),
            _driven("separation 3 %", PlantConfig(actuators=ActuatorConfig(separation_error=0.03))),
        ),
    ),
    Option(
        "errors of the landmarks' sensor (`landmark_*_sigma`)",
        FilterConfig(),
        FilterConfig(
            landmark_range_offset_sigma=0.0, landmark_range_scale_sigma=0.0, landmark_bearing_offset_sigma=0.0
        ),
        (
            _seen(_RIGHT, _TWO),
            _seen(_RIGHT, _FIVE),
            _seen("ranges 0.1 m too long", _TWO, LandmarkErrors(0.1, 0.0, 0.0)),
            _seen("ranges 2 % too long", _TWO, LandmarkErrors(0.0, 0.02, 0.0)),
            _seen("bearings 0.02 rad off", _TWO, LandmarkErrors(0.0, 0.0, 0.02)),
        ),
    ),
    Option(
        "a gyro with its bias (`use_gyro`)",
        FilterConfig(use_gyro=True),
        FilterConfig(),
        (
            _driven(_RIGHT, PlantConfig(), GYRO),
            _driven(
                "5 % slip of the right wheel for 25 s",
                PlantConfig(slip_right=0.05, slip_start=20.0, slip_duration=25.0),
                GYRO,
            ),
        ),
    ),
)


def run_drive(seed: int) -> list[tuple[Errors, Errors]]:
    """Return the errors with and without the states in each case of each option."""
    found = []
    for option in OPTIONS:
        for case in option.cases:
            drive = record_drive(case, seed, DURATION)
            with_states, without = (
                errors_of(run_ours(case._replace(filter=config), drive), drive, SKIPPED)
                for config in (option.with_states, option.without)
            )
            found.append((with_states, without))
    return found


def run_benchmark(runs: int, seed: int, workers: int | None = None) -> Results:
    """Execute all runs, with a progress bar on a terminal; return the content of results.json.

    Args:
        runs: number of drives.
        seed: of the first one.
        workers: processes; None for one per core. The result does not depend on it.

    Raises:
        InvalidValueError: for fewer than two runs, which have no interval.
    """
    if runs < 2:
        raise InvalidValueError("runs", runs, ">= 2")
    with ProcessPoolExecutor(workers or os.cpu_count(), mp_context=get_context("spawn")) as pool:
        try:
            drives = pool.map(run_drive, range(seed, seed + runs))
            done = list(tqdm(drives, desc="benchmark", total=runs, unit="drive", disable=None))
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    cases = [(option.name, case.text) for option in OPTIONS for case in option.cases]
    return {
        "runs": runs,
        "seed": seed,
        "duration": DURATION,
        "skipped": SKIPPED,
        "rate": RATE,
        "cases": [
            {"option": option, "text": text, **figures_of(list(pairs))}
            for (option, text), pairs in zip(cases, zip(*done, strict=True), strict=True)
        ],
    }


def figures_of(pairs: list[tuple[Errors, Errors]]) -> Results:
    """Return the figures of one case, with and without the states, and their ratios."""
    columns = {name: list(errors) for name, errors in zip(("with", "without"), zip(*pairs, strict=True), strict=True)}
    fields = ("position", "heading", "nees")
    return {
        name: {field: interval_of([getattr(one, field) for one in errors]) for field in fields}
        for name, errors in columns.items()
    } | {
        "ratio": {
            field: ratio_of(*([getattr(one, field) for one in errors] for errors in columns.values()))
            for field in fields[:2]
        }
    }


def table(results: Results) -> str:
    """Lay the figures out."""
    rows, last = [], ""
    for one in results["cases"]:
        option, last = "" if one["option"] == last else one["option"], one["option"]
        rows.append((option, one["text"], *(_figures(one[name]) for name in ("without", "with")), *_ratios(one)))
    head = ("states", "what is wrong", "without", "with", "position, with / without", "heading, with / without")
    return "\n".join(markdown_table(head, rows))


def _figures(one: Results) -> str:
    return f"{number(one['position'][0])}; {number(one['heading'][0], 4)}; {number(one['nees'][0], 1)}"


def _ratios(one: Results) -> tuple[str, str]:
    position, heading = (one["ratio"][field] for field in ("position", "heading"))
    return _ratio(position), _ratio(heading)


def _ratio(interval: list[float]) -> str:
    mean, low, high = interval
    return f"{mean:.3f} [{low:.3f}, {high:.3f}]"


def run_and_report(runs: int, seed: int, folder: Path) -> int:
    """Run the benchmark, write results.json to ``folder``, and print the table.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    with output_folder(folder):
        results = run_benchmark(runs, seed)
        write_json(folder / "results.json", results)
        print(table(results))
    print(f"Results in {folder}")
    return 0
