"""Options and memory of the filter.

The memory is one flat array. The fields of a :class:`FilterState` are views of this array, so a copy of the array is a
snapshot that can be restored.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter import noise
from diffbot_control.filter.models import WHEELS, Array
from diffbot_core.geometry import Pose, wrap_angle

REJECTIONS, ELAPSED, AGREEING, SLACK, HAS_CANDIDATE, DISAGREEMENT = 0, 1, 2, 3, 4, 5
"""Indices of the gate: length of the rejection streak of fixes; time since the first rejected fix [s]; number of fixes
that agree with the candidate; log of the factor on the bound of the gate; 1 if there is a candidate; slow mean of the
normalised innovations of the gyro."""
VALID, TIME, INNOVATION, NORMALISED, POSE, VAR_THETA = 0, 1, 2, 5, 8, 11
ALONG, TURN, NIS, OUTCOME, SHIFT = 12, 13, 14, 15, 16
"""Columns of the newest accepted measurement of a source or landmark, with which the next measurement is compared: its
kind plus 1, 0 if there is none; time [s]; innovation (3,); normalised innovation (3,); pose before the correction (3,);
variance of the heading; both sums of :attr:`FilterState.travelled`; NIS and outcome, also of a measurement that was not
accepted; the sum :attr:`FilterState.shift` (n,)."""


class Options(NamedTuple):
    """Options of the filter, computed from the configuration by :func:`config.options_of`."""

    size: int
    """n, number of states"""
    separation: float
    """L [m]"""
    gates: tuple[float, float, float]
    """bounds of the NIS of measurements of one, two and three scalars; inf without a gate"""
    relocation_fixes: int
    errors: tuple[float, float, float, float, float, float, float]
    """initial values of the errors of wheels, gyro and landmark sensor, in the order of the states"""
    variances: tuple[float, float, float, float, float, float, float]
    """initial variances of these errors; 0 for an error that is not estimated"""
    wheel_walk: float
    """[1/s] random-walk variance per second of each estimated wheel error"""
    bias_walk: float
    """[rad^2/s^3] random-walk variance per second of the gyro bias"""
    max_radius_error: float
    """if a radius error exceeds this bound, all wheel errors are reset; 0: wheel errors are not estimated"""
    max_separation_error: float
    """if the separation error exceeds this bound, all wheel errors are reset"""
    wheels_as_configured: float
    """probability that the wheel errors are exactly the initial errors"""
    fuzzy: bool
    """True: fuzzy rules scale R and Q"""
    finds_noise: bool
    """True: estimate scale and correlation time of the errors of each source"""
    times: tuple[float, ...]
    """[s] known correlation time of the errors of each source; 0: unknown"""


class FilterState(NamedTuple):
    """The memory of a filter."""

    memory: Any
    """flat array; copy it to take a snapshot, assign to its elements to restore one"""
    x: Any
    """(n,) mean"""
    P: Any
    """(n, n) covariance"""
    candidate: Any
    """(n,) mean of the candidate, the hypothesis that the rejected fixes are right"""
    candidate_P: Any
    """(n, n) covariance of the candidate"""
    gate: Any
    """(6,) state of the gate, indexed by REJECTIONS to DISAGREEMENT"""
    travelled: Any
    """(2,) sums of the variances of distance [m^2] and heading [rad^2] that the motion has added"""
    shift: Any
    """(n,) sum of all corrections"""
    noise: Any
    """(sources, noise.COLUMNS) noise statistic of each source"""
    last: Any
    """(sources + landmarks, SHIFT + n) newest measurement of each source and landmark"""


def new_filter(options: Options, landmarks: int) -> FilterState:
    """Return a reset filter for a map with this number of landmarks; call :func:`start` next."""
    n, sources = options.size, len(options.times)
    shapes = (n,), (n, n), (n,), (n, n), (6,), (2,), (n,), (sources, noise.COLUMNS), (sources + landmarks, SHIFT + n)
    memory = np.zeros(sum(math.prod(shape) for shape in shapes))
    views, first = [], 0
    for shape in shapes:
        end = first + math.prod(shape)
        views.append(memory[first:end].reshape(shape))
        first = end
    filter_ = FilterState(memory, *views)
    reset(filter_, options)
    return filter_


def reset(filter_: FilterState, options: Options) -> None:
    """Clear the whole memory and set all errors to their initial values; call :func:`start` next."""
    filter_.memory[:] = 0.0
    for row in range(len(filter_.noise)):
        noise.clear(filter_.noise[row])
    for i in range(options.size - WHEELS):
        filter_.x[WHEELS + i] = options.errors[i]
        filter_.P[WHEELS + i, WHEELS + i] = options.variances[i]


def start(filter_: FilterState, pose: Pose, P: Array) -> None:
    """Set the pose with covariance ``P`` (3, 3); keep the estimated errors and the noise statistics."""
    reset_pose(filter_.x, filter_.P, pose, P)
    filter_.gate[:] = 0.0
    unpair(filter_)


def reset_pose(x: Array, P: Array, pose: Pose, pose_P: Array) -> None:
    """Set the pose and its covariance (3, 3) in place; keep the other states, uncorrelated with the pose."""
    x[0], x[1], x[2] = pose.x, pose.y, wrap_angle(pose.theta)
    P[:3, :] = 0.0
    P[:, :3] = 0.0
    P[:3, :3] = pose_P


def set_errors(filter_: FilterState, options: Options, first: int, errors: Array, P: Array) -> None:
    """Set ``errors`` (k,) with covariance ``P`` (k, k), uncorrelated with all other states.

    ``first`` is the index of the first error, WHEELS or SENSOR. Errors that this filter does not estimate, or whose
    variance in ``P`` is 0, do not change.
    """
    indices = range(first, min(first + len(errors), options.size))
    estimated = [i for i in indices if options.variances[i - WHEELS] > 0.0 and P[i - first, i - first] > 0.0]
    filter_.P[estimated, :] = 0.0
    filter_.P[:, estimated] = 0.0
    for i in estimated:
        filter_.x[i] = errors[i - first]
        for j in estimated:
            filter_.P[i, j] = P[i - first, j - first]


def unpair(filter_: FilterState) -> None:
    """Drop the newest measurements after a jump of the estimate, so that no pair of measurements spans the jump."""
    filter_.last[:, VALID] = 0.0
    for row in range(len(filter_.noise)):
        noise.clear_innovations(filter_.noise[row])
