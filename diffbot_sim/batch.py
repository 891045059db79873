"""Simulate many closed loops, compiled from the functions that the nodes call.

The noise of a run depends only on its seed and its number. The results are therefore equal to the bit for any chunks,
order and number of workers.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.law.law import Law
from diffbot_control.law.switching import SwitchingLaw
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_sim.config import SensorConfig
from diffbot_sim.fusion import SimulatedRobot, borrowed, new_buffers, reference_to
from diffbot_sim.jit import compile_kernel, law_version
from diffbot_sim.noise import NoiseSource, uniform
from diffbot_sim.outcome import Outcome
from diffbot_sim.robot_step import FEEDBACKS, HISTORY_COLUMNS, TRUTH, Case, check_robot, make_loop
from diffbot_sim.sensors import purposes_of

_log = logging.getLogger(__name__)

Array = NDArray[np.float64]

COLUMNS = Outcome._fields
_CHUNK, _HISTORY_CHUNK = 128, 16
"""Runs in one call of the kernel, without and with histories."""


class Starts(NamedTuple):
    """Start poses in map. Run i starts at a random pose in the box around row i modulo n."""

    poses: Array
    """(n, 3) rows x, y, theta"""
    half: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """half widths of the box [m, m, rad]"""


def check_case(case: Case, starts: Starts) -> None:
    """Check a case and its starts.

    Raises:
        InvalidValueError: for a robot that :func:`check_robot` refuses, less than one step, or no start.
    """
    check_robot(case.robot, case.history_length)
    if case.steps < 1:
        raise InvalidValueError("steps", case.steps, ">= 1")
    if starts.poses.ndim != 2 or starts.poses.shape[1:] != (3,) or len(starts.poses) == 0:
        raise InvalidValueError("starts", starts.poses.shape, "(n, 3) with n >= 1")


def _make_fill(law: type[Law], feedback: int) -> Callable[..., None]:
    """Return the function that simulates some runs under a law; ``feedback`` is an index of FEEDBACKS."""
    run_loop = make_loop(law, feedback)

    def fill(case: Case, buffers: Any, begins: Any, noise: Any, outcomes: Any, histories: Any) -> None:
        shared, numbers, rows = reference_to(buffers), borrowed(noise), borrowed(histories)
        robot = SimulatedRobot(case.robot.plant, case.robot.sensors, case.robot.filter, borrowed(case.robot.landmarks))
        own = Case(robot, *case[1:])
        for index in range(len(outcomes)):
            begin = Pose(begins[index, 0], begins[index, 1], begins[index, 2])
            outcome, row = run_loop(own, shared, numbers[index], begin, rows[index]), outcomes[index]
            for column, value in enumerate(outcome):
                row[column] = value

    # Numba cannot tell cached functions of the same name and types apart, so each needs its own name.
    fill.__qualname__ = f"fill_{law.name}_{FEEDBACKS[feedback]}"
    return fill


_kernels: dict[tuple[type[Law], int], Any] = {}
"""Kernels by law and feedback: compiled, or plain Python for laws that numba cannot compile."""
_kernels_lock = Lock()


def _kernel(law: type[Law], feedback: int, example: tuple[Any, ...]) -> Any:
    """Return the kernel of a law and a feedback, compiled for the types of ``example``.

    ``example`` contains arguments for zero runs. If numba cannot compile the kernel, log the reason once and return the
    plain Python function.
    """
    with _kernels_lock:
        kernel = _kernels.get((law, feedback))
        if kernel is None:
            kernel = compile_kernel(_make_fill(law, feedback), law_version(law))
        if hasattr(kernel, "py_func") and tuple(map(kernel.typeof_pyval, example)) not in kernel.overloads:
            try:
                kernel(*example)  # compiles the kernel, which then simulates zero runs
            except Exception as error:  # numba's errors do not share a base class
                kernel, reason = kernel.py_func, _first_line(error)
                _log.warning("law %s runs as plain Python, since numba cannot compile it: %s", law.name, reason)
        _kernels[law, feedback] = kernel
        return kernel


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return next((line for line in lines if not line.startswith(("Failed in", "-"))), type(error).__name__)


def run_batch(
    case: Case,
    starts: Starts,
    seed: int,
    first: int,
    count: int,
    threads: int | None = None,
    law: type[Law] = SwitchingLaw,
) -> Array:
    """Simulate the runs ``first`` to ``first + count - 1``.

    Args:
        case: robot, controller, goal and duration of all runs.
        starts: start poses.
        seed: seed of all noise.
        first: number of the first run.
        count: number of runs.
        threads: number of threads; None for one on each core.
        law: the law; ``case.controller`` is an instance of its Config.

    Returns:
        Outcomes (count, 12), a row for each run, columns as COLUMNS.

    Raises:
        InvalidValueError: see :func:`check_case`.
    """
    return _simulate(law, case, starts, seed, range(first, first + count), threads, with_histories=False)[0]


def run_histories(
    case: Case,
    starts: Starts,
    seed: int,
    first: int,
    count: int,
    threads: int | None = None,
    law: type[Law] = SwitchingLaw,
) -> Array:
    """Simulate runs as :func:`run_batch` does, and return their histories.

    Returns:
        Histories (count, steps + 1, 12), columns as robot_step.HISTORY_COLUMNS.
    """
    return _simulate(law, case, starts, seed, range(first, first + count), threads, with_histories=True)[1]


def _simulate(
    law: type[Law], case: Case, starts: Starts, seed: int, runs: range, threads: int | None, *, with_histories: bool
) -> tuple[Array, Array]:
    """Return outcomes and histories. The histories are empty without ``with_histories``."""
    check_case(case, starts)
    outcomes: Array = np.empty((len(runs), len(COLUMNS)))
    histories: Array = np.empty((len(runs), case.steps + 1 if with_histories else 0, len(HISTORY_COLUMNS)))
    sensors = SensorConfig(fix_rate=0.0) if case.feedback == FEEDBACKS.index(TRUTH) else case.robot.sensors
    purposes = purposes_of(sensors, len(case.robot.landmarks), case.robot.plant.slip_noise)
    none = np.empty((0, 3)), np.empty((0, 1, 1, 4))
    kernel = _kernel(law, case.feedback, (case, new_buffers(case.robot), *none, outcomes[:0], histories[:0]))

    size = max(min(_HISTORY_CHUNK if with_histories else _CHUNK, len(runs)), 1)

    def simulate_chunks(chunks: list[range]) -> None:
        source, buffers = NoiseSource(), new_buffers(case.robot)
        noise = np.empty((size, max(purposes) + 1, case.steps + 1, 4))
        for chunk in chunks:
            for index, run in enumerate(chunk):
                source.rows(seed, run, 0, noise[index], purposes)
            begins = np.array([start_pose(source, starts, seed, run) for run in chunk])
            rows = slice(chunk.start - runs.start, chunk.stop - runs.start)
            kernel(case, buffers, begins, noise, outcomes[rows], histories[rows])

    in_threads(simulate_chunks, [runs[at : at + size] for at in range(0, len(runs), size)], threads)
    return outcomes, histories


def start_pose(source: NoiseSource, starts: Starts, seed: int, run: int) -> Pose:
    """Return the start pose of a run."""
    row, half = starts.poses[run % len(starts.poses)], starts.half
    if half == (0.0, 0.0, 0.0):
        return Pose(*row.tolist())
    x, y, theta = (
        value + uniform(u, bound) for value, u, bound in zip(row, source.start(seed, run), half, strict=False)
    )
    return Pose(float(x), float(y), wrap_angle(float(theta)))


def in_threads(work: Callable[[list[range]], None], chunks: list[range], threads: int | None) -> None:
    """Distribute chunks of runs over threads. Each thread calls ``work`` once with its chunks.

    Args:
        work: simulates some chunks.
        chunks: run numbers.
        threads: number of threads; None for one on each core.
    """
    workers = min(threads or os.cpu_count() or 1, len(chunks))
    with ThreadPoolExecutor(max(workers, 1)) as pool:
        for future in [pool.submit(work, chunks[worker::workers]) for worker in range(workers)]:
            future.result()
