"""The Kalman filter of :mod:`diffbot_control.filter.ekf` as pure functions of floats, for compiled campaigns.

The models are the same functions; a test holds the algebra to filterpy's filter to 1e-9. One form serves both filters:
with a variance of zero for the radius errors it is the filter of three states. Of the symmetric covariance the upper
triangle is kept.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.filter.gate import RESET_VAR_THETA, RESET_VAR_XY
from diffbot_control.filter.models import (
    Motion,
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
from diffbot_core.geometry import Point, Pose, wrap_angle


class Covariance(NamedTuple):
    """Upper triangle of P; t stands for theta, l and r for the wheels."""

    xx: float
    xy: float
    xt: float
    xl: float
    xr: float
    yy: float
    yt: float
    yl: float
    yr: float
    tt: float
    tl: float
    tr: float
    ll: float
    lr: float
    rr: float


class Belief(NamedTuple):
    """Mean and covariance of the pose and of the relative radius errors of both wheels."""

    pose: Pose
    errors: RadiusErrors
    P: Covariance


class Row(NamedTuple):
    """Derivatives of one number by each state, or its covariance with each."""

    x: float
    y: float
    t: float
    l: float  # noqa: E741 - the wheel's letter
    r: float


class PoseFix(NamedTuple):
    """A measured pose with independent errors."""

    pose: Pose
    var_x: float
    """[m^2]"""
    var_y: float
    """[m^2]"""
    var_theta: float
    """[rad^2]"""


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


def unknown(radius_variance: float) -> Belief:
    """Return the belief before the first fix: unknown pose, independent radius errors of mean 0 and this variance."""
    z = 0.0
    P = Covariance(z, z, z, z, z, z, z, z, z, z, z, z, radius_variance, z, radius_variance)
    return Belief(Pose(0.0, 0.0, 0.0), RadiusErrors(0.0, 0.0), P)


def reset_to(fix: PoseFix, belief: Belief) -> Belief:
    """Return a belief with the pose of ``fix``; the radius errors of ``belief`` stay."""
    z = 0.0
    ll, lr, rr = belief.P.ll, belief.P.lr, belief.P.rr
    pose = Pose(fix.pose.x, fix.pose.y, wrap_angle(fix.pose.theta))
    P = Covariance(fix.var_x, z, z, z, z, fix.var_y, z, z, z, fix.var_theta, z, z, ll, lr, rr)
    return Belief(pose, belief.errors, P)


def predict(belief: Belief, motion: Motion, separation: float, random_walk: float) -> Belief:
    """Move: P = F P F' + G M G' + W.

    Args:
        belief: before.
        motion: twist from the encoders for wheels of the configured radius, duration, covariance M of the twist.
        separation: distance of the wheels [m].
        random_walk: [1/s] random-walk variance per second of each radius error.
    """
    b, dt = belief.P, motion.dt
    twist = with_radius_errors(motion.twist, belief.errors, separation)
    arc = move(belief.pose, twist, dt)
    # F adds these multiples of theta and of the radius errors to x, y and theta.
    xt, yt = arc.x_theta, arc.y_theta
    xl, xr, yl, yr, tl, tr = radius_derivatives(arc, motion.twist, dt, separation)
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
    q_xx, q_xy, q_xt, q_yy, q_yt, q_tt = motion_noise(arc, twist.v, dt, motion.covariance)
    P = Covariance(
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
        b.ll + random_walk * dt,
        b.lr,
        b.rr + random_walk * dt,
    )
    return Belief(arc.end, belief.errors, P)


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
    b = belief.P
    P = Covariance(
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
    pose = Pose(x + p.x * gain, y + p.y * gain, theta + p.t * gain)
    errors = RadiusErrors(belief.errors.left + p.l * gain, belief.errors.right + p.r * gain)
    return Corrected(Belief(pose, errors, P), residual * gain)


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


def reset_pose(belief: Belief) -> Belief:
    """Return a belief with a nearly unknown pose at the same mean; the radius errors stay."""
    b, z = belief.P, 0.0
    P = Covariance(RESET_VAR_XY, z, z, z, z, RESET_VAR_XY, z, z, z, RESET_VAR_THETA, z, z, b.ll, b.lr, b.rr)
    return Belief(belief.pose, belief.errors, P)


def inflate(belief: Belief, factor: float) -> Belief:
    """Multiply the pose's part of P; the covariance of the radius errors stays."""
    b, f, g = belief.P, factor, math.sqrt(factor)
    P = Covariance(
        f * b.xx,
        f * b.xy,
        f * b.xt,
        g * b.xl,
        g * b.xr,
        f * b.yy,
        f * b.yt,
        g * b.yl,
        g * b.yr,
        f * b.tt,
        g * b.tl,
        g * b.tr,
        b.ll,
        b.lr,
        b.rr,
    )
    return Belief(belief.pose, belief.errors, P)


def with_possible_radii(belief: Belief, bound: float, variance: float) -> Belief:
    """Reset the radius errors, to zero with the initial ``variance``, if one is beyond +-``bound``."""
    if abs(belief.errors.left) <= bound and abs(belief.errors.right) <= bound:
        return belief
    b, z = belief.P, 0.0
    P = Covariance(b.xx, b.xy, b.xt, z, z, b.yy, b.yt, z, z, b.tt, z, z, variance, z, variance)
    return Belief(belief.pose, RadiusErrors(0.0, 0.0), P)


def wrapped(belief: Belief) -> Belief:
    """Return the belief with its heading in (-pi, pi]."""
    x, y, theta = belief.pose
    return Belief(Pose(x, y, wrap_angle(theta)), belief.errors, belief.P)
