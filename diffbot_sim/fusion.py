"""Fusion of a simulated robot's measurements by the filter, including poses that arrive late.

A ring buffer keeps the newest steps. When a pose arrives late, the filter returns to its memory before the odometry
step that contains the stamp of the pose, and computes the steps since then again, as
:class:`diffbot_control.filter.localization.Localization` does. Only poses may be late.

Stamps are numbers of steps. The first odometry step begins at the stamp of the first pose and ends at the step at which
that pose arrives, so it may be longer than one sampling time.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter import ekf
from diffbot_control.filter.models import (
    BIAS,
    HEADING,
    LANDMARK,
    POSE_FIX,
    POSITION_FIX,
    UNKNOWN_HEADING,
    WHEELS,
    Motion,
    Reading,
    TurnRate,
    slip_covariance,
)
from diffbot_control.filter.state import FilterState, Options, new_filter, reset, start
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import (
    TwistCovariance,
    WheelSpeeds,
    add_twist_covariance,
    body_twist,
    encoder_covariance,
    scale_twist_covariance,
)
from diffbot_core.uncertainty import CERTAIN, Uncertainty, largest_deviation
from diffbot_sim.config import PlantConfig, SensorConfig
from diffbot_sim.plant import PlantState, command_rows
from diffbot_sim.sensors import (
    GYRO_ERROR_MAX,
    FixErrors,
    claimed_noise,
    delay_in_steps,
    in_range,
    is_due,
    is_gyro_due,
    is_pose_due,
    measured_heading,
    measured_landmark,
    measured_pose,
    measured_turn_rate,
    pose_delay,
    uniform_variance,
)

_FIXES, _HEADINGS, _LANDMARKS, _FIRST_LANDMARK = range(4)
"""Rows of the filter's sources. From _FIRST_LANDMARK on, each landmark has a row of its own."""
_LEFT, _RIGHT, _RATE, _RATE_VARIANCE, _X, _Y, _THETA, _HAS_POSE = range(8)
_USE_POSE, _HEADING, _USE_HEADING, _USE_LANDMARKS = range(8, 12)
"""Columns of a step: mean speeds of the encoders over the step that ends there [rad/s]; turn rate of the gyro over that
step and its variance, inf without a gyro; measured pose, 1 if there is one; measured heading. Columns _USE_... are 1 if
the filter fuses the measurement."""
_ORIGIN, _FIRST_END = 0, 1
"""Indices of ``RunBuffers.stamps``: stamp of the first pose, and end of the first odometry step; -1 until known."""


class SimulatedRobot(NamedTuple):
    """Plant, sensors, filter and landmarks of a simulated robot."""

    plant: PlantConfig
    sensors: SensorConfig
    filter: Options
    landmarks: Any
    """(n, 2) positions x, y [m]"""


class RunBuffers(NamedTuple):
    """The robot, and arrays that a run changes in place. The caller keeps them and may use them for many runs."""

    robot: SimulatedRobot

    commands: Any
    """(n, 2) ring buffer of :func:`plant.delayed_command`"""
    steps: Any
    """(n, 12) ring buffer of the newest steps, each in the row of its stamp modulo n"""
    landmark_readings: Any
    """(n, landmarks, 3) for each of these steps: range [m], bearing [rad], 1 if the landmark was measured"""
    memory: Any
    """(n, m) for each of these steps: memory of the filter before the odometry step that ends there"""
    stamps: Any
    """(2,) stamps at the indices _ORIGIN and _FIRST_END"""
    filter: FilterState


def new_buffers(robot: SimulatedRobot) -> RunBuffers:
    """Return the buffers that runs of ``robot`` need."""
    plant, landmarks = robot.plant, len(robot.landmarks)
    late = delay_in_steps(pose_delay(robot.sensors), plant.sampling_time)
    # A late pose may reach back into the first odometry step, which may itself be as long as the delay.
    n = 2 * late + 2 if late > 0 else 1
    filter_ = new_filter(robot.filter, landmarks)
    return RunBuffers(
        robot,
        np.zeros((command_rows(plant.command_delay, plant.sampling_time), 2)),
        np.zeros((n, 12)),
        np.zeros((n, landmarks, 3)),
        np.zeros((n if late > 0 else 0, len(filter_.memory))),
        np.zeros(2, dtype=np.int64),
        filter_,
    )


def reference_to(buffers: RunBuffers) -> RunBuffers:
    """Return ``buffers``. Compiled code gets a reference, see :mod:`references`; the caller must keep the arrays."""
    return buffers


def borrowed(array: Any) -> Any:
    """Return ``array``. Compiled code gets a view without reference counting, so the caller must keep the array."""
    return array


def clear(buffers: RunBuffers) -> None:
    """Clear all steps and reset the filter."""
    buffers.commands[:] = 0.0
    buffers.steps[:] = 0.0
    buffers.stamps[:] = -1
    reset(buffers.filter, buffers.robot.filter)


def record_step(buffers: RunBuffers, plant: PlantState, errors: FixErrors, noise: Any) -> FixErrors:
    """Measure at the present step and store the measurements; return the errors of the newest fix."""
    robot = buffers.robot
    sensors, t_s, now = robot.sensors, robot.plant.sampling_time, plant.step
    row = buffers.steps[now % len(buffers.steps)]
    row[:] = 0.0
    row[_LEFT], row[_RIGHT], row[_RATE_VARIANCE] = plant.encoder.left, plant.encoder.right, math.inf
    if is_gyro_due(now, sensors, t_s):
        row[_RATE] = measured_turn_rate(plant.twist.omega, noise, sensors)
        row[_RATE_VARIANCE] = uniform_variance(GYRO_ERROR_MAX)
    if is_pose_due(now, sensors, t_s):
        fix = measured_pose(plant.pose, errors, noise, sensors)
        errors = fix.errors
        row[_X], row[_Y], row[_THETA] = fix.pose
        row[_HAS_POSE] = 0.0 if fix.lost else 1.0
    if is_due(now, sensors.heading_rate, t_s):
        row[_HEADING], row[_USE_HEADING] = measured_heading(plant.pose, noise, sensors), 1.0
    if is_due(now, sensors.landmark_rate, t_s):
        row[_USE_LANDMARKS] = 1.0
        found = buffers.landmark_readings[now % len(buffers.landmark_readings)]
        for index in range(len(robot.landmarks)):
            x, y = float(robot.landmarks[index, 0]), float(robot.landmarks[index, 1])
            found[index, 2] = 0.0
            if in_range(plant.pose, x, y, sensors):
                found[index, 0], found[index, 1] = measured_landmark(plant.pose, index, x, y, noise, sensors)
                found[index, 2] = 1.0
    return errors


def arriving_pose(buffers: RunBuffers, now: int) -> int:
    """Return the stamp of the pose that arrives now, -1 if none arrives."""
    robot = buffers.robot
    stamp = now - delay_in_steps(pose_delay(robot.sensors), robot.plant.sampling_time)
    return stamp if stamp >= 0 and buffers.steps[stamp % len(buffers.steps), _HAS_POSE] > 0.0 else -1


def pose_at(buffers: RunBuffers, stamp: int) -> Pose:
    """Return the pose that was measured at ``stamp``."""
    row = buffers.steps[stamp % len(buffers.steps)]
    return Pose(float(row[_X]), float(row[_Y]), float(row[_THETA]))


def estimate(buffers: RunBuffers, now: int) -> tuple[bool, Pose, Uncertainty]:
    """Update the filter to the present step; return True if it has a pose, the pose, and the pose's uncertainty."""
    if not fuse(buffers, now):
        return False, Pose(0.0, 0.0, 0.0), CERTAIN
    x, P = ekf.average(buffers.filter, buffers.robot.filter)
    sigma = largest_deviation(float(P[0, 0]), float(P[0, 1]), float(P[1, 1]))
    return True, Pose(float(x[0]), float(x[1]), float(x[2])), Uncertainty(sigma, math.sqrt(max(float(P[2, 2]), 0.0)))


def fuse(buffers: RunBuffers, now: int) -> bool:
    """Update the filter to the present step with all arriving measurements; return True if it has a pose."""
    filter_, stamps, n, arrived = buffers.filter, buffers.stamps, len(buffers.steps), arriving_pose(buffers, now)
    first = now
    if arrived >= 0 and stamps[_ORIGIN] < 0:
        _start(filter_, pose_at(buffers, arrived), buffers.robot.sensors)
        stamps[_ORIGIN] = arrived
    elif arrived >= 0:
        buffers.steps[arrived % n, _USE_POSE] = 1.0
        first = arrived
    if stamps[_ORIGIN] < 0:
        # Measurements before the first pose are dropped.
        buffers.steps[now % n, _USE_HEADING] = buffers.steps[now % n, _USE_LANDMARKS] = 0.0
        return False
    if stamps[_FIRST_END] < 0 and now > stamps[_ORIGIN]:
        stamps[_FIRST_END] = now
    first = max(first, stamps[_FIRST_END])
    for end in range(first, now + 1):
        if len(buffers.memory) > 0:
            if end == first and end < now:
                filter_.memory[:] = buffers.memory[end % n]
            else:
                buffers.memory[end % n] = filter_.memory
        if end > stamps[_ORIGIN]:
            _odometry_step(buffers, end)
        else:
            _fuse_stamp(buffers, end)
    return True


def _start(filter_: FilterState, pose: Pose, sensors: SensorConfig) -> None:
    """Start the filter at the first pose. An unknown heading is set to 0."""
    P = _covariance(pose, sensors)
    if P[2, 2] >= UNKNOWN_HEADING:
        P[2, :] = 0.0
        P[:, 2] = 0.0
        P[2, 2], pose = UNKNOWN_HEADING, Pose(pose.x, pose.y, 0.0)
    start(filter_, pose, P)


def _odometry_step(buffers: RunBuffers, end: int) -> None:
    """Predict over the odometry step that ends at ``end``, and fuse the measurements within it at their stamps."""
    filter_, options, plant = buffers.filter, buffers.robot.filter, buffers.robot.plant
    t_s = plant.sampling_time
    row, stamps = buffers.steps[end % len(buffers.steps)], buffers.stamps
    begin = stamps[_ORIGIN] if end == stamps[_FIRST_END] else end - 1
    encoder = WheelSpeeds(float(row[_LEFT]), float(row[_RIGHT]))
    twist = body_twist(encoder, plant.wheels)
    covariance = encoder_covariance(encoder, plant.encoder_noise, plant.wheels)
    value, variance = float(row[_RATE]), float(row[_RATE_VARIANCE])
    slip = TwistCovariance(0.0, 0.0, 0.0)
    if options.variances[BIAS - WHEELS] > 0.0 and variance < math.inf:
        whole = Motion(twist, (end - begin) * t_s, covariance, TurnRate(value, variance), 0.0)
        slip = slip_covariance(ekf.take_rate(filter_, options, whole), options.separation)
    else:
        variance = math.inf
    now = begin
    for stamp in range(begin + 1, end + 1):
        measured = buffers.steps[stamp % len(buffers.steps)]
        if stamp == end or measured[_USE_POSE] + measured[_USE_HEADING] + measured[_USE_LANDMARKS] > 0.0:
            # The twist's error is constant over the step. The share scales the covariances of the parts of the step so
            # that they add up to the covariance of the whole step.
            share, dt = (end - begin) / (stamp - now), (stamp - now) * t_s
            part = scale_twist_covariance(add_twist_covariance(covariance, slip), share)
            ekf.predict(filter_, options, Motion(twist, dt, part, TurnRate(value, share * variance), 0.0))
            now = stamp
        _fuse_stamp(buffers, stamp)


def _fuse_stamp(buffers: RunBuffers, stamp: int) -> None:
    """Fuse the measurements of one stamp."""
    robot, filter_ = buffers.robot, buffers.filter
    options, sensors = robot.filter, robot.sensors
    row, time = buffers.steps[stamp % len(buffers.steps)], stamp * robot.plant.sampling_time
    no_landmark = Point(0.0, 0.0)
    if row[_USE_POSE] > 0.0:
        z, R, kind = row[_X : _THETA + 1].copy(), _covariance(pose_at(buffers, stamp), sensors), POSE_FIX
        if R[2, 2] >= UNKNOWN_HEADING:
            z, R, kind = z[:2].copy(), R[:2, :2].copy(), POSITION_FIX
        ekf.take(filter_, options, Reading(kind, _FIXES, _FIXES, time, z, R, no_landmark))
    if row[_USE_HEADING] > 0.0:
        R = np.full((1, 1), uniform_variance(sensors.heading_error_max))
        z = row[_HEADING : _HEADING + 1].copy()
        ekf.take(filter_, options, Reading(HEADING, _HEADINGS, _HEADINGS, time, z, R, no_landmark))
    if row[_USE_LANDMARKS] > 0.0:
        found = buffers.landmark_readings[stamp % len(buffers.landmark_readings)]
        for index in range(len(found)):
            if found[index, 2] > 0.0:
                R = np.zeros((2, 2))
                R[0, 0] = uniform_variance(sensors.landmark_range_error_max)
                R[1, 1] = uniform_variance(sensors.landmark_bearing_error_max)
                at = Point(float(robot.landmarks[index, 0]), float(robot.landmarks[index, 1]))
                z = found[index, :2].copy()
                ekf.take(filter_, options, Reading(LANDMARK, _LANDMARKS, _FIRST_LANDMARK + index, time, z, R, at))


def _covariance(pose: Pose, sensors: SensorConfig) -> Any:
    """Return the covariance (3, 3) that a measured pose claims."""
    claimed, R = claimed_noise(pose, sensors), np.empty((3, 3))
    R[0, 0], R[1, 1], R[2, 2] = claimed.xx, claimed.yy, claimed.tt
    R[0, 1] = R[1, 0] = claimed.xy
    R[0, 2] = R[2, 0] = claimed.xt
    R[1, 2] = R[2, 1] = claimed.yt
    return R
