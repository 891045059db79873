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
from diffbot_sim.compiled.ekf import GYRO, WHEELS
from diffbot_sim.compiled.gated_filter import (
    PoseFix,
    Track,
    advance,
    copy_kept,
    filter_type,
    initialise,
    kept_type,
    new_track,
    seen_type,
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
    claimed_noise,
    delay_in_steps,
    due,
    heading_at,
    is_pose_due,
    measured_pose_at,
    uniform_variance,
)

_NUMBERS = (
    *("x", "y", "theta"),  # true pose
    *("left", "right"),  # speeds of the encoders over the step that ends there [rad/s]
    *("rate", "rate_variance"),  # of the gyro over that step; the variance is inf for none
    *("fix_x", "fix_y", "fix_theta", "fix_arrival", "fix_fused"),
    *("heading", "heading_arrival", "heading_fused", "landmarks_fused"),
)
"""What is known of a step. An arrival is the step at which a measurement arrives, -1 for none; fused is 1 from when it
belongs to the odometry steps."""
_STAMPS = np.dtype([("origin", np.int64), ("first_end", np.int64)])
"""of the first fix, and of the end of the first odometry step; -1 before there are any"""


def step_type(n: int) -> Any:
    """Return the type of a step's record: _NUMBERS, and what the filter keeps before the odometry step that ends there.

    ``n`` is the number of the filter's states.
    """
    return np.dtype([(name, float) for name in _NUMBERS] + kept_type(n).descr)


class Example(NamedTuple):
    """Empty arrays of the types that a run works with."""

    filter: Any
    """of :func:`gated_filter.filter_type`"""
    step: Any
    """of :func:`step_type`"""
    seen: Any
    """of :func:`gated_filter.seen_type`"""


def _example_of(n: int) -> Example:
    return Example(np.empty(0, filter_type(n)), np.empty(0, step_type(n)), np.empty(0, seen_type(n)))


WITH_WHEELS, WITH_SENSORS = _example_of(WHEELS), _example_of(GYRO)
"""With the errors of the wheels as states, and with those of landmarks and gyro, too."""


def example_for(landmarks: Any, options: FilterOptions) -> Example:
    """Return what a map (n, 2) of ``landmarks`` and the options of the filter need."""
    return WITH_SENSORS if len(landmarks) or options.gyro_bias_variance > 0.0 else WITH_WHEELS


class LateRecord(NamedTuple):
    """The newest n steps, each at its stamp modulo n; n is 0 if no measurement is late."""

    steps: Any
    """(n,) of :func:`step_type`"""
    tracks: Any
    """n states of the filter that belong to these"""
    stamps: Any
    """record of _STAMPS"""
    seen: Any
    """(n + 1, l) newest measurements of the landmarks that belong to these; the last row is of the present state"""


class Buffers(NamedTuple):
    """Arrays whose records are changed in place; whoever lets a run use them keeps them."""

    filter: Any
    """(1,) of :func:`gated_filter.filter_type`"""
    steps: Any
    """as in :class:`LateRecord`"""
    tracks: Any
    stamps: Any
    """(1,)"""
    seen: Any


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
        delay_in_steps(sensors.detector.detection_delay, sampling_time) if sensors.detector.detection_rate > 0.0 else 0,
    )


def new_sensed() -> Sensed:
    """Return the state before the first step."""
    return Sensed(new_track(), NO_ERRORS)


def new_buffers(steps: int, landmarks: int, example: Example) -> Buffers:
    """Return arrays like those of ``example``.

    Args:
        steps: the longest delay, 0 if no measurement is late.
        landmarks: number of landmarks.
        example: of the types.
    """
    # A late measurement may reach back into the first odometry step, which may itself be as long as the longest delay.
    n = 2 * steps + 2 if steps > 0 else 0
    tracks = [new_track() for _ in range(n)]
    filters, kept = np.zeros(1, example.filter.dtype), np.zeros(n, example.step.dtype)
    return Buffers(filters, kept, tracks, np.zeros(1, _STAMPS), np.zeros((n + 1, landmarks), example.seen.dtype))


def reset_record(record: LateRecord) -> None:
    """Forget everything before the first fix."""
    record.stamps["origin"] = record.stamps["first_end"] = -1


def sense(sensed: Sensed, arrays: Any, record: LateRecord, moment: NoiseKey, state: PlantState, robot: Robot) -> Sensed:
    """Sense at one step, and bring the filter, with its ``arrays``, up to it."""
    if len(record.steps) == 0:
        track, errors = observe(sensed.track, arrays, record.seen[0], sensed.errors, moment, state, robot)
        return Sensed(track, errors)
    errors = record_step(record, sensed.errors, moment, state, robot.plant.sampling_time, robot.sensors)
    return Sensed(_fuse_arrivals(sensed.track, arrays, record, moment, robot), errors)


def record_step(
    record: LateRecord, errors: Draw, moment: NoiseKey, state: PlantState, sampling_time: float, sensors: SensorConfig
) -> Draw:
    """Write down what is measured at this step and when it will arrive; return the errors of the newest fix."""
    number = moment.step
    step = record.steps[number % len(record.steps)]
    step["x"], step["y"], step["theta"] = state.pose.x, state.pose.y, state.pose.theta
    step["left"], step["right"] = state.encoder.left, state.encoder.right
    step["fix_arrival"], step["heading_arrival"] = -1.0, -1.0
    step["fix_fused"], step["heading_fused"], step["landmarks_fused"] = 0.0, 0.0, 0.0
    step["rate"], step["rate_variance"] = measured_rate(moment, state.twist.omega, sampling_time, sensors)
    if is_pose_due(number, sensors, sampling_time):
        fix = measured_pose_at(moment, state.pose, errors, sensors)
        errors = fix.errors
        if not fix.lost:
            step["fix_x"], step["fix_y"], step["fix_theta"] = fix.pose.x, fix.pose.y, fix.pose.theta
            step["fix_arrival"] = number + delay_in_steps(fix.delay, sampling_time)
    if due(number, sensors.heading_rate, sampling_time):
        step["heading"] = heading_at(moment, state.pose, sensors)
        step["heading_arrival"] = number + delay_in_steps(sensors.heading_delay, sampling_time)
    return errors


def arrived_fix(record: LateRecord, now: int, before: Pose, known: bool) -> tuple[Pose, bool]:
    """Return the fix that arrived last, and True if there is one; ``before`` and ``known`` if none arrives now."""
    steps = record.steps
    for stamp in range(max(now - len(steps) + 1, 0), now + 1):
        step = steps[stamp % len(steps)]
        if step["fix_arrival"] == now:
            before, known = _fix_pose(step), True
    return before, known


def _fuse_arrivals(track: Track, arrays: Any, record: LateRecord, moment: NoiseKey, robot: Robot) -> Track:
    """Take what arrives at this step, and compute the odometry steps from the oldest of it on."""
    steps, stamps, now = record.steps, record.stamps, moment.step
    track, oldest = _take_fixes(track, arrays, record, now, robot)
    if not track.initialised:
        return track
    oldest = min(oldest, _mark_others(record, now, robot))
    if stamps["first_end"] < 0 and now > stamps["origin"]:
        stamps["first_end"] = now
    first = max(oldest, stamps["first_end"])
    for end in range(first, now + 1):
        step = steps[end % len(steps)]
        if end == first and end < now:
            track = record.tracks[end % len(steps)]
            copy_kept(arrays, step)
            _copy_seen(record, len(steps), end % len(steps), robot.filter)
        record.tracks[end % len(steps)] = track
        copy_kept(step, arrays)
        _copy_seen(record, end % len(steps), len(steps), robot.filter)
        track = _propagated(track, arrays, record, end, moment, robot)
    if now == stamps["origin"]:
        # Fused before the first odometry step, to which they therefore do not belong.
        step = steps[now % len(steps)]
        step["heading_fused"], step["landmarks_fused"] = 0.0, 0.0
    return track


def _copy_seen(record: LateRecord, target: int, source: int, options: FilterOptions) -> None:
    """Overwrite a row of the newest measurements of the landmarks with another one."""
    if options.detects_landmark_correlation:
        for index in range(record.seen.shape[1]):
            record.seen[target, index] = record.seen[source, index]


def _take_fixes(track: Track, arrays: Any, record: LateRecord, now: int, robot: Robot) -> tuple[Track, int]:
    """Initialise with the first fix; mark later ones. Return also the oldest stamp marked, ``now`` for none."""
    steps, stamps, oldest = record.steps, record.stamps, now
    for stamp in range(max(now - len(steps) + 1, 0), now + 1):
        step = steps[stamp % len(steps)]
        if step["fix_arrival"] == now:
            if not track.initialised:
                track = initialise(track, arrays, _fix_of(step, robot.sensors))
                stamps["origin"] = stamp
            elif stamp > stamps["origin"]:
                step["fix_fused"] = 1.0
                oldest = min(oldest, stamp)
    return track, oldest


def _mark_others(record: LateRecord, now: int, robot: Robot) -> int:
    """Mark the headings and landmarks that arrive; return the oldest stamp marked, ``now`` for none."""
    steps, oldest = record.steps, now
    for stamp in range(max(now - len(steps) + 1, record.stamps["origin"]), now + 1):
        step = steps[stamp % len(steps)]
        if step["heading_arrival"] == now:
            step["heading_fused"] = 1.0
            oldest = min(oldest, stamp)
    if due(now, robot.sensors.landmark_rate, robot.plant.sampling_time):
        steps[now % len(steps)]["landmarks_fused"] = 1.0
    return oldest


def _propagated(track: Track, arrays: Any, record: LateRecord, end: int, moment: NoiseKey, robot: Robot) -> Track:
    """Compute the odometry step that ends at ``end``, with the measurements in it.

    At the stamp of the first fix itself there is none, only measurements.
    """
    steps, plant, t_s = record.steps, robot.plant, robot.plant.sampling_time
    origin = record.stamps["origin"]
    is_first = end == record.stamps["first_end"]
    now = origin if is_first else max(end - 1, origin)
    step = steps[end % len(steps)]
    encoder = WheelSpeeds(step["left"], step["right"])
    twist, noise = body_twist(encoder, plant.wheels), encoder_covariance(encoder, plant.encoder_noise, plant.wheels)
    whole, separation = end - now, plant.wheels.wheel_separation
    rate = TurnRate(float(step["rate"]), float(step["rate_variance"]))
    slip = TwistCovariance(0.0, 0.0, 0.0)
    if whole > 0:
        track, slip = take_rate(track, arrays, Motion(twist, whole * t_s, noise, rate), separation, robot.filter)
    for stamp in range(now if is_first else end, end + 1):
        step = steps[stamp % len(steps)]
        is_fused = step["fix_fused"] + step["heading_fused"] + step["landmarks_fused"] > 0.0
        if stamp > now and (is_fused or stamp == end):
            # The twist's error is constant over the step: the variances of its parts must add up to the whole.
            share = whole / (stamp - now)
            part = scale_twist_covariance(add_twist_covariance(noise, slip), share)
            motion = Motion(twist, (stamp - now) * t_s, part, TurnRate(rate.value, share * rate.variance))
            track = advance(track, arrays, motion, separation, robot.filter)
            now = stamp
        if is_fused:
            key = NoiseKey(moment.seed, moment.run, stamp)
            track = _fused(track, arrays, record.seen[len(steps)], step, key, robot)
    return track


def _fused(track: Track, arrays: Any, seen: Any, step: Any, moment: NoiseKey, robot: Robot) -> Track:
    """Correct with the marked measurements of one stamp."""
    if step["fix_fused"] > 0.0:
        track = take_fix(track, arrays, _fix_of(step, robot.sensors), robot.filter)
    if step["heading_fused"] > 0.0:
        variance = uniform_variance(robot.sensors.heading_error_max)
        track = take_heading(track, arrays, step["heading"], variance, robot.filter)
    if step["landmarks_fused"] > 0.0:
        true_pose = Pose(float(step["x"]), float(step["y"]), float(step["theta"]))
        track = take_landmarks(track, arrays, seen, moment, true_pose, robot)
    return track


def _fix_pose(step: Any) -> Pose:
    return Pose(float(step["fix_x"]), float(step["fix_y"]), float(step["fix_theta"]))


def _fix_of(step: Any, sensors: SensorConfig) -> PoseFix:
    pose = _fix_pose(step)
    return PoseFix(pose, claimed_noise(pose, sensors))
