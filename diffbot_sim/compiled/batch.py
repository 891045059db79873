"""Many closed loops, compiled from the functions that the nodes call.

A run is named by (seed, run) and depends on nothing else, so results are the same to the bit in any chunking, order and
number of workers.
"""

from __future__ import annotations

import logging
import os
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.goals.protocol import Law
from diffbot_control.law.controller import SwitchingLaw
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_sim.compiled.closed_loop import EKF, RAW, TRUTH, Case, buffers_for, make_loop, prepared, robot_of
from diffbot_sim.compiled.gated_filter import check_supported
from diffbot_sim.compiled.jit import compile_kernel, make_callable, make_law_callable, one_compiler
from diffbot_sim.compiled.sensing import Robot
from diffbot_sim.model.outcome import Outcome
from diffbot_sim.model.philox import START_BLOCK, draw
from diffbot_sim.model.sensors import check_detector

_log = logging.getLogger(__name__)

Array = NDArray[np.float64]

FEEDBACK_CODES = {"truth": TRUTH, "raw": RAW, "ekf": EKF}
"""Codes of reference_loop.FEEDBACKS in the compiled loop."""
COLUMNS = Outcome._fields
HISTORY_COLUMNS = ("x", "y", "theta", "seen_x", "seen_y", "seen_theta", "v", "omega", "sigma", "sigma_theta")
"""True pose, pose given to the controller (seen_*), command, standard deviations of position [m] and heading [rad] that
were given with that pose: 0 for a feedback without them."""
_CHUNK, _LONG_CHUNK = 512, 16
"""Runs that a thread takes at a time, without and with histories."""


class Starts(NamedTuple):
    """Where runs begin, in map: run i starts at a random pose in the box about row i modulo the number of rows."""

    poses: Array
    """(n, 3) rows x, y, theta"""
    half: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """half widths of the box [m, m, rad]"""


def check_robot(robot: Robot, history_length: float) -> None:
    """Refuse what the compiled filter does not support; ``history_length`` [s] is how late a measurement may come.

    Raises:
        InvalidValueError: for measurements later than the history; for options of the filter that it does not have or
            that cannot act; see :func:`check_detector`.
    """
    check_supported(robot.filter)
    sensors = robot.sensors
    check_detector(sensors)
    if robot.filter.gyro_bias_variance > 0.0 and sensors.gyro_rate == 0.0:
        raise InvalidValueError("use_gyro", True, "false while gyro_rate is 0")
    for name, delay in (
        (
            "fix_delay + fix_delay_jitter" if sensors.fix_delay_jitter > 0.0 else "fix_delay",
            sensors.fix_delay + sensors.fix_delay_jitter,
        ),
        ("heading_delay", sensors.heading_delay),
        ("detection_delay", sensors.detector.detection_delay if sensors.detector.detection_rate > 0.0 else 0.0),
    ):
        if delay > history_length:
            raise InvalidValueError(name, delay, f"<= {history_length:g} s, the length of the filter's history")


def check_case(case: Case, starts: Starts) -> None:
    """Refuse what the compiled loop does not support.

    Raises:
        InvalidValueError: as :func:`check_robot`; for less than one step; for no start.
    """
    check_robot(robot_of(case), case.history_length)
    if case.steps < 1:
        raise InvalidValueError("steps", case.steps, ">= 1")
    if starts.poses.ndim != 2 or starts.poses.shape[1:] != (3,) or len(starts.poses) == 0:
        raise InvalidValueError("starts", starts.poses.shape, "(n, 3) with n >= 1")


def _start_pose(poses: Any, half: tuple[float, float, float], seed: int, run: int) -> Pose:
    row = poses[run % len(poses)]
    noise = draw(seed, run, 0, START_BLOCK)
    return Pose(row[0] + half[0] * noise.a, row[1] + half[1] * noise.b, wrap_angle(row[2] + half[2] * noise.c))


make_callable(_start_pose)


def _make_fill(law: Law) -> Any:
    """Return the function that fills outcomes and histories of a chunk of runs under a law."""
    run_loop = make_loop(law)
    make_callable(run_loop)

    def fill(case: Case, poses: Any, half: Any, seed: int, first: int, outcomes: Any, histories: Any) -> None:
        buffers = buffers_for(case)
        for index in range(len(outcomes)):
            run = first + index
            start = _start_pose(poses, half, seed, run)
            outcome = run_loop(case, buffers, seed, run, start, histories[index])
            _put(outcomes[index], outcome)

    return fill


def _put(row: Any, outcome: Outcome) -> None:
    row[0], row[1], row[2] = outcome.x, outcome.y, outcome.theta
    row[3], row[4], row[5] = outcome.settling_time, outcome.path_length, outcome.effort
    row[6], row[7], row[8] = outcome.switches, outcome.local_time, outcome.estimation_error
    row[9], row[10], row[11] = outcome.turning, outcome.reached_time, outcome.false_reached


make_callable(_put)


class _Kernels:
    """Compiled kernels by law, and the plain ones of laws that do not compile."""

    def __init__(self) -> None:
        self._kernels: dict[int, tuple[Law, str, Any]] = {}
        self._lock = Lock()

    def newest(self, law: Law) -> Any:
        """Return the kernel of a law, made but perhaps not compiled yet."""
        if id(law) not in self._kernels:
            version = make_law_callable(law)
            self._kernels[id(law)] = law, version, compile_kernel(_make_fill(law), version)
        return self._kernels[id(law)][2]

    def kernel(self, law: Law, example: tuple[Any, ...]) -> Any:
        """Return the kernel of a law, compiled for arguments like those of ``example``.

        If numba cannot compile it, the kernel is plain Python, which is logged once.
        """
        with self._lock:
            kernel = self.newest(law)
            if not hasattr(kernel, "py_func") or tuple(map(kernel.typeof_pyval, example)) in kernel.overloads:
                return kernel
            *before, outcomes, histories = example
            version = self._kernels[id(law)][1]
            try:
                with one_compiler(version):
                    kernel(*before, outcomes[:0], histories[:0])  # compiles, and runs nothing
            except Exception as error:  # not all of numba's errors have a base in common
                kernel = kernel.py_func
                self._kernels[id(law)] = law, version, kernel
                _log.warning("law %s runs as plain Python, numba cannot compile it: %s", law.name, _first_line(error))
            return kernel


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return next((line for line in lines if not line.startswith(("Failed in", "-"))), type(error).__name__)


_kernels = _Kernels()


def run_batch(
    case: Case, starts: Starts, seed: int, first: int, count: int, threads: int | None = None, law: Law = SwitchingLaw
) -> Array:
    """Do the runs ``first`` to ``first + count - 1`` under ``seed``.

    Args:
        case: what all runs share.
        starts: where they begin.
        seed: of all noise.
        first: number of the first run.
        count: how many.
        threads: how many at a time; None for one on each core.
        law: that drives; ``case.controller`` is of its Config.

    Returns:
        (count, 12), a row per run, columns as COLUMNS.

    Raises:
        InvalidValueError: see :func:`check_case`.
    """
    return _filled(law, case, starts, seed, range(first, first + count), threads, with_histories=False)[0]


def run_histories(
    case: Case, starts: Starts, seed: int, first: int, count: int, threads: int | None = None, law: Law = SwitchingLaw
) -> Array:
    """Do runs as :func:`run_batch` does, and return their histories (count, steps + 1, 10), see HISTORY_COLUMNS."""
    return _filled(law, case, starts, seed, range(first, first + count), threads, with_histories=True)[1]


def _filled(
    law: Law, case: Case, starts: Starts, seed: int, runs: range, threads: int | None, *, with_histories: bool
) -> tuple[Array, Array]:
    """Return outcomes and histories; without histories these have no rows, so that one kernel serves both."""
    check_case(case, starts)
    case = prepared(case)
    count = len(runs)
    outcomes: Array = np.empty((count, len(COLUMNS)))
    histories: Array = np.empty((count, case.steps + 1 if with_histories else 0, len(HISTORY_COLUMNS)))
    chunk = _LONG_CHUNK if with_histories else _CHUNK
    parts = []
    for at in range(0, count, chunk):
        rows = slice(at, at + chunk)
        parts.append((case, starts.poses, starts.half, seed, runs.start + at, outcomes[rows], histories[rows]))
    example = (case, starts.poses, starts.half, seed, runs.start, outcomes, histories)
    in_threads(_kernels.kernel(law, example), parts, threads)
    return outcomes, histories


def in_threads(kernel: Any, parts: list[tuple[Any, ...]], threads: int | None) -> None:
    """Call the compiled ``kernel`` with each of ``parts``, in ``threads`` at a time; None for one on each core."""
    workers = min(threads or os.cpu_count() or 1, len(parts))
    if workers <= 1:
        for part in parts:
            kernel(*part)
        return
    with ThreadPoolExecutor(workers) as pool:
        for future in [pool.submit(kernel, *part) for part in parts]:
            future.result()
