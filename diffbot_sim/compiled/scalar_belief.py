"""Mean and covariance of the compiled filter as plain numbers, and how they are set, reset and inflated."""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.filter.gate import RESET_VAR_THETA, RESET_VAR_XY
from diffbot_control.filter.models import RadiusErrors
from diffbot_core.geometry import Pose, wrap_angle


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


class PoseFix(NamedTuple):
    """A measured pose with independent errors."""

    pose: Pose
    var_x: float
    """[m^2]"""
    var_y: float
    """[m^2]"""
    var_theta: float
    """[rad^2]"""


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
