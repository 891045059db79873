"""The filter over the arrays of a drive, to be compiled: models are the functions of the filter, the algebra is here.

States: x, y, theta, relative errors of the left and right radius and of the wheel separation, offset [m] and scale of
the landmark ranges, offset [rad] of the bearings; and, if the errors of fixes are modelled as correlated in time, their
present error (x, y, theta). Arrays are changed in place: this is the inner loop of an optimisation.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from diffbot_control.filter.correlation import inflation_after
from diffbot_core.geometry import wrap_angle
from diffbot_tools.calibration.measurement_update import correct, fill
from diffbot_tools.calibration.motion_update import advance
from diffbot_tools.calibration.settings import NEVER, Settings, Work


def new_work(x: Any, P: Any) -> Work:
    """Return the arrays for a belief."""
    n = len(x)
    return Work(
        x,
        P,
        np.zeros((3, n)),
        np.zeros((3, n)),
        np.zeros((n, 3)),
        np.zeros(3),
        np.zeros((3, 3)),
        np.zeros((3, 3)),
        np.zeros(3),
    )


def run_filter(
    odometry: Any, measurements: Any, starts_from_fix: bool, x: Any, P: Any, result: Any, s: Settings
) -> None:
    """Filter a drive.

    Args:
        odometry: see :class:`events.Odometry`.
        measurements: see :class:`events.Measurements`; the first is a reset.
        starts_from_fix: its error may be correlated with those of the next fixes.
        x: (n,) mean of the states before the first reset; becomes that at the end.
        P: (n, n) likewise.
        result: (k, COLUMNS) becomes the figures of each measurement; a reset, or a landmark where the robot stands, has
            zero numbers.
        s: of the filter.
    """
    work, n = new_work(x, P), len(x)
    last = np.full(len(measurements.time) + 1, NEVER)
    now, index = 0.0, 0
    for k in range(len(measurements.time)):
        time, kind, source = measurements.time[k], measurements.kind[k], measurements.source[k]
        now, index = advance(work, odometry, now, index, time, s)
        if kind == 3:
            reset(x, P, measurements.values[k], measurements.R[k], n)
            if starts_from_fix and k == 0:
                last[source] = time
                if s.fix_bias:
                    start_bias(P, measurements.R[k])
            continue
        m = fill(work, measurements, k, s)
        inflation = 1.0
        if kind == 2 and s.fix_bias:
            gap = time - last[source] if last[source] >= 0.0 else math.inf
            remember(work, math.exp(-gap / s.times[2]))
        elif m > 0 and s.times[kind] > 0.0 and last[source] >= 0.0:
            inflation = inflation_after(time - last[source], s.times[kind])
        last[source] = time
        if m > 0:
            correct(work, m, inflation, s.gates[m - 1], result[k])


def reset(x: Any, P: Any, pose: Any, R: Any, n: int) -> None:
    """Put the pose at ``pose`` (3,) with covariance ``R`` (3, 3), uncorrelated with the other states, which stay."""
    for i in range(3):
        x[i] = pose[i]
        for j in range(n):
            P[i, j] = P[j, i] = 0.0
    x[2] = wrap_angle(x[2])
    for i in range(3):
        for j in range(3):
            P[i, j] = R[i, j]


def start_bias(P: Any, R: Any) -> None:
    """Give the error of the fix that the pose was put at to the states of the fixes' error."""
    for i in range(3):
        for j in range(3):
            P[9 + i, 9 + j] = R[i, j]
            P[i, 9 + j] = P[9 + j, i] = -R[i, j]


def remember(work: Work, c: float) -> None:
    """Let the error of the fixes decay to ``c`` of itself; all of R in ``work`` is its variance, none is left there."""
    x, P = work.x, work.P
    n = len(x)
    for i in range(9, 12):
        x[i] *= c
        for j in range(n):
            P[i, j] *= c
        for j in range(n):
            P[j, i] *= c
    for i in range(3):
        for j in range(3):
            P[9 + i, 9 + j] += (1.0 - c * c) * work.R[i, j]
            work.R[i, j] = 0.0
        work.H[i, 9 + i] = 1.0
    # The innovation was taken without the error; an angle is not wrapped again, since errors are small.
    for i in range(3):
        work.y[i] -= x[9 + i]
