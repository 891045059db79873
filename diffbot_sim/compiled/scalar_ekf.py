"""The Kalman filter of :mod:`diffbot_control.filter.ekf` as pure functions of floats, for compiled campaigns.

The models are the same functions; a test holds the algebra to filterpy's filter to 1e-9. One form serves both filters:
with a variance of zero for the radius errors it is the filter of three states. Of the symmetric covariance the upper
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
    with_radius_errors,
)
from diffbot_core.geometry import Point, Pose
from diffbot_sim.compiled.scalar_belief import Belief, Covariance, PoseFix, wrapped


class Row(NamedTuple):
    """Derivatives of one number by each state, or its covariance with each."""

    x: float
    y: float
    t: float
    l: float  # noqa: E741 - the wheel's letter
    r: float


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


def predict(belief: Belief, motion: Motion, separation: float, random_walk: float) -> Belief:
    """Move: P = F P F' + G M G' + W.

    Args:
        belief: before.
        motion: twist from the encoders for wheels of the configured radius, duration, covariance M of the twist.
        separation: distance of the wheels [m].
        random_walk: [1/s] random-walk variance per second of each radius error.
    """
    twist = with_radius_errors(motion.twist, belief.errors, separation)
    arc = move(belief.pose, twist, motion.dt)
    by_radii = radius_derivatives(arc, motion.twist, motion.dt, separation)
    noise = motion_noise(arc, twist.v, motion.dt, motion.covariance)
    P = _propagate(belief.P, arc, by_radii, noise, random_walk * motion.dt)
    return Belief(arc.end, belief.errors, P)


def _propagate(
    b: Covariance, arc: Arc, by_radii: RadiusDerivatives, noise: MotionNoise, random_walk: float
) -> Covariance:
    """Return F P F' + Q; ``random_walk`` is the variance that each radius error gains."""
    # F adds these multiples of theta and of the radius errors to x, y and theta.
    xt, yt = arc.x_theta, arc.y_theta
    xl, xr, yl, yr, tl, tr = by_radii
    # First the rows of F P ...
    fxx = b.xx + xt * b.xt + xl * b.xl + xr * b.xr
    fxy = b.xy + xt * b.yt + xl * b.yl + xr * b.yr
    fxt = b.xt + xt * b.tt + xl * b.tl + xr * b.tr
    fxl = b.xl + xt * b.tl + xl * b.ll + xr * b.lr
    fxr = b.xr + xt * b.tr + xl * b.lr + xr * b.rr
    fyy = b.yy + yt * b.yt + yl * b.yl + yr * b.yr
    fyt = b.yt + yt * b.tt + yl * b.tl + yr * b.tr
    fyl = b.yl + yt * b.tl + yl * b.ll + yr * b.lr
    fyr = b.yr + yt * b.tr + yl * b.lr + yr * b.rr
    ftt = b.tt + tl * b.tl + tr * b.tr
    ftl = b.tl + tl * b.ll + tr * b.lr
    ftr = b.tr + tl * b.lr + tr * b.rr
    # ... then their products with F', and the noise.
    q_xx, q_xy, q_xt, q_yy, q_yt, q_tt = noise
    return Covariance(
        fxx + xt * fxt + xl * fxl + xr * fxr + q_xx,
        fxy + yt * fxt + yl * fxl + yr * fxr + q_xy,
        fxt + tl * fxl + tr * fxr + q_xt,
        fxl,
        fxr,
        fyy + yt * fyt + yl * fyl + yr * fyr + q_yy,
        fyt + tl * fyl + tr * fyr + q_yt,
        fyl,
        fyr,
        ftt + tl * ftl + tr * ftr + q_tt,
        ftl,
        ftr,
        b.ll + random_walk,
        b.lr,
        b.rr + random_walk,
    )


def product(P: Covariance, h: Row) -> Row:
    """Return P h'."""
    b = P
    return Row(
        b.xx * h.x + b.xy * h.y + b.xt * h.t + b.xl * h.l + b.xr * h.r,
        b.xy * h.x + b.yy * h.y + b.yt * h.t + b.yl * h.l + b.yr * h.r,
        b.xt * h.x + b.yt * h.y + b.tt * h.t + b.tl * h.l + b.tr * h.r,
        b.xl * h.x + b.yl * h.y + b.tl * h.t + b.ll * h.l + b.lr * h.r,
        b.xr * h.x + b.yr * h.y + b.tr * h.t + b.lr * h.l + b.rr * h.r,
    )


def correct(belief: Belief, before: Belief, h: Row, residual: float, variance: float) -> Corrected:
    """Correct with one number of a measurement: K = P h' / s, P = P - K s K'.

    For numbers with independent errors, sequential corrections equal the joint one.

    Args:
        belief: after the preceding numbers of the measurement.
        before: before its first number, where residuals and derivatives are taken.
        h: derivatives of the number by the states.
        residual: measured minus expected at ``before``.
        variance: of the error.

    Returns:
        The belief, its heading not wrapped, and the number's share of the NIS.
    """
    p = product(belief.P, h)
    s = h.x * p.x + h.y * p.y + h.t * p.t + h.l * p.l + h.r * p.r + variance
    x, y, theta = belief.pose
    residual -= (
        h.x * (x - before.pose.x)
        + h.y * (y - before.pose.y)
        + h.t * (theta - before.pose.theta)
        + h.l * (belief.errors.left - before.errors.left)
        + h.r * (belief.errors.right - before.errors.right)
    )
    gain = residual / s
    pose = Pose(x + p.x * gain, y + p.y * gain, theta + p.t * gain)
    errors = RadiusErrors(belief.errors.left + p.l * gain, belief.errors.right + p.r * gain)
    return Corrected(Belief(pose, errors, _reduce(belief.P, p, s)), residual * gain)


def _reduce(b: Covariance, p: Row, s: float) -> Covariance:
    """Return P - p p' / s, with p = P h'."""
    return Covariance(
        b.xx - p.x * p.x / s,
        b.xy - p.x * p.y / s,
        b.xt - p.x * p.t / s,
        b.xl - p.x * p.l / s,
        b.xr - p.x * p.r / s,
        b.yy - p.y * p.y / s,
        b.yt - p.y * p.t / s,
        b.yl - p.y * p.l / s,
        b.yr - p.y * p.r / s,
        b.tt - p.t * p.t / s,
        b.tl - p.t * p.l / s,
        b.tr - p.t * p.r / s,
        b.ll - p.l * p.l / s,
        b.lr - p.l * p.r / s,
        b.rr - p.r * p.r / s,
    )


def update_pose(belief: Belief, fix: PoseFix) -> Corrected:
    """Correct with a fix."""
    innovation = pose_innovation(fix.pose, belief.pose)
    one = correct(belief, belief, Row(1.0, 0.0, 0.0, 0.0, 0.0), innovation.x, fix.var_x)
    two = correct(one.belief, belief, Row(0.0, 1.0, 0.0, 0.0, 0.0), innovation.y, fix.var_y)
    three = correct(two.belief, belief, Row(0.0, 0.0, 1.0, 0.0, 0.0), innovation.theta, fix.var_theta)
    return Corrected(wrapped(three.belief), one.nis + two.nis + three.nis)


def update_heading(belief: Belief, heading: float, variance: float) -> Corrected:
    """Correct with a heading [rad] of this variance [rad^2]."""
    residual = heading_innovation(heading, belief.pose.theta)
    after = correct(belief, belief, Row(0.0, 0.0, 1.0, 0.0, 0.0), residual, variance)
    return Corrected(wrapped(after.belief), after.nis)


def update_landmark(belief: Belief, measured: LandmarkMeasurement) -> Corrected:
    """Correct with range and bearing; at the landmark the belief stays, and the NIS is inf."""
    if is_at_landmark(belief.pose, measured.landmark):
        return Corrected(belief, math.inf)
    expected = expect_landmark(belief.pose, measured.landmark, belief.P.xx + belief.P.yy)
    along = Row(expected.range_x, expected.range_y, 0.0, 0.0, 0.0)
    across = Row(expected.bearing_x, expected.bearing_y, -1.0, 0.0, 0.0)
    turn = heading_innovation(measured.bearing, expected.bearing)
    var_range = measured.var_range + expected.added_var_range
    var_bearing = measured.var_bearing + expected.added_var_bearing
    one = correct(belief, belief, along, measured.range - expected.range, var_range)
    two = correct(one.belief, belief, across, turn, var_bearing)
    return Corrected(wrapped(two.belief), one.nis + two.nis)
