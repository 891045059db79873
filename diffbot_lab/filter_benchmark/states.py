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
from diffbot_lab.cases import described
from diffbot_lab.filter_benchmark.peer import Errors, errors_of, interval_of, ratio_of
from diffbot_lab.filter_benchmark.peer_drives import GYRO, RATE, PeerCase, record_drive
from diffbot_lab.filter_benchmark.peer_filters import run_ours
from diffbot_lab.filter_benchmark.peer_report import errors_text, ratio_text
from diffbot_lab.targets import markdown_table
from diffbot_sim.model.actuators import ActuatorConfig
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig

Results = dict[str, Any]

DURATION, SKIPPED = 60.0, 10.0
"""[s] of a drive, and at its start what does not count."""
_FIXES = SensorConfig(fix_rate=1.0)
_SEEN = _FIXES._replace(landmark_rate=5.0, landmark_range=100.0)
_TWO = LandmarkMap((1, 2), (-5.0, 5.0), (5.0, 5.0))
_FIVE = LandmarkMap((1, 2, 3, 4, 5), (-5.0, 5.0, 0.0, 12.0, 25.0), (5.0, 5.0, -8.0, 0.0, -10.0))
_RIGHT = PlantConfig()
_SLIP = PlantConfig(slip_right=0.05, slip_start=20.0, slip_duration=25.0)
_WIDER = PlantConfig(actuators=ActuatorConfig(separation_error=0.03))
_CERTAIN = FilterConfig(
    landmark_range_offset_sigma=0.0, landmark_range_scale_sigma=0.0, landmark_bearing_offset_sigma=0.0
)


def _case(text: str, plant: PlantConfig = _RIGHT, sensors: SensorConfig = _FIXES) -> PeerCase:
    return PeerCase(text, text, sensors, plant)


def _seen(text: str, landmarks: LandmarkMap, errors: LandmarkErrors = NO_ERRORS) -> PeerCase:
    return _case(text, sensors=_SEEN)._replace(landmarks=landmarks, landmark_errors=errors)


class Option(NamedTuple):
    """States that are judged, and the drives that they are judged on."""

    name: str
    with_states: FilterConfig
    without: FilterConfig
    cases: tuple[PeerCase, ...]


OPTIONS = (
    Option(
        "errors of the radii (`ekf_calibrating` beside `ekf`)",
        FilterConfig(),
        FilterConfig(filter=EKF),
        (_case("nothing"), _case("left radius 2 %", PlantConfig(left_radius_error=0.02))),
    ),
    Option(
        "error of the separation (`wheel_separation_sigma`)",
        FilterConfig(),
        FilterConfig(wheel_separation_sigma=0.0),
        (_case("nothing"), _case("separation 3 %", _WIDER)),
    ),
    Option(
        "errors of the landmarks' sensor (`landmark_*_sigma`)",
        FilterConfig(),
        _CERTAIN,
        (
            _seen("nothing; 2 landmarks", _TWO),
            _seen("nothing; 5 landmarks", _FIVE),
            _seen("ranges 0.1 m too long; 2 landmarks", _TWO, LandmarkErrors(0.1, 0.0, 0.0)),
            _seen("ranges 2 % too long; 2 landmarks", _TWO, LandmarkErrors(0.0, 0.02, 0.0)),
            _seen("bearings 0.02 rad off; 2 landmarks", _TWO, LandmarkErrors(0.0, 0.0, 0.02)),
        ),
    ),
    Option(
        "a gyro with its bias (`use_gyro`)",
        FilterConfig(use_gyro=True),
        FilterConfig(),
        (_case("nothing", sensors=GYRO), _case("5 % slip of the right wheel for 25 s", _SLIP, GYRO)),
    ),
)


def run_drive(seed: int) -> list[list[Errors]]:
    """Return the errors with the states, and without, in each case of each option."""
    found = []
    for option in OPTIONS:
        for case in option.cases:
            drive, configs = record_drive(case, seed, DURATION), (option.with_states, option.without)
            runs = [run_ours(case._replace(filter=config), drive) for config in configs]
            found.append([errors_of(run, drive, SKIPPED) for run in runs])
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


def figures_of(pairs: list[list[Errors]]) -> Results:
    """Return the figures of one case from those with the states and without, and their ratios."""
    found: Results = {"ratio": {}}
    for field in ("position", "heading", "nees"):
        with_states, without = ([getattr(one, field) for one in errors] for errors in zip(*pairs, strict=True))
        found.setdefault("with", {})[field] = interval_of(with_states)
        found.setdefault("without", {})[field] = interval_of(without)
        found["ratio"][field] = ratio_of(with_states, without)
    return found


def table(results: Results) -> str:
    """Lay the figures out."""
    rows = [
        (
            *(one["option"], one["text"], errors_text(one["without"]), errors_text(one["with"])),
            *(ratio_text(one["ratio"][name]) for name in ("position", "heading")),
        )
        for one in results["cases"]
    ]
    head = ("states", "what is wrong", "without", "with", "position, with / without", "heading, with / without")
    return "\n".join(markdown_table(head, rows))


def run_and_report(runs: int, seed: int, folder: Path) -> int:
    """Run the benchmark, write results.json to ``folder``, and print the table.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    with output_folder(folder):
        results = run_benchmark(runs, seed)
        write_json(folder / "results.json", results)
        for one in OPTIONS:
            print(described(one.name, **{"with: filter": one.with_states, "without: filter": one.without}))
        print(table(results))
    print(f"Results in {folder}")
    return 0
