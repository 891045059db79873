"""The compiled filter at a measurement: innovation, its likelihood, and the correction."""

from __future__ import annotations

import math
from typing import Any

from diffbot_control.filter.landmark_calibration import LandmarkErrors, with_landmark_errors
from diffbot_control.filter.models import (
    TURNED_VARIANCE,
    arc_correction,
    expect_landmark,
    heading_innovation,
    is_at_landmark,
    pose_innovation,
)
from diffbot_core.geometry import Point, Pose, wrap_angle
from diffbot_tools.calibration.settings import LOG_2PI, Settings, Work


def fill(work: Work, measurements: Any, k: int, s: Settings) -> int:
    """Fill innovation, Jacobian and R of measurement ``k``; return how many numbers it has, 0: not usable."""
    x, kind, values, R = work.x, measurements.kind[k], measurements.values[k], measurements.R[k]
    y, H = work.y, work.H
    H[:, :] = 0.0
    work.R[:, :] = 0.0
    if kind == 0:
        y[0] = heading_innovation(values[0], x[2])
        H[0, 2] = 1.0
        work.R[0, 0] = R[0, 0] * s.heading_factor**2
        return 1
    if kind == 2:
        y[0], y[1], y[2] = pose_innovation(Pose(values[0], values[1], values[2]), Pose(x[0], x[1], x[2]))
        for i in range(3):
            H[i, i] = 1.0
            for j in range(3):
                by_row = s.yaw_factor if i == 2 else s.xy_factor
                by_column = s.yaw_factor if j == 2 else s.xy_factor
                work.R[i, j] = R[i, j] * by_row * by_column
        return 3
    return fill_landmark(work, values, R, Point(measurements.place[k, 0], measurements.place[k, 1]), s)


def fill_landmark(work: Work, values: Any, R: Any, place: Point, s: Settings) -> int:
    """Fill range and bearing of a landmark, or one of them."""
    x, P = work.x, work.P
    pose = Pose(x[0], x[1], x[2])
    if is_at_landmark(pose, place):
        return 0
    known = expect_landmark(pose, place, P[0, 0] + P[1, 1])
    expected = with_landmark_errors(known, LandmarkErrors(x[6], x[7], x[8]))
    y, H, row = work.y, work.H, 0
    if math.isfinite(R[0, 0]):
        y[0] = values[0] - expected.range
        H[0, 0], H[0, 1] = expected.range_x, expected.range_y
        H[0, 6], H[0, 7] = 1.0, known.range
        work.R[0, 0] = R[0, 0] * s.range_factor**2 + expected.added_var_range
        row = 1
    if math.isfinite(R[1, 1]):
        y[row] = heading_innovation(values[1], expected.bearing)
        H[row, 0], H[row, 1], H[row, 2], H[row, 8] = expected.bearing_x, expected.bearing_y, -1.0, 1.0
        work.R[row, row] = R[1, 1] * s.bearing_factor**2 + expected.added_var_bearing
        row += 1
    return row


def correct(work: Work, m: int, inflation: float, gate: float, result: Any) -> None:
    """Correct with what was filled in; write the figures to ``result`` (COLUMNS,).

    Beyond the gate the gain is weighed by gate / NIS, and in the likelihood the NIS counts as
    gate (1 + ln(NIS / gate)), whose derivative is this weight.
    """
    n, P = len(work.x), work.P
    y, H, L, w, PHT = work.y, work.H, work.L, work.w, work.PHT
    for i in range(n):
        for j in range(m):
            PHT[i, j] = 0.0
            for q in range(n):
                PHT[i, j] += P[i, q] * H[j, q]
    log_det = factorise(work, m, n, 1.0, 1.0)
    whiten(work, m)
    nis = 0.0
    for i in range(m):
        nis += w[i] * w[i]
        result[3 + i], result[6 + i] = w[i], y[i]
    beyond = nis > gate
    counted = gate * (1.0 + math.log(nis / gate)) if beyond else nis
    result[0], result[1], result[9] = nis, m, gate / nis if beyond else 1.0
    result[2] = -0.5 * (m * LOG_2PI + log_det + counted) / inflation
    if inflation != 1.0 or beyond:
        factorise(work, m, n, inflation, nis / gate if beyond else 1.0)
        whiten(work, m)
    # PHT L^-T, row by row; then the gain times y is its product with w.
    for i in range(n):
        for j in range(m):
            for q in range(j):
                PHT[i, j] -= L[j, q] * PHT[i, q]
            PHT[i, j] /= L[j, j]
    apply(work, m, n)


def whiten(work: Work, m: int) -> None:
    """Put L^-1 y to ``work.w``."""
    y, L, w = work.y, work.L, work.w
    for i in range(m):
        w[i] = y[i]
        for j in range(i):
            w[i] -= L[i, j] * w[j]
        w[i] /= L[i, i]


def factorise(work: Work, m: int, n: int, inflation: float, weaker: float) -> float:
    """Put the Cholesky factor of (H P H' + inflation R) weaker to ``work.L``; return the log of the determinant."""
    H, R, L, PHT = work.H, work.R, work.L, work.PHT
    log_det = 0.0
    for i in range(m):
        for j in range(i + 1):
            value = inflation * R[i, j]
            for q in range(n):
                value += H[i, q] * PHT[q, j]
            value *= weaker
            for q in range(j):
                value -= L[i, q] * L[j, q]
            if i == j:
                L[i, i] = math.sqrt(max(value, 1e-300))
                log_det += 2.0 * math.log(L[i, i])
            else:
                L[i, j] = value / L[j, j]
    return log_det


def apply(work: Work, m: int, n: int) -> None:
    """Correct mean and covariance with the whitened gain, ``work.PHT``, and innovation ``work.w``."""
    x, P, gain, w = work.x, work.P, work.PHT, work.w
    turned = P[2, 2] > TURNED_VARIANCE
    dx, dy, turn = 0.0, 0.0, 0.0
    for q in range(m):
        dx += gain[0, q] * w[q]
        dy += gain[1, q] * w[q]
        turn += gain[2, q] * w[q]
    for i in range(n):
        for q in range(m):
            x[i] += gain[i, q] * w[q]
        for j in range(i + 1):
            for q in range(m):
                P[i, j] -= gain[i, q] * gain[j, q]
            P[j, i] = P[i, j]
    x[2] = wrap_angle(x[2])
    if turned:
        turn_along(work, dx, dy, turn)


def turn_along(work: Work, dx: float, dy: float, turn: float) -> None:
    """Turn a correction of the pose into one along an arc, see :func:`models.arc_correction`."""
    x, P, n = work.x, work.P, len(work.x)
    along_x, along_y = arc_correction(dx, dy, turn)
    x[0] += along_x - dx
    x[1] += along_y - dy
    c, s = math.cos(turn), math.sin(turn)
    for j in range(n):
        P[0, j], P[1, j] = c * P[0, j] - s * P[1, j], s * P[0, j] + c * P[1, j]
    for j in range(n):
        P[j, 0], P[j, 1] = c * P[j, 0] - s * P[j, 1], s * P[j, 0] + c * P[j, 1]
