"""Sensing with measurements that arrive late: the compiled counterpart of :class:`filter.localization.Localization`.

Each measurement is fused at its own stamp: the filter goes back to its state before the odometry step that contains the
stamp, and the steps since then are computed again. The ring that this needs exists only if a measurement may be late;
otherwise it is None, and the compiler leaves all of this out. A test holds the results to the class's.

Stamps are numbers of steps. The first odometry step begins at the stamp of the first fix and ends at the step at which
that fix arrives, so it may be longer than one sampling time.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.models import Motion
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import WheelSpeeds, body_twist, encoder_covariance, scale_twist_covariance
from diffbot_sim.compiled.scalar_belief import PoseFix
from diffbot_sim.compiled.scalar_filter import Track, advance, initialise, new_track, take_fix, take_heading
from diffbot_sim.compiled.sensing import Robot, observe, take_landmarks
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
_COLUMNS = 14
_ORIGIN, _FIRST_END = 0, 1
"""Stamps: of the first fix, and of the end of the first odometry step; -1 before there are any."""


class LateRecord(NamedTuple):
    """The newest steps."""

    rows: Any
    """(n, 14) a row per stamp, at stamp modulo n"""
    tracks: Any
    """n states of the filter before the odometry step that ends at a stamp; None without a filter"""
    marks: Any
    """(2,) see _ORIGIN, _FIRST_END"""


class Sensed(NamedTuple):
    """State of the sensors and of the filter."""

    track: Track | None
    """state of the filter; None without one"""
    errors: Draw
    """of the newest fix, see :func:`sensors.correlated`"""
    record: LateRecord | None
    """None if no measurement is late"""


def late_steps(sensors: SensorConfig, sampling_time: float) -> int | None:
    """Return the longest delay in steps; None if no measurement is late."""
    longest = max(
        delay_in_steps(sensors.fix_delay + sensors.fix_delay_jitter, sampling_time),
        delay_in_steps(sensors.heading_delay, sampling_time),
    )
    return longest if longest > 0 else None


def new_sensed(options: Any, steps: int | None) -> Sensed:
    """Return the state before the first step.

    Args:
        options: of the filter; None for none.
        steps: longest delay; None if no measurement is late.
    """
    track = _new_track(options)
    return Sensed(track, NO_ERRORS, _new_record(track, steps))


def sense(sensed: Sensed, moment: NoiseKey, state: PlantState, robot: Robot) -> Sensed:
    """Sense at one step, and bring the filter up to it; it must have one."""
    return _sense(sensed.record, sensed, moment, state, robot)


def _sense(record: LateRecord | None, sensed: Sensed, moment: NoiseKey, state: PlantState, robot: Robot) -> Sensed:
    """As :func:`sense`; numba leaves out a branch if an argument is None by its type."""
    if record is None:
        track, errors = observe(sensed.track, sensed.errors, moment, state, robot)
        return Sensed(track, errors, record)
    errors = record_step(record, sensed.errors, moment, state, robot.plant.sampling_time, robot.sensors)
    return Sensed(_fuse_arrivals(sensed.track, record, moment, robot), errors, record)


def _new_track(options: Any) -> Track | None:
    if options is None:
        return None
    return new_track(options)


def _new_record(track: Track | None, steps: int | None) -> LateRecord | None:
    if steps is None:
        return None
    # A late measurement may reach back into the first odometry step, which may itself be as long as the longest delay.
    number = 2 * steps + 2
    return LateRecord(np.zeros((number, _COLUMNS)), _copies(track, number), np.full(2, -1))


def _copies(track: Track | None, number: int) -> Any:
    if track is None:
        return None
    return [track for _ in range(number)]


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


def _fuse_arrivals(track: Any, record: LateRecord, moment: NoiseKey, robot: Robot) -> Any:
    """Take what arrives at this step, and compute the odometry steps from the oldest of it on."""
    rows, tracks, marks, now = record.rows, record.tracks, record.marks, moment.step
    track, oldest = _take_fixes(track, record, now, robot)
    if not track.initialised:
        return track
    oldest = min(oldest, _mark_others(record, now, robot))
    if marks[_FIRST_END] < 0 and now > marks[_ORIGIN]:
        marks[_FIRST_END] = now
    first = max(oldest, marks[_FIRST_END])
    for end in range(first, now + 1):
        if end == first and end < now:
            track = tracks[end % len(rows)]
        tracks[end % len(rows)] = track
        track = _propagated(track, record, end, moment, robot)
    if now == marks[_ORIGIN]:
        # Fused before the first odometry step, to which they therefore do not belong.
        row = rows[now % len(rows)]
        row[_HEADING_FUSED], row[_LANDMARKS_FUSED] = 0.0, 0.0
    return track


def _take_fixes(track: Any, record: LateRecord, now: int, robot: Robot) -> tuple[Any, int]:
    """Initialise with the first fix; mark later ones. Return also the oldest stamp marked, ``now`` for none."""
    rows, marks, oldest = record.rows, record.marks, now
    for stamp in range(max(now - len(rows) + 1, 0), now + 1):
        row = rows[stamp % len(rows)]
        if row[_FIX_ARRIVAL] == now:
            if not track.initialised:
                track = initialise(track, _fix_of(row, robot.sensors))
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


def _propagated(track: Any, record: LateRecord, end: int, moment: NoiseKey, robot: Robot) -> Any:
    """Compute the odometry step that ends at ``end``, with the measurements in it.

    At the stamp of the first fix itself there is none, only measurements.
    """
    rows, plant, t_s = record.rows, robot.plant, robot.plant.sampling_time
    is_first = end == record.marks[_FIRST_END]
    now = record.marks[_ORIGIN] if is_first else max(end - 1, record.marks[_ORIGIN])
    row = rows[end % len(rows)]
    encoder = WheelSpeeds(row[_LEFT], row[_RIGHT])
    twist, noise = body_twist(encoder, plant.wheels), encoder_covariance(encoder, plant.encoder_noise, plant.wheels)
    whole = end - now
    for stamp in range(now if is_first else end, end + 1):
        row = rows[stamp % len(rows)]
        is_fused = row[_FIX_FUSED] + row[_HEADING_FUSED] + row[_LANDMARKS_FUSED] > 0.0
        if stamp > now and (is_fused or stamp == end):
            # The twist's error is constant over the step: the variances of its parts must add up to the whole.
            part = scale_twist_covariance(noise, whole / (stamp - now))
            track = advance(
                track, Motion(twist, (stamp - now) * t_s, part), plant.wheels.wheel_separation, robot.filter
            )
            now = stamp
        if is_fused:
            track = _fused(track, row, NoiseKey(moment.seed, moment.run, stamp), robot)
    return track


def _fused(track: Any, row: Any, moment: NoiseKey, robot: Robot) -> Any:
    """Correct with the marked measurements of one stamp."""
    if row[_FIX_FUSED] > 0.0:
        track = take_fix(track, _fix_of(row, robot.sensors), robot.filter)
    if row[_HEADING_FUSED] > 0.0:
        variance = uniform_variance(robot.sensors.heading_error_max)
        track = take_heading(track, row[_HEADING], variance, robot.filter)
    if row[_LANDMARKS_FUSED] > 0.0:
        track = take_landmarks(track, moment, _true_pose(row), robot)
    return track


def _fix_pose(row: Any) -> Pose:
    return Pose(float(row[_FIX_X]), float(row[_FIX_Y]), float(row[_FIX_THETA]))


def _true_pose(row: Any) -> Pose:
    return Pose(float(row[_X]), float(row[_Y]), float(row[_THETA]))


def _fix_of(row: Any, sensors: SensorConfig) -> PoseFix:
    var_x, var_y, var_theta = fix_variances(sensors)
    return PoseFix(_fix_pose(row), var_x, var_y, var_theta)
