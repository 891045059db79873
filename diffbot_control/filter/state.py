"""Options and memory of the filter.

The whole memory is one flat array, and a :class:`FilterState` has views of it. A copy of the array is a snapshot that
can be restored.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter import noise
from diffbot_control.filter.models import WHEELS, Array
from diffbot_core.geometry import Pose, wrap_angle

REJECTIONS, ELAPSED, AGREEING, SLACK, HAS_CANDIDATE, DISAGREEMENT = 0, 1, 2, 3, 4, 5
"""Indices of the gate: fixes rejected in a row, time since the first of them [s], number of fixes that agree with the
candidate, logarithm of the factor on the bound, 1 if there is a candidate, slow mean of the gyro's normalised
innovations."""
VALID, TIME, INNOVATION, NORMALISED, POSE, VAR_THETA = 0, 1, 2, 5, 8, 11
ALONG, TURN, NIS, OUTCOME, SHIFT = 12, 13, 14, 15, 16
"""Columns of the newest measurement, with which the next one is compared: 1 if there is one; time [s]; innovation (3,);
normalised innovation (3,); pose before its correction (3,); variance of the heading; variances along and of the heading
that the motion has added so far; NIS and outcome, also of a measurement that was not accepted; sum of the corrections
so far (n,)."""


class Options(NamedTuple):
    """The numbers of the configuration that the filter needs."""

    size: int
    """n, number of states"""
    separation: float
    """L [m]"""
    gates: tuple[float, float, float]
    """bounds of the NIS of measurements of one, two and three numbers; inf without a gate"""
    relocation_fixes: int
    errors: tuple[float, float, float, float, float, float, float]
    """initial errors of wheels, gyro and landmark sensor, in the order of the states"""
    variances: tuple[float, float, float, float, float, float, float]
    """initial variances of these errors; 0 for an error that is not estimated"""
    wheel_walk: float
    """[1/s] random-walk variance per second of each uncertain error of the wheels"""
    bias_walk: float
    """[rad^2/s^3] random-walk variance per second of the gyro's bias"""
    max_radius_error: float
    """the errors of the wheels are reset if one of them exceeds its bound"""
    max_separation_error: float
    wheels_as_configured: float
    """probability that the errors of the wheels are exactly the initial ones"""
    fuzzy: bool
    """R and Q by fuzzy rules"""
    finds_noise: bool
    """find scale and correlation of the errors of each source"""
    times: tuple[float, ...]
    """[s] known correlation time of the errors of each source; 0: to be found"""


class FilterState(NamedTuple):
    """The filter's memory, all of it views of one array."""

    memory: Any
    """the flat array; copy it for a snapshot, assign to its elements to restore one"""
    x: Any
    """(n,) mean"""
    P: Any
    """(n, n) covariance"""
    candidate: Any
    """(n,) mean of the hypothesis of rejected fixes"""
    candidate_P: Any
    """(n, n)"""
    gate: Any
    """(6,)"""
    travelled: Any
    """(2,) variances along [m^2] and of the heading [rad^2] that the motion has added so far"""
    shift: Any
    """(n,) sum of the corrections so far"""
    noise: Any
    """(sources, noise.COLUMNS) statistics of each source"""
    last: Any
    """(places, 16 + n) newest measurement of each source and landmark"""


def new_filter(options: Options, landmarks: int = 0) -> FilterState:
    """Return a filter of unknown state for a number of ``landmarks``; call :func:`start` next."""
    n, sources = options.size, len(options.times)
    filter_ = views(np.zeros(memory_size(n, sources, landmarks)), n, sources)
    reset(filter_, options)
    return filter_


def memory_size(n: int, sources: int, landmarks: int) -> int:
    """Return the length of the memory of a filter."""
    return 3 * n + 2 * n * n + 8 + sources * noise.COLUMNS + (sources + landmarks) * (SHIFT + n)


def views(memory: Array, n: int, sources: int) -> FilterState:
    """Return the views of a flat memory."""
    shapes = (n,), (n, n), (n,), (n, n), (6,), (2,), (n,), (sources, noise.COLUMNS), (-1, SHIFT + n)
    parts, at = [], 0
    for shape in shapes:
        length = len(memory) - at if shape[0] == -1 else math.prod(shape)
        parts.append(memory[at : at + length].reshape(shape))
        at += length
    return FilterState(memory, *parts)


def reset(filter_: FilterState, options: Options) -> None:
    """Reset the filter to an unknown state. Call :func:`start` next."""
    filter_.memory[:] = 0.0
    for row in range(len(filter_.noise)):
        noise.clear(filter_.noise[row])
    for i in range(options.size - WHEELS):
        filter_.x[WHEELS + i] = options.errors[i]
        filter_.P[WHEELS + i, WHEELS + i] = options.variances[i]


def start(filter_: FilterState, pose: Pose, P: Array) -> None:
    """Put the filter at a pose with covariance ``P`` (3, 3); the estimated errors and the noise statistics stay."""
    reset_pose(filter_.x, filter_.P, pose, P)
    filter_.gate[:] = 0.0
    unpair(filter_)


def reset_pose(x: Array, P: Array, pose: Pose, pose_P: Array) -> None:
    """Replace the pose and its covariance (3, 3); the estimated errors stay, without correlation with the pose."""
    x[0], x[1], x[2] = pose.x, pose.y, wrap_angle(pose.theta)
    P[:3, :] = 0.0
    P[:, :3] = 0.0
    P[:3, :3] = pose_P


def set_errors(filter_: FilterState, options: Options, first: int, errors: Array, P: Array) -> None:
    """Set estimated errors (k,) with covariance ``P`` (k, k), uncorrelated with all other states.

    ``first`` is the index of the first error, WHEELS or SENSOR. Errors that this filter does not estimate, or whose
    variance in ``P`` is 0, stay.
    """
    part = range(first, min(first + len(errors), options.size))
    places = [i for i in part if options.variances[i - WHEELS] > 0.0 and P[i - first, i - first] > 0.0]
    filter_.P[places, :] = 0.0
    filter_.P[:, places] = 0.0
    for i in places:
        filter_.x[i] = errors[i - first]
        for j in places:
            filter_.P[i, j] = P[i - first, j - first]


def unpair(filter_: FilterState) -> None:
    """Drop the newest measurements after a jump of the estimate, so that none is compared across the jump."""
    filter_.last[:, VALID] = 0.0
    for row in range(len(filter_.noise)):
        noise.forget_innovations(filter_.noise[row])
