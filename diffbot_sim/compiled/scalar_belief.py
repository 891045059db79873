"""Mean and covariance of the compiled filter as plain numbers, and how they are set, reset and inflated."""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.filter.gate import RESET_VAR_THETA, RESET_VAR_XY
from diffbot_control.filter.models import TURNED_VARIANCE, arc_correction
from diffbot_core.geometry import Pose, wrap_angle


class Covariance(NamedTuple):
    """Upper triangle of P; t stands for theta, l and r for the wheels' radii, s for their separation."""

    xx: float
    xy: float
    xt: float
    xl: float
    xr: float
    xs: float
    yy: float
    yt: float
    yl: float
    yr: float
    ys: float
    tt: float
    tl: float
    tr: float
    ts: float
    ll: float
    lr: float
    ls: float
    rr: float
    rs: float
    ss: float


class WheelErrors(NamedTuple):
    """Relative errors of the wheel radii and of the wheel separation [-]."""

    left: float
    right: float
    separation: float


class Belief(NamedTuple):
    """Mean and covariance of the pose and of the errors of the wheels."""

    pose: Pose
    errors: WheelErrors
    P: Covariance


class PoseFix(NamedTuple):
    """A measured pose with independent errors."""

    pose: Pose
    var_x: float
    """[m^2]"""
    var_y: float
    """[m^2]"""
    var_theta: float
    """[rad^2]"""


def unknown(radius_variance: float, separation_variance: float) -> Belief:
    """Return the belief before the first fix: unknown pose, independent errors of the wheels with mean 0."""
    z, v, s = 0.0, radius_variance, separation_variance
    P = Covariance(z, z, z, z, z, z, z, z, z, z, z, z, z, z, z, v, z, z, v, z, s)
    return Belief(Pose(0.0, 0.0, 0.0), WheelErrors(0.0, 0.0, 0.0), P)


def reset_to(fix: PoseFix, belief: Belief) -> Belief:
    """Return a belief with the pose of ``fix``; the errors of the wheels stay."""
    b, z = belief.P, 0.0
    pose = Pose(fix.pose.x, fix.pose.y, wrap_angle(fix.pose.theta))
    x, y, t = fix.var_x, fix.var_y, fix.var_theta
    P = Covariance(x, z, z, z, z, z, y, z, z, z, z, t, z, z, z, b.ll, b.lr, b.ls, b.rr, b.rs, b.ss)
    return Belief(pose, belief.errors, P)


def reset_pose(belief: Belief) -> Belief:
    """Return a belief with a nearly unknown pose at the same mean; the errors of the wheels stay."""
    b, z, v = belief.P, 0.0, RESET_VAR_XY
    P = Covariance(v, z, z, z, z, z, v, z, z, z, z, RESET_VAR_THETA, z, z, z, b.ll, b.lr, b.ls, b.rr, b.rs, b.ss)
    return Belief(belief.pose, belief.errors, P)


def inflate(belief: Belief, factor: float) -> Belief:
    """Multiply the pose's part of P; that of the errors of the wheels stays."""
    b, f, g = belief.P, factor, math.sqrt(factor)
    P = Covariance(
        f * b.xx,
        f * b.xy,
        f * b.xt,
        g * b.xl,
        g * b.xr,
        g * b.xs,
        f * b.yy,
        f * b.yt,
        g * b.yl,
        g * b.yr,
        g * b.ys,
        f * b.tt,
        g * b.tl,
        g * b.tr,
        g * b.ts,
        b.ll,
        b.lr,
        b.ls,
        b.rr,
        b.rs,
        b.ss,
    )
    return Belief(belief.pose, belief.errors, P)


def with_possible_wheels(belief: Belief, bounds: tuple[float, float], variances: tuple[float, float]) -> Belief:
    """Reset the errors of the wheels, to zero with their initial ``variances``, if one is beyond its bound.

    Both pairs are of a radius and of the separation.
    """
    left, right, separation = belief.errors
    if abs(left) <= bounds[0] and abs(right) <= bounds[0] and abs(separation) <= bounds[1]:
        return belief
    b, z = belief.P, 0.0
    v, s = variances
    P = Covariance(b.xx, b.xy, b.xt, z, z, z, b.yy, b.yt, z, z, z, b.tt, z, z, z, v, z, z, v, z, s)
    return Belief(belief.pose, WheelErrors(0.0, 0.0, 0.0), P)


def turned(before: Belief, after: Belief) -> Belief:
    """Apply the correction from ``before`` to ``after`` along an arc if the heading was uncertain; wrap it.

    See :func:`models.arc_correction`; the position's rows and columns of P are turned by the correction of the heading.
    """
    if before.P.tt <= TURNED_VARIANCE:
        return wrapped(after)
    x, y, theta = before.pose
    turn = after.pose.theta - theta
    dx, dy = arc_correction(after.pose.x - x, after.pose.y - y, turn)
    c, s, b = math.cos(turn), math.sin(turn), after.P
    P = Covariance(
        c * c * b.xx - 2.0 * c * s * b.xy + s * s * b.yy,
        c * s * (b.xx - b.yy) + (c * c - s * s) * b.xy,
        c * b.xt - s * b.yt,
        c * b.xl - s * b.yl,
        c * b.xr - s * b.yr,
        c * b.xs - s * b.ys,
        s * s * b.xx + 2.0 * c * s * b.xy + c * c * b.yy,
        s * b.xt + c * b.yt,
        s * b.xl + c * b.yl,
        s * b.xr + c * b.yr,
        s * b.xs + c * b.ys,
        b.tt,
        b.tl,
        b.tr,
        b.ts,
        b.ll,
        b.lr,
        b.ls,
        b.rr,
        b.rs,
        b.ss,
    )
    return wrapped(Belief(Pose(x + dx, y + dy, after.pose.theta), after.errors, P))


def wrapped(belief: Belief) -> Belief:
    """Return the belief with its heading in (-pi, pi]."""
    x, y, theta = belief.pose
    return Belief(Pose(x, y, wrap_angle(theta)), belief.errors, belief.P)
