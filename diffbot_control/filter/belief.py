"""Mean and covariance of the filter, and how parts of them are replaced."""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.filter.measurements import Array
from diffbot_core.geometry import Pose, wrap_angle


class Belief(NamedTuple):
    """Mean (n,) and covariance (n, n) of x, y, theta [m, m, rad] and of the errors that are states."""

    x: Array
    P: Array


class ErrorEstimate(NamedTuple):
    """Estimated errors of the wheels or of landmarks."""

    errors: Array
    """(m,) relative errors of the radii, left, right, and of the wheel separation; or those of LandmarkErrors"""
    P: Array
    """(m, m)"""


def pose_of(belief: Belief) -> Pose:
    """Return the mean pose."""
    x = belief.x
    return Pose(x.item(0), x.item(1), x.item(2))


def with_errors(belief: Belief, part: slice, errors: Array, P: Array) -> Belief:
    """Replace the ``part`` of the states by errors (m,) of covariance (m, m), uncorrelated with the others."""
    x, whole = belief.x.copy(), belief.P.copy()
    x[part] = errors
    whole[part, :] = whole[:, part] = 0.0
    whole[part, part] = P
    return Belief(x, whole)


def with_pose(belief: Belief, pose: Pose, P: Array) -> Belief:
    """Replace the pose and its covariance (3, 3), uncorrelated with the estimated errors, which stay."""
    x, whole = belief.x.copy(), belief.P.copy()
    x[:3] = pose.x, pose.y, wrap_angle(pose.theta)
    whole[:3, :] = whole[:, :3] = 0.0
    whole[:3, :3] = P
    return Belief(x, whole)


def with_wider_radii(belief: Belief, variance: float) -> Belief:
    """Add a ``variance`` to that of the relative error of each radius, which both are states."""
    P = belief.P.copy()
    P[3, 3] += variance
    P[4, 4] += variance
    return Belief(belief.x, P)


def inflate(belief: Belief, factor: float) -> Belief:
    """Multiply the pose's part of P; the covariance of the estimated errors stays."""
    if factor == 1.0:
        return belief
    P = belief.P.copy()
    P[:3, :] *= math.sqrt(factor)
    P[:, :3] *= math.sqrt(factor)
    return Belief(belief.x, P)
