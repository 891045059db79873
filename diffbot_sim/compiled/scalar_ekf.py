"""The Kalman filter of :mod:`diffbot_control.filter.ekf` as pure functions of floats, for compiled campaigns.

The models are the same functions; a test holds the algebra to filterpy's filter to 1e-9. One form serves both filters:
with a variance of zero the errors of the wheels are no states. Of the symmetric covariance the upper
triangle is kept.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.filter.models import (
    Arc,
    Motion,
    MotionNoise,
    RadiusDerivatives,
    RadiusErrors,
    expect_landmark,
    heading_innovation,
    is_at_landmark,
    motion_noise,
    move,
    pose_innovation,
    radius_derivatives,
    separation_derivatives,
    with_radius_errors,
    with_separation_error,
)
from diffbot_core.geometry import Point, Pose
from diffbot_sim.compiled.scalar_belief import Belief, Covariance, PoseFix, WheelErrors, turned


class Row(NamedTuple):
    """Covariance of one measured number with each state."""

    x: float
    y: float
    t: float
    l: float  # noqa: E741 - the wheel's letter
    r: float
    s: float


class LandmarkMeasurement(NamedTuple):
    """Range and bearing of a known landmark, with independent errors."""

    range: float
    """[m]"""
    bearing: float
    """[rad] in the robot's frame"""
    landmark: Point
    """its position [m]"""
    var_range: float
    """[m^2]"""
    var_bearing: float
    """[rad^2]"""


class Corrected(NamedTuple):
    """A belief after a measurement, and the NIS of the measurement."""

    belief: Belief
    nis: float
    """normalised innovation squared"""


def predict(belief: Belief, motion: Motion, separation: float, random_walks: tuple[float, float]) -> Belief:
    """Move: P = F P F' + G M G' + W.

    Args:
        belief: before.
        motion: twist from the encoders for wheels of the configured size, duration, covariance M of the twist.
        separation: configured distance of the wheels [m].
        random_walks: [1/s] random-walk variance per second of each radius error and of the separation's.
    """
    errors = belief.errors
    twist = with_radius_errors(motion.twist, RadiusErrors(errors.left, errors.right), separation)
    twist = with_separation_error(twist, errors.separation)
    arc = move(belief.pose, twist, motion.dt)
    by_radii = radius_derivatives(arc, motion.twist, motion.dt, separation, 1.0 + errors.separation)
    by_separation = separation_derivatives(arc, twist, motion.dt, errors.separation)
    noise = motion_noise(arc, twist.v, motion.dt, motion.covariance)
    walks = random_walks[0] * motion.dt, random_walks[1] * motion.dt
    return Belief(arc.end, errors, _propagate(belief.P, arc, by_radii, by_separation, noise, walks))


def _propagate(
    b: Covariance,
    arc: Arc,
    by_radii: RadiusDerivatives,
    by_separation: tuple[float, float, float],
    noise: MotionNoise,
    walks: tuple[float, float],
) -> Covariance:
    """Return F P F' + Q; ``walks`` are the variances that a radius error and the separation's gain."""
    # F adds these multiples of theta and of the errors of the wheels to x, y and theta.
    xt, yt = arc.x_theta, arc.y_theta
    xl, xr, yl, yr, tl, tr = by_radii
    xs, ys, ts = by_separation
    # First the rows of F P ...
    fxx = b.xx + xt * b.xt + xl * b.xl + xr * b.xr + xs * b.xs
    fxy = b.xy + xt * b.yt + xl * b.yl + xr * b.yr + xs * b.ys
    fxt = b.xt + xt * b.tt + xl * b.tl + xr * b.tr + xs * b.ts
    fxl = b.xl + xt * b.tl + xl * b.ll + xr * b.lr + xs * b.ls
    fxr = b.xr + xt * b.tr + xl * b.lr + xr * b.rr + xs * b.rs
    fxs = b.xs + xt * b.ts + xl * b.ls + xr * b.rs + xs * b.ss
    fyy = b.yy + yt * b.yt + yl * b.yl + yr * b.yr + ys * b.ys
    fyt = b.yt + yt * b.tt + yl * b.tl + yr * b.tr + ys * b.ts
    fyl = b.yl + yt * b.tl + yl * b.ll + yr * b.lr + ys * b.ls
    fyr = b.yr + yt * b.tr + yl * b.lr + yr * b.rr + ys * b.rs
    fys = b.ys + yt * b.ts + yl * b.ls + yr * b.rs + ys * b.ss
    ftt = b.tt + tl * b.tl + tr * b.tr + ts * b.ts
    ftl = b.tl + tl * b.ll + tr * b.lr + ts * b.ls
    ftr = b.tr + tl * b.lr + tr * b.rr + ts * b.rs
    fts = b.ts + tl * b.ls + tr * b.rs + ts * b.ss
    # ... then their products with F', and the noise.
    q_xx, q_xy, q_xt, q_yy, q_yt, q_tt = noise
    return Covariance(
        fxx + xt * fxt + xl * fxl + xr * fxr + xs * fxs + q_xx,
        fxy + yt * fxt + yl * fxl + yr * fxr + ys * fxs + q_xy,
        fxt + tl * fxl + tr * fxr + ts * fxs + q_xt,
        fxl,
        fxr,
        fxs,
        fyy + yt * fyt + yl * fyl + yr * fyr + ys * fys + q_yy,
        fyt + tl * fyl + tr * fyr + ts * fys + q_yt,
        fyl,
        fyr,
        fys,
        ftt + tl * ftl + tr * ftr + ts * fts + q_tt,
        ftl,
        ftr,
        fts,
        b.ll + walks[0],
        b.lr,
        b.ls,
        b.rr + walks[0],
        b.rs,
        b.ss + walks[1],
    )


class Jacobian(NamedTuple):
    """Derivatives of one measured number by the pose; no measurement depends on the errors of the wheels."""

    x: float
    y: float
    t: float


def product(P: Covariance, h: Jacobian) -> Row:
    """Return P h'."""
    return Row(
        P.xx * h.x + P.xy * h.y + P.xt * h.t,
        P.xy * h.x + P.yy * h.y + P.yt * h.t,
        P.xt * h.x + P.yt * h.y + P.tt * h.t,
        P.xl * h.x + P.yl * h.y + P.tl * h.t,
        P.xr * h.x + P.yr * h.y + P.tr * h.t,
        P.xs * h.x + P.ys * h.y + P.ts * h.t,
    )


def correct(belief: Belief, before: Belief, h: Jacobian, residual: float, variance: float) -> Corrected:
    """Correct with one number of a measurement: K = P h' / s, P = P - K s K'.

    For numbers with independent errors, sequential corrections equal the joint one.

    Args:
        belief: after the preceding numbers of the measurement.
        before: before its first number, where residuals and derivatives are taken.
        h: derivatives of the number by the pose.
        residual: measured minus expected at ``before``.
        variance: of the error.

    Returns:
        The belief, its heading not wrapped, and the number's share of the NIS.
    """
    p = product(belief.P, h)
    s = h.x * p.x + h.y * p.y + h.t * p.t + variance
    x, y, theta = belief.pose
    residual -= h.x * (x - before.pose.x) + h.y * (y - before.pose.y) + h.t * (theta - before.pose.theta)
    gain = residual / s
    left, right, separation = belief.errors
    pose = Pose(x + p.x * gain, y + p.y * gain, theta + p.t * gain)
    errors = WheelErrors(left + p.l * gain, right + p.r * gain, separation + p.s * gain)
    return Corrected(Belief(pose, errors, _reduce(belief.P, p, s)), residual * gain)


def _reduce(b: Covariance, p: Row, s: float) -> Covariance:
    """Return P - p p' / s, with p = P h'."""
    return Covariance(
        b.xx - p.x * p.x / s,
        b.xy - p.x * p.y / s,
        b.xt - p.x * p.t / s,
        b.xl - p.x * p.l / s,
        b.xr - p.x * p.r / s,
        b.xs - p.x * p.s / s,
        b.yy - p.y * p.y / s,
        b.yt - p.y * p.t / s,
        b.yl - p.y * p.l / s,
        b.yr - p.y * p.r / s,
        b.ys - p.y * p.s / s,
        b.tt - p.t * p.t / s,
        b.tl - p.t * p.l / s,
        b.tr - p.t * p.r / s,
        b.ts - p.t * p.s / s,
        b.ll - p.l * p.l / s,
        b.lr - p.l * p.r / s,
        b.ls - p.l * p.s / s,
        b.rr - p.r * p.r / s,
        b.rs - p.r * p.s / s,
        b.ss - p.s * p.s / s,
    )


def update_pose(belief: Belief, fix: PoseFix) -> Corrected:
    """Correct with a fix."""
    innovation = pose_innovation(fix.pose, belief.pose)
    one = correct(belief, belief, Jacobian(1.0, 0.0, 0.0), innovation.x, fix.var_x)
    two = correct(one.belief, belief, Jacobian(0.0, 1.0, 0.0), innovation.y, fix.var_y)
    three = correct(two.belief, belief, Jacobian(0.0, 0.0, 1.0), innovation.theta, fix.var_theta)
    return Corrected(turned(belief, three.belief), one.nis + two.nis + three.nis)


def update_heading(belief: Belief, heading: float, variance: float) -> Corrected:
    """Correct with a heading [rad] of this variance [rad^2]."""
    residual = heading_innovation(heading, belief.pose.theta)
    after = correct(belief, belief, Jacobian(0.0, 0.0, 1.0), residual, variance)
    return Corrected(turned(belief, after.belief), after.nis)


def update_landmark(belief: Belief, measured: LandmarkMeasurement) -> Corrected:
    """Correct with range and bearing; at the landmark the belief stays, and the NIS is inf."""
    if is_at_landmark(belief.pose, measured.landmark):
        return Corrected(belief, math.inf)
    expected = expect_landmark(belief.pose, measured.landmark, belief.P.xx + belief.P.yy)
    along = Jacobian(expected.range_x, expected.range_y, 0.0)
    across = Jacobian(expected.bearing_x, expected.bearing_y, -1.0)
    turn = heading_innovation(measured.bearing, expected.bearing)
    var_range = measured.var_range + expected.added_var_range
    var_bearing = measured.var_bearing + expected.added_var_bearing
    one = correct(belief, belief, along, measured.range - expected.range, var_range)
    two = correct(one.belief, belief, across, turn, var_bearing)
    return Corrected(turned(belief, two.belief), one.nis + two.nis)
