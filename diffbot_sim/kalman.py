"""The filter of :mod:`diffbot_control.ekf` as pure functions of floats, for compiled campaigns.

The same model and the same letters; a test holds it to filterpy's filter to 1e-9. The covariance is symmetric, so six
of its entries are kept.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.geometry import Pose, wrap_angle
from diffbot_control.kinematics import Twist


class Belief(NamedTuple):
    """Mean and covariance of the pose."""

    pose: Pose
    xx: float
    xy: float
    xt: float
    yy: float
    yt: float
    tt: float
    """entries of P, t for theta"""
    known: bool
    """False before the first fix"""


def unknown() -> Belief:
    """The belief before the first fix."""
    return Belief(Pose(0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False)


def first_fix(z: Pose, var_x: float, var_y: float, var_theta: float) -> Belief:
    """Start at a fix with the variances of its errors."""
    return Belief(z, var_x, 0.0, 0.0, var_y, 0.0, var_theta, True)


def predict(belief: Belief, twist: Twist, dt: float, var_v: float, cov_v_omega: float, var_omega: float) -> Belief:
    """Move by ``twist`` for ``dt`` [s]: P = F P F' + G M G', M the covariance of the twist."""
    x, y, theta = belief.pose
    middle = theta + 0.5 * twist.omega * dt
    ahead_x, ahead_y = dt * math.cos(middle), dt * math.sin(middle)
    pose = Pose(x + twist.v * ahead_x, y + twist.v * ahead_y, wrap_angle(theta + twist.omega * dt))
    # F adds these multiples of theta to x and y.
    fx, fy = -twist.v * ahead_y, twist.v * ahead_x
    side_x, side_y = 0.5 * dt * fx, 0.5 * dt * fy
    xt = belief.xt + fx * belief.tt
    yt = belief.yt + fy * belief.tt
    xx = belief.xx + fx * (belief.xt + xt)
    yy = belief.yy + fy * (belief.yt + yt)
    xy = belief.xy + fy * belief.xt + fx * yt
    return Belief(
        pose,
        xx + ahead_x * ahead_x * var_v + 2.0 * ahead_x * side_x * cov_v_omega + side_x * side_x * var_omega,
        xy
        + ahead_x * ahead_y * var_v
        + (ahead_x * side_y + ahead_y * side_x) * cov_v_omega
        + side_x * side_y * var_omega,
        xt + dt * (ahead_x * cov_v_omega + side_x * var_omega),
        yy + ahead_y * ahead_y * var_v + 2.0 * ahead_y * side_y * cov_v_omega + side_y * side_y * var_omega,
        yt + dt * (ahead_y * cov_v_omega + side_y * var_omega),
        belief.tt + dt * dt * var_omega,
        True,
    )


def update_scalar(belief: Belief, h: int, residual: float, variance: float) -> Belief:
    """Correct with one measured component ``h`` (0: x, 1: y, 2: theta): K = P H' / s, P = P - K s K'."""
    px = belief.xx if h == 0 else (belief.xy if h == 1 else belief.xt)
    py = belief.xy if h == 0 else (belief.yy if h == 1 else belief.yt)
    pt = belief.xt if h == 0 else (belief.yt if h == 1 else belief.tt)
    s = (px if h == 0 else (py if h == 1 else pt)) + variance
    gain = residual / s
    x, y, theta = belief.pose
    return Belief(
        Pose(x + px * gain, y + py * gain, theta + pt * gain),
        belief.xx - px * px / s,
        belief.xy - px * py / s,
        belief.xt - px * pt / s,
        belief.yy - py * py / s,
        belief.yt - py * pt / s,
        belief.tt - pt * pt / s,
        True,
    )


def update_pose(belief: Belief, z: Pose, var_x: float, var_y: float, var_theta: float) -> Belief:
    """Correct with a fix whose errors are independent: one component after the other, which gives the same."""
    # One residual for all: what the angle's wrapping is measured against must not move between the components.
    turn = wrap_angle(z.theta - belief.pose.theta)
    theta = belief.pose.theta
    belief = update_scalar(belief, 0, z.x - belief.pose.x, var_x)
    belief = update_scalar(belief, 1, z.y - belief.pose.y, var_y)
    belief = update_scalar(belief, 2, turn - (belief.pose.theta - theta), var_theta)
    return wrapped(belief)


def update_heading(belief: Belief, z: float, variance: float) -> Belief:
    """Correct with a heading [rad]."""
    return wrapped(update_scalar(belief, 2, wrap_angle(z - belief.pose.theta), variance))


def wrapped(belief: Belief) -> Belief:
    """Return the belief with its heading in (-pi, pi]."""
    x, y, theta = belief.pose
    return Belief(
        Pose(x, y, wrap_angle(theta)),
        belief.xx,
        belief.xy,
        belief.xt,
        belief.yy,
        belief.yt,
        belief.tt,
        belief.known,
    )
