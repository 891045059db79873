"""Sensing with measurements that arrive late: the compiled counterpart of :class:`filter.localization.Localization`.

Each measurement is fused at its own stamp: the filter goes back to its state before the odometry step that contains the
stamp, and the steps since then are computed again. The ring that this needs has no rows if no measurement is late. A
test holds the results to the class's.

Stamps are numbers of steps. The first odometry step begins at the stamp of the first fix and ends at the step at which
that fix arrives, so it may be longer than one sampling time.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.models import Motion, TurnRate
from diffbot_control.filter.options import FilterOptions
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import (
    TwistCovariance,
    WheelSpeeds,
    add_twist_covariance,
    body_twist,
    encoder_covariance,
    scale_twist_covariance,
)
from diffbot_sim.compiled.gated_filter import (
    PoseFix,
    Track,
    advance,
    initialise,
    new_arrays,
    new_track,
    take_fix,
    take_heading,
    take_rate,
)
from diffbot_sim.compiled.sensing import Robot, measured_rate, observe, take_landmarks
from diffbot_sim.model.philox import Draw, NoiseKey
from diffbot_sim.model.plant import PlantState
from diffbot_sim.model.sensors import (
    NO_ERRORS,
    SensorConfig,
    delay_in_steps,
    due,
    fix_at,
    fix_variances,
    heading_at,
    uniform_variance,
)

_X, _Y, _THETA, _LEFT, _RIGHT = 0, 1, 2, 3, 4
"""Columns of a row: true pose, speeds of the encoders over the step that ends there [rad/s]."""
_FIX_X, _FIX_Y, _FIX_THETA, _FIX_ARRIVAL, _FIX_FUSED = 5, 6, 7, 8, 9
_HEADING, _HEADING_ARRIVAL, _HEADING_FUSED, _LANDMARKS_FUSED = 10, 11, 12, 13
"""Measurements, the steps at which they arrive (-1 for none), and 1 from when they belong to the odometry steps."""
_RATE, _RATE_VARIANCE = 14, 15
"""of the gyro over the step that ends there; the variance is inf for none"""
_COLUMNS = 16
_ORIGIN, _FIRST_END = 0, 1
"""Stamps: of the first fix, and of the end of the first odometry step; -1 before there are any."""


class LateRecord(NamedTuple):
    """The newest n steps, each at its stamp modulo n; n is 0 if no measurement is late."""

    rows: Any
    """(n, 16) see _X to _COLUMNS"""
    tracks: Any
    """n states of the filter before the odometry step that ends at a stamp"""
    arrays: Any
    """(n,) that belong to them"""
    marks: Any
    """(2,) see _ORIGIN, _FIRST_END"""


class Buffers(NamedTuple):
    """The arrays of sensors and filter, which are changed in place."""

    filter: Any
    """(1,) of :func:`gated_filter.filter_type`"""
    record: LateRecord


class Sensed(NamedTuple):
    """State of the sensors and of the filter but for their :class:`Buffers`."""

    track: Track
    """state of the filter"""
    errors: Draw
    """of the newest fix, see :func:`sensors.correlated`"""


def late_steps(sensors: SensorConfig, sampling_time: float) -> int:
    """Return the longest delay in steps; 0 if no measurement is late."""
    return max(
        delay_in_steps(sensors.fix_delay + sensors.fix_delay_jitter, sampling_time),
        delay_in_steps(sensors.heading_delay, sampling_time),
    )


def new_sensed() -> Sensed:
    """Return the state before the first step."""
    return Sensed(new_track(), NO_ERRORS)


def new_buffers(options: FilterOptions, steps: int, example: Any) -> Buffers:
    """Return the arrays before the first step.

    Args:
        options: of the filter.
        steps: longest delay; 0 if no measurement is late.
        example: of the filter's arrays.
    """
    # A late measurement may reach back into the first odometry step, which may itself be as long as the longest delay.
    n = 2 * steps + 2 if steps > 0 else 0
    tracks = [new_track() for _ in range(n)]
    record = LateRecord(np.zeros((n, _COLUMNS)), tracks, np.zeros(n, example.dtype), np.full(2, -1))
    return Buffers(new_arrays(options, example), record)


def sense(sensed: Sensed, buffers: Buffers, moment: NoiseKey, state: PlantState, robot: Robot) -> Sensed:
    """Sense at one step, and bring the filter up to it."""
    record = buffers.record
    if len(record.rows) == 0:
        track, errors = observe(sensed.track, buffers.filter, sensed.errors, moment, state, robot)
        return Sensed(track, errors)
    errors = record_step(record, sensed.errors, moment, state, robot.plant.sampling_time, robot.sensors)
    return Sensed(_fuse_arrivals(sensed.track, buffers, moment, robot), errors)


def record_step(
    record: LateRecord, errors: Draw, moment: NoiseKey, state: PlantState, sampling_time: float, sensors: SensorConfig
) -> Draw:
    """Write down what is measured at this step and when it will arrive; return the errors of the newest fix."""
    step = moment.step
    row = record.rows[step % len(record.rows)]
    row[_X], row[_Y], row[_THETA] = state.pose.x, state.pose.y, state.pose.theta
    row[_LEFT], row[_RIGHT] = state.encoder.left, state.encoder.right
    row[_FIX_ARRIVAL], row[_HEADING_ARRIVAL] = -1.0, -1.0
    row[_FIX_FUSED], row[_HEADING_FUSED], row[_LANDMARKS_FUSED] = 0.0, 0.0, 0.0
    row[_RATE], row[_RATE_VARIANCE] = measured_rate(moment, state.twist.omega, sampling_time, sensors)
    if due(step, sensors.fix_rate, sampling_time):
        fix = fix_at(moment, state.pose, errors, sensors)
        errors = fix.errors
        if not fix.lost:
            row[_FIX_X], row[_FIX_Y], row[_FIX_THETA] = fix.pose.x, fix.pose.y, fix.pose.theta
            row[_FIX_ARRIVAL] = step + delay_in_steps(fix.delay, sampling_time)
    if due(step, sensors.heading_rate, sampling_time):
        row[_HEADING] = heading_at(moment, state.pose, sensors)
        row[_HEADING_ARRIVAL] = step + delay_in_steps(sensors.heading_delay, sampling_time)
    return errors


def arrived_fix(record: LateRecord, step: int, before: Pose, known: bool) -> tuple[Pose, bool]:
    """Return the fix that arrived last, and True if there is one; ``before`` and ``known`` if none arrives now."""
    rows = record.rows
    for stamp in range(max(step - len(rows) + 1, 0), step + 1):
        row = rows[stamp % len(rows)]
        if row[_FIX_ARRIVAL] == step:
            before, known = _fix_pose(row), True
    return before, known


def _fuse_arrivals(track: Track, buffers: Buffers, moment: NoiseKey, robot: Robot) -> Track:
    """Take what arrives at this step, and compute the odometry steps from the oldest of it on."""
    arrays, record = buffers
    rows, marks, now = record.rows, record.marks, moment.step
    track, oldest = _take_fixes(track, buffers, now, robot)
    if not track.initialised:
        return track
    oldest = min(oldest, _mark_others(record, now, robot))
    if marks[_FIRST_END] < 0 and now > marks[_ORIGIN]:
        marks[_FIRST_END] = now
    first = max(oldest, marks[_FIRST_END])
    for end in range(first, now + 1):
        if end == first and end < now:
            track, arrays[0] = record.tracks[end % len(rows)], record.arrays[end % len(rows)]
        record.tracks[end % len(rows)], record.arrays[end % len(rows)] = track, arrays[0]
        track = _propagated(track, buffers, end, moment, robot)
    if now == marks[_ORIGIN]:
        # Fused before the first odometry step, to which they therefore do not belong.
        row = rows[now % len(rows)]
        row[_HEADING_FUSED], row[_LANDMARKS_FUSED] = 0.0, 0.0
    return track


def _take_fixes(track: Track, buffers: Buffers, now: int, robot: Robot) -> tuple[Track, int]:
    """Initialise with the first fix; mark later ones. Return also the oldest stamp marked, ``now`` for none."""
    rows, marks, oldest = buffers.record.rows, buffers.record.marks, now
    for stamp in range(max(now - len(rows) + 1, 0), now + 1):
        row = rows[stamp % len(rows)]
        if row[_FIX_ARRIVAL] == now:
            if not track.initialised:
                track = initialise(track, buffers.filter, _fix_of(row, robot.sensors))
                marks[_ORIGIN] = stamp
            elif stamp > marks[_ORIGIN]:
                row[_FIX_FUSED] = 1.0
                oldest = min(oldest, stamp)
    return track, oldest


def _mark_others(record: LateRecord, now: int, robot: Robot) -> int:
    """Mark the headings and landmarks that arrive; return the oldest stamp marked, ``now`` for none."""
    rows, oldest = record.rows, now
    for stamp in range(max(now - len(rows) + 1, record.marks[_ORIGIN]), now + 1):
        row = rows[stamp % len(rows)]
        if row[_HEADING_ARRIVAL] == now:
            row[_HEADING_FUSED] = 1.0
            oldest = min(oldest, stamp)
    if due(now, robot.sensors.landmark_rate, robot.plant.sampling_time):
        rows[now % len(rows), _LANDMARKS_FUSED] = 1.0
    return oldest


def _propagated(track: Track, buffers: Buffers, end: int, moment: NoiseKey, robot: Robot) -> Track:
    """Compute the odometry step that ends at ``end``, with the measurements in it.

    At the stamp of the first fix itself there is none, only measurements.
    """
    arrays, record = buffers
    rows, plant, t_s = record.rows, robot.plant, robot.plant.sampling_time
    is_first = end == record.marks[_FIRST_END]
    now = record.marks[_ORIGIN] if is_first else max(end - 1, record.marks[_ORIGIN])
    row = rows[end % len(rows)]
    encoder = WheelSpeeds(row[_LEFT], row[_RIGHT])
    twist, noise = body_twist(encoder, plant.wheels), encoder_covariance(encoder, plant.encoder_noise, plant.wheels)
    whole, separation = end - now, plant.wheels.wheel_separation
    rate = TurnRate(float(row[_RATE]), float(row[_RATE_VARIANCE]))
    slip = TwistCovariance(0.0, 0.0, 0.0)
    if whole > 0:
        slip = take_rate(arrays, Motion(twist, whole * t_s, noise, rate), separation, robot.filter)
    for stamp in range(now if is_first else end, end + 1):
        row = rows[stamp % len(rows)]
        is_fused = row[_FIX_FUSED] + row[_HEADING_FUSED] + row[_LANDMARKS_FUSED] > 0.0
        if stamp > now and (is_fused or stamp == end):
            # The twist's error is constant over the step: the variances of its parts must add up to the whole.
            share = whole / (stamp - now)
            part = scale_twist_covariance(add_twist_covariance(noise, slip), share)
            motion = Motion(twist, (stamp - now) * t_s, part, TurnRate(rate.value, share * rate.variance))
            track = advance(track, arrays, motion, separation, robot.filter)
            now = stamp
        if is_fused:
            track = _fused(track, arrays, row, NoiseKey(moment.seed, moment.run, stamp), robot)
    return track


def _fused(track: Track, arrays: Any, row: Any, moment: NoiseKey, robot: Robot) -> Track:
    """Correct with the marked measurements of one stamp."""
    if row[_FIX_FUSED] > 0.0:
        track = take_fix(track, arrays, _fix_of(row, robot.sensors), robot.filter)
    if row[_HEADING_FUSED] > 0.0:
        variance = uniform_variance(robot.sensors.heading_error_max)
        track = take_heading(track, arrays, row[_HEADING], variance, robot.filter)
    if row[_LANDMARKS_FUSED] > 0.0:
        track = take_landmarks(track, arrays, moment, _true_pose(row), robot)
    return track


def _fix_pose(row: Any) -> Pose:
    return Pose(float(row[_FIX_X]), float(row[_FIX_Y]), float(row[_FIX_THETA]))


def _true_pose(row: Any) -> Pose:
    return Pose(float(row[_X]), float(row[_Y]), float(row[_THETA]))


def _fix_of(row: Any, sensors: SensorConfig) -> PoseFix:
    var_x, var_y, var_theta = fix_variances(sensors)
    return PoseFix(_fix_pose(row), var_x, var_y, var_theta)
