"""The compiled filter between measurements: mean and covariance are moved by the odometry."""

from __future__ import annotations

from typing import Any

from diffbot_control.filter.models import (
    Arc,
    RadiusDerivatives,
    RadiusErrors,
    lateral_noise,
    motion_noise,
    move,
    radius_derivatives,
    separation_derivatives,
    with_radius_errors,
    with_separation_error,
)
from diffbot_control.filter.odometry_noise import MotionDensity, motion_density, over_time
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance, scale_twist_covariance
from diffbot_tools.calibration.settings import NANO, Settings, Work


def advance(work: Work, odometry: Any, now: float, index: int, until: float, s: Settings) -> tuple[float, int]:
    """Move from ``now`` to ``until`` [s] with the messages from ``index`` on; return both as they are then.

    Message k acts from start + delay to end + delay; the first also before, the last also after.
    """
    last = len(odometry.end) - 1
    while until - now > NANO:
        while index < last and odometry.end[index] + s.delay <= now + NANO:
            index += 1
        end = odometry.end[index] + s.delay
        if index == last or end > until:
            end = until
        if s.split:
            end = min(end, next_stamp(odometry, index, now, end))
        dt = end - now
        twist = Twist(odometry.twist[index, 0], odometry.twist[index, 1])
        row = odometry.covariance[index]
        covariance = scale_twist_covariance(TwistCovariance(row[0], row[1], row[2]), s.odometry_covariance_scale)
        lateral = 0.0
        known = row[0] != 0.0 or row[1] != 0.0 or row[2] != 0.0
        if known and s.noise == 0:
            covariance = scale_twist_covariance(covariance, (odometry.end[index] - odometry.start[index]) / dt)
        elif known and s.noise == 1:
            covariance, lateral = over_time(MotionDensity(covariance, 0.0), twist.v, dt)
        else:
            covariance, lateral = over_time(motion_density(twist, s), twist.v, dt)  # type: ignore[arg-type]
        predict(work, twist, dt, covariance, lateral, s)
        now = end
    return now, index


def next_stamp(odometry: Any, index: int, now: float, end: float) -> float:
    """Return the first stamp after ``now`` of the messages from ``index`` on, or ``end`` if there is none before."""
    for later in range(index, len(odometry.end)):
        if odometry.end[later] > now + NANO:
            return min(float(odometry.end[later]), end)
    return end


def predict(work: Work, measured: Twist, dt: float, covariance: TwistCovariance, lateral: float, s: Settings) -> None:
    """Move mean and covariance: P = F P F' + Q, of which F differs from 1 in the first three rows."""
    x, P = work.x, work.P
    twist = with_separation_error(with_radius_errors(measured, RadiusErrors(x[3], x[4]), s.separation), x[5])
    arc = move(Pose(x[0], x[1], x[2]), twist, dt)
    radii = radius_derivatives(arc, measured, dt, s.separation, 1.0 + x[5])
    x_sep, y_sep, theta_sep = separation_derivatives(arc, twist, dt, x[5])
    xx, xy, xt, yy, yt, tt = motion_noise(arc, twist.v, dt, covariance)
    add_xx, add_xy, add_yy = lateral_noise(arc, dt, lateral)
    x[0], x[1], x[2] = arc.end.x, arc.end.y, arc.end.theta
    propagate(P, work.FP, arc, radii, (x_sep, y_sep, theta_sep))
    P[0, 0] += xx + add_xx
    P[1, 1] += yy + add_yy
    P[2, 2] += tt
    P[0, 1] = P[1, 0] = P[0, 1] + xy + add_xy
    P[0, 2] = P[2, 0] = P[0, 2] + xt
    P[1, 2] = P[2, 1] = P[1, 2] + yt
    for i in range(3, 6):
        P[i, i] += s.walk * dt


def propagate(P: Any, FP: Any, arc: Arc, radii: RadiusDerivatives, by_separation: tuple[float, float, float]) -> None:
    """P = F P F' for the derivatives of a motion."""
    x_sep, y_sep, theta_sep = by_separation
    n = len(P)
    for j in range(n):
        left, right, separation = P[3, j], P[4, j], P[5, j]
        FP[0, j] = P[0, j] + arc.x_theta * P[2, j] + radii.x_left * left + radii.x_right * right + x_sep * separation
        FP[1, j] = P[1, j] + arc.y_theta * P[2, j] + radii.y_left * left + radii.y_right * right + y_sep * separation
        FP[2, j] = P[2, j] + radii.theta_left * left + radii.theta_right * right + theta_sep * separation
    for i in range(3):
        a, left, right, separation = FP[i, 2], FP[i, 3], FP[i, 4], FP[i, 5]
        P[i, 0] = FP[i, 0] + arc.x_theta * a + radii.x_left * left + radii.x_right * right + x_sep * separation
        P[i, 1] = FP[i, 1] + arc.y_theta * a + radii.y_left * left + radii.y_right * right + y_sep * separation
        P[i, 2] = a + radii.theta_left * left + radii.theta_right * right + theta_sep * separation
        for j in range(3, n):
            P[i, j] = P[j, i] = FP[i, j]
