"""The Kalman filter of :mod:`diffbot_control.filter.ekf` as pure functions of floats, for compiled campaigns.

The same models and the same letters; a test holds it to filterpy's filter to 1e-9. One form serves both filters: with
no variance of the wheels' errors it is the filter of three states. The covariance is symmetric, so its upper triangle
is kept.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.filter.landmark_map import linearisation_variance
from diffbot_control.filter.options import LOST_THETA, LOST_XY, MIN_LANDMARK_DISTANCE
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist, motion_noise, with_radius_errors


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
    left: float
    """relative radius error of the left wheel"""
    right: float
    P: Covariance


class Row(NamedTuple):
    """Derivatives of one number by each state, or its covariance with each."""

    x: float
    y: float
    t: float
    l: float  # noqa: E741 - the wheel's letter
    r: float


class Fix(NamedTuple):
    """A measured pose with independent errors."""

    pose: Pose
    var_x: float
    """[m^2]"""
    var_y: float
    """[m^2]"""
    var_theta: float
    """[rad^2]"""


class Sighting(NamedTuple):
    """Range and bearing of a known point, with independent errors."""

    distance: float
    """[m]"""
    bearing: float
    """[rad] in the robot's frame"""
    x: float
    """[m] where the point is"""
    y: float
    var_distance: float
    """[m^2]"""
    var_bearing: float
    """[rad^2]"""


class Corrected(NamedTuple):
    """A belief after a measurement, and what the measurement said of the belief before."""

    belief: Belief
    nis: float
    """normalised innovation squared"""


def unknown(wheel_variance: float) -> Belief:
    """The belief before the first fix: nothing of the pose; independent wheel errors of zero mean and this variance."""
    z = 0.0
    P = Covariance(z, z, z, z, z, z, z, z, z, z, z, z, wheel_variance, z, wheel_variance)
    return Belief(Pose(0.0, 0.0, 0.0), 0.0, 0.0, P)


def started(fix: Fix, wheels: Belief) -> Belief:
    """Start at a fix; what is known of the wheels is taken from ``wheels``."""
    z = 0.0
    ll, lr, rr = wheels.P.ll, wheels.P.lr, wheels.P.rr
    pose = Pose(fix.pose.x, fix.pose.y, wrap_angle(fix.pose.theta))
    P = Covariance(fix.var_x, z, z, z, z, fix.var_y, z, z, z, fix.var_theta, z, z, ll, lr, rr)
    return Belief(pose, wheels.left, wheels.right, P)


def predict(
    belief: Belief,
    twist: Twist,
    dt: float,
    noise: tuple[float, float, float],
    separation: float,
    walk: float,
) -> Belief:
    """Move by ``twist`` for ``dt`` [s]: P = F P F' + G M G' + W.

    Args:
        belief: before.
        twist: as the encoders have it with the nominal radius.
        dt: duration [s].
        noise: entries of M, the covariance of the twist: var(v), cov(v, omega), var(omega).
        separation: distance of the wheels [m].
        walk: variance per second that each wheel's error gains.
    """
    b = belief.P
    rim_left, rim_right = twist.v - 0.5 * separation * twist.omega, twist.v + 0.5 * separation * twist.omega
    v, omega = with_radius_errors(twist, belief.left, belief.right, separation)
    x, y, theta = belief.pose
    middle = theta + 0.5 * omega * dt
    ahead_x, ahead_y = dt * math.cos(middle), dt * math.sin(middle)
    pose = Pose(x + v * ahead_x, y + v * ahead_y, wrap_angle(theta + omega * dt))
    # F adds these multiples of theta and of the wheels' errors to x, y and theta.
    xt, yt = -v * ahead_y, v * ahead_x
    tl, tr = -dt * rim_left / separation, dt * rim_right / separation
    xl, xr = 0.5 * (rim_left * ahead_x + xt * tl), 0.5 * (rim_right * ahead_x + xt * tr)
    yl, yr = 0.5 * (rim_left * ahead_y + yt * tl), 0.5 * (rim_right * ahead_y + yt * tr)
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
    q_xx, q_xy, q_xt, q_yy, q_yt, q_tt = motion_noise(ahead_x, ahead_y, v, dt, noise)
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
        b.ll + walk * dt,
        b.lr,
        b.rr + walk * dt,
    )
    return Belief(pose, belief.left, belief.right, P)


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

    Numbers with independent errors, taken one after the other, give what they give together.

    Args:
        belief: after the numbers that came before.
        before: before the first number of the measurement, where the residuals and derivatives are taken.
        h: derivatives of the number by the states.
        residual: measured minus expected in ``before``.
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
        + h.l * (belief.left - before.left)
        + h.r * (belief.right - before.right)
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
    return Corrected(Belief(pose, belief.left + p.l * gain, belief.right + p.r * gain, P), residual * gain)


def update_pose(belief: Belief, fix: Fix) -> Corrected:
    """Correct with a fix."""
    turn = wrap_angle(fix.pose.theta - belief.pose.theta)
    one = correct(belief, belief, Row(1.0, 0.0, 0.0, 0.0, 0.0), fix.pose.x - belief.pose.x, fix.var_x)
    two = correct(one.belief, belief, Row(0.0, 1.0, 0.0, 0.0, 0.0), fix.pose.y - belief.pose.y, fix.var_y)
    three = correct(two.belief, belief, Row(0.0, 0.0, 1.0, 0.0, 0.0), turn, fix.var_theta)
    return Corrected(wrapped(three.belief), one.nis + two.nis + three.nis)


def update_heading(belief: Belief, heading: float, variance: float) -> Corrected:
    """Correct with a heading [rad]."""
    residual = wrap_angle(heading - belief.pose.theta)
    after = correct(belief, belief, Row(0.0, 0.0, 1.0, 0.0, 0.0), residual, variance)
    return Corrected(wrapped(after.belief), after.nis)


def update_landmark(belief: Belief, seen: Sighting) -> Corrected:
    """Correct with range and bearing of a known point; with nothing, and a NIS of inf, if the robot is at it."""
    dx, dy = seen.x - belief.pose.x, seen.y - belief.pose.y
    squared = dx * dx + dy * dy
    if squared < MIN_LANDMARK_DISTANCE * MIN_LANDMARK_DISTANCE:
        return Corrected(belief, math.inf)
    distance = math.sqrt(squared)
    turn = wrap_angle(seen.bearing - wrap_angle(math.atan2(dy, dx) - belief.pose.theta))
    along = Row(-dx / distance, -dy / distance, 0.0, 0.0, 0.0)
    across = Row(dy / squared, -dx / squared, -1.0, 0.0, 0.0)
    by_range, by_bearing = linearisation_variance(squared, belief.P.xx + belief.P.yy)
    one = correct(belief, belief, along, seen.distance - distance, seen.var_distance + by_range)
    two = correct(one.belief, belief, across, turn, seen.var_bearing + by_bearing)
    return Corrected(wrapped(two.belief), one.nis + two.nis)


def lost(belief: Belief) -> Belief:
    """Return the belief of one who knows the wheels and next to nothing of the pose."""
    b, z = belief.P, 0.0
    P = Covariance(LOST_XY, z, z, z, z, LOST_XY, z, z, z, LOST_THETA, z, z, b.ll, b.lr, b.rr)
    return Belief(belief.pose, belief.left, belief.right, P)


def scaled(belief: Belief, factor: float) -> Belief:
    """Multiply the pose's part of P; what is known of the wheels stays."""
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
    return Belief(belief.pose, belief.left, belief.right, P)


def wheels_checked(belief: Belief, most: float, variance: float) -> Belief:
    """Forget what is known of the wheels if an error is beyond +-``most``; ``variance`` is that of the start."""
    if abs(belief.left) <= most and abs(belief.right) <= most:
        return belief
    b, z = belief.P, 0.0
    P = Covariance(b.xx, b.xy, b.xt, z, z, b.yy, b.yt, z, z, b.tt, z, z, variance, z, variance)
    return Belief(belief.pose, 0.0, 0.0, P)


def wrapped(belief: Belief) -> Belief:
    """Return the belief with its heading in (-pi, pi]."""
    x, y, theta = belief.pose
    return Belief(Pose(x, y, wrap_angle(theta)), belief.left, belief.right, belief.P)
