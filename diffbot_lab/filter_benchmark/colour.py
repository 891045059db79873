"""Fixes whose errors are correlated in time: ``diffbot benchmark colour``.

Open-loop drives of the simulated robot, and on each the filter of the node: without detection, with it, and with the
correlation time given. What counts is whether the covariance is honest and whether the whiteness alarm rises.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements import FIXES, Measurement
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.filter.options import FilterConfig
from diffbot_core.errors import InvalidValueError
from diffbot_core.files import output_folder, write_json
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.units import NS_PER_S
from diffbot_lab.cases import described
from diffbot_lab.filter_benchmark.colour_report import conclusions, table
from diffbot_sim.compiled.open_loop import start_of, twist_of
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig
from diffbot_sim.model.simulator import StartPose, World, WorldConfig
from diffbot_sim.reference_loop import measurements_of

CORRELATIONS = (0.0, 0.5, 0.9, 0.98)
"""Of the errors of neighbouring fixes."""
OFF, ON, GIVEN = "off", "on", "given"
DURATION, SKIPPED = 60.0, 10.0
"""[s] of a run, and at its start what is not evaluated; an alarm counts at any time."""
ODOMETRY_RATE, FIX_RATE = 10, 5
"""[Hz]"""
_CHECK = 1.0
"""[s] between two looks at the alarm"""


class DriveStep(NamedTuple):
    """What the filter gets at one step, and where the robot is."""

    measurements: list[Measurement]
    odometry: OdometryStep
    truth: Pose


class ColourRun(NamedTuple):
    """Figures of one filter on one drive."""

    nees: float
    """mean"""
    square: float
    """[m^2] mean squared error of the position"""
    alarm: float
    """[s] of the first whiteness alarm of the fixes; nan if there was none"""


def record_drive(c: float, seed: int, run: int, duration: float = DURATION) -> list[DriveStep]:
    """Drive an arc; the errors of the fixes have the correlation ``c``, all else is as the filter expects it."""
    plant = PlantConfig(sampling_time=1.0 / ODOMETRY_RATE)
    sensors = SensorConfig(fix_rate=float(FIX_RATE), fix_noise_correlation=c)
    world = World(WorldConfig(plant, sensors, StartPose(*start_of(seed, run)), seed, run))
    command, steps = twist_of(seed, run), []
    for _ in range(round(duration * ODOMETRY_RATE) + 1):
        steps.append(DriveStep(measurements_of(world.sense()), world.odometry(), world.state.pose))
        world.advance(command)
    return steps


def options_for(mode: str, c: float) -> FilterConfig:
    """Return the default filter's options in one of the modes OFF, ON and GIVEN, the last with 0 < ``c`` < 1."""
    if mode == GIVEN:
        return FilterConfig(fix_correlation_time=-1.0 / (FIX_RATE * math.log(c)))
    return FilterConfig(detect_correlation=mode == ON)


def run_filter(drive: list[DriveStep], config: FilterConfig) -> ColourRun:
    """Run the filter over a drive."""
    localization = Localization(LocalizationConfig(filter=config))
    check = round(_CHECK * ODOMETRY_RATE)
    nees, squares, alarm = [], [], math.nan
    for number, step in enumerate(drive):
        for measurement in step.measurements:
            localization.on_measurement(measurement)
        estimate = localization.on_odometry(step.odometry)
        if math.isnan(alarm) and number % check == 0 and FIXES in localization.correlated():
            alarm = step.odometry.stamp / NS_PER_S
        if number > SKIPPED * ODOMETRY_RATE:
            x, y, theta = estimate.pose
            error = np.array((x - step.truth.x, y - step.truth.y, wrap_angle(theta - step.truth.theta)))
            nees.append(float(error.dot(np.linalg.solve(estimate.P, error))))
            squares.append(error.item(0) ** 2 + error.item(1) ** 2)
    return ColourRun(float(np.mean(nees)), float(np.mean(squares)), alarm)


def modes_of(c: float) -> tuple[str, ...]:
    """Return the modes of the filter that are compared at a correlation; white fixes have no time to give."""
    return (OFF, ON) if c == 0.0 else (OFF, ON, GIVEN)


def run_drive(seed: int, run: int) -> list[ColourRun]:
    """Run one drive at each correlation in each of its modes, in the order of :func:`cells`."""
    found = []
    for c in CORRELATIONS:
        drive = record_drive(c, seed, run)
        found += [run_filter(drive, options_for(mode, c)) for mode in modes_of(c)]
    return found


def cells() -> list[tuple[float, str]]:
    """List correlations and modes."""
    return [(c, mode) for c in CORRELATIONS for mode in modes_of(c)]


def run_benchmark(runs: int, seed: int, workers: int | None = None) -> dict[str, Any]:
    """Execute all runs, with a progress bar on a terminal; return the content of results.json.

    Args:
        runs: number of drives.
        seed: of all noise.
        workers: processes; None for one per core. The result does not depend on it.

    Raises:
        InvalidValueError: for fewer than one run.
    """
    if runs < 1:
        raise InvalidValueError("runs", runs, ">= 1")
    with ProcessPoolExecutor(workers or os.cpu_count(), mp_context=get_context("spawn")) as pool:
        try:
            results = pool.map(run_drive, [seed] * runs, range(runs))
            done = list(tqdm(results, desc="benchmark", total=runs, unit="drive", disable=None))
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    columns = zip(*done, strict=True)
    found: dict[str, Any] = {
        "runs": runs,
        "seed": seed,
        "duration": DURATION,
        "skipped": SKIPPED,
        "odometry_rate": ODOMETRY_RATE,
        "fix_rate": FIX_RATE,
        "filter": FilterConfig().filter,
        "cells": [figures_of(c, mode, list(one)) for (c, mode), one in zip(cells(), columns, strict=True)],
    }
    return found | conclusions(found)


def figures_of(c: float, mode: str, found: list[ColourRun]) -> dict[str, Any]:
    """Return the figures of one correlation and mode."""
    times = [one.alarm for one in found if not math.isnan(one.alarm)]
    return {
        "c": c,
        "mode": mode,
        "runs": len(found),
        "nees": float(np.mean([one.nees for one in found])),
        "rmse": math.sqrt(float(np.mean([one.square for one in found]))),
        "alarms": len(times),
        "alarm_median": float(np.median(times)) if times else None,
    }


def run_and_report(runs: int, seed: int, folder: Path) -> int:
    """Run the benchmark, write results.json to ``folder``, and print the table.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    with output_folder(folder):
        results = run_benchmark(runs, seed)
        write_json(folder / "results.json", results)
        for mode in (OFF, ON, GIVEN):
            print(described(mode, filter=options_for(mode, CORRELATIONS[1])))
        print(f"given: for a correlation of {CORRELATIONS[1]:g}; odometry {ODOMETRY_RATE} Hz, fixes {FIX_RATE} Hz")
        print(table(results))
    print(f"Results in {folder}")
    return 0
