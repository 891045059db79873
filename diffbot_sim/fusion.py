"""Measurements of a simulated robot and the filter that fuses them, late ones at their own stamps.

The newest steps are kept in a ring. A pose that arrives late takes the filter back to its memory before the odometry
step that contains the stamp of the pose, and the steps since then are computed again, as
:class:`diffbot_control.filter.localization.Localization` does. Poses are the only measurements that may be late.

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
    due,
    in_range,
    is_pose_due,
    measured_heading,
    measured_landmark,
    measured_pose,
    measured_rate,
    pose_delay,
    rate_due,
    uniform_variance,
)

_FIXES, _HEADINGS, _LANDMARKS, _SOURCES = 0, 1, 2, 3
"""Rows of the filter's sources, and their number."""
_LEFT, _RIGHT, _RATE, _RATE_VARIANCE, _X, _Y, _THETA, _HAS_POSE, _POSE_IN, _HEADING, _HEADING_IN, _SEEN_IN = range(12)
"""Columns of a step: speeds of the encoders over the step that ends there [rad/s]; turn rate of the gyro over it and
its variance, inf for none; measured pose, 1 if there is one; heading. Columns ..._IN are 1 if the filter has fused what
they belong to."""
_UNKNOWN_HEADING = math.pi**2
"""[rad^2] variance of a heading of which nothing is known"""
_ORIGIN, _FIRST_END = 0, 1
"""Stamps of the first pose, and of the end of the first odometry step; -1 before there are any."""


class Robot(NamedTuple):
    """Configuration that determines motion, measurements and estimate of a run."""

    plant: PlantConfig
    sensors: SensorConfig
    filter: Options
    landmarks: Any
    """(n, 2) array of their x, y [m]"""


class Recent(NamedTuple):
    """The robot's configuration, and arrays that a run changes in place. The caller of a run keeps them."""

    robot: Robot

    commands: Any
    """(n, 2) see :func:`plant.delayed_command`"""
    steps: Any
    """(n, 12) ring of the newest steps, each at its stamp modulo n"""
    seen: Any
    """(n, landmarks, 3) the same of landmarks: range [m], bearing [rad], 1 if it was measured"""
    memory: Any
    """(n, m) the same of the filter's memory before the odometry step that ends there"""
    stamps: Any
    """(2,)"""
    filter: FilterState


def new_recent(robot: Robot) -> Recent:
    """Return the arrays that runs of ``robot`` need."""
    plant, landmarks = robot.plant, len(robot.landmarks)
    late = delay_in_steps(pose_delay(robot.sensors), plant.sampling_time)
    # A late pose may reach back into the first odometry step, which may itself be as long as the delay.
    n = 2 * late + 2 if late > 0 else 1
    filter_ = new_filter(robot.filter, landmarks)
    return Recent(
        robot,
        np.zeros((command_rows(plant.command_delay, plant.sampling_time), 2)),
        np.zeros((n, 12)),
        np.zeros((n, landmarks, 3)),
        np.zeros((n if late > 0 else 0, len(filter_.memory))),
        np.zeros(2, dtype=np.int64),
        filter_,
    )


def referred(recent: Recent) -> Recent:
    """Return ``recent`` itself. Compiled code gets a reference to it; the caller has to keep its arrays."""
    return recent


def borrowed(array: Any) -> Any:
    """Return ``array`` itself. Compiled code gets one that does not count its users; the caller has to keep it."""
    return array


def forget(recent: Recent) -> None:
    """Forget all steps."""
    recent.commands[:] = 0.0
    recent.steps[:] = 0.0
    recent.stamps[:] = -1
    reset(recent.filter, recent.robot.filter)


def record_step(recent: Recent, state: PlantState, errors: FixErrors, noise: Any) -> FixErrors:
    """Measure at the present step and keep it; return the errors of the newest fix."""
    robot = recent.robot
    sensors, t_s, now = robot.sensors, robot.plant.sampling_time, state.step
    row = recent.steps[now % len(recent.steps)]
    row[:] = 0.0
    row[_LEFT], row[_RIGHT], row[_RATE_VARIANCE] = state.encoder.left, state.encoder.right, math.inf
    if rate_due(now, sensors, t_s):
        row[_RATE] = measured_rate(state.twist.omega, noise, sensors)
        row[_RATE_VARIANCE] = uniform_variance(GYRO_ERROR_MAX)
    if is_pose_due(now, sensors, t_s):
        fix = measured_pose(state.pose, errors, noise, sensors)
        errors = fix.errors
        row[_X], row[_Y], row[_THETA] = fix.pose
        row[_HAS_POSE] = 0.0 if fix.lost else 1.0
    if due(now, sensors.heading_rate, t_s):
        row[_HEADING], row[_HEADING_IN] = measured_heading(state.pose, noise, sensors), 1.0
    if due(now, sensors.landmark_rate, t_s):
        row[_SEEN_IN] = 1.0
        seen = recent.seen[now % len(recent.seen)]
        for index in range(len(robot.landmarks)):
            x, y = float(robot.landmarks[index, 0]), float(robot.landmarks[index, 1])
            seen[index, 2] = 0.0
            if in_range(state.pose, x, y, sensors):
                seen[index, 0], seen[index, 1] = measured_landmark(state.pose, index, x, y, noise, sensors)
                seen[index, 2] = 1.0
    return errors


def arriving_pose(recent: Recent, now: int) -> int:
    """Return the stamp of the pose that arrives now, -1 for none."""
    robot = recent.robot
    stamp = now - delay_in_steps(pose_delay(robot.sensors), robot.plant.sampling_time)
    return stamp if stamp >= 0 and recent.steps[stamp % len(recent.steps), _HAS_POSE] > 0.0 else -1


def pose_at(recent: Recent, stamp: int) -> Pose:
    """Return the pose that was measured at a step."""
    row = recent.steps[stamp % len(recent.steps)]
    return Pose(float(row[_X]), float(row[_Y]), float(row[_THETA]))


def estimate(recent: Recent, now: int) -> tuple[bool, Pose, Uncertainty]:
    """Bring the filter up to the present step; return True if it has a pose, the pose, and how well it is known."""
    if not fuse(recent, now):
        return False, Pose(0.0, 0.0, 0.0), CERTAIN
    x, P = ekf.average(recent.filter, recent.robot.filter)
    sigma = largest_deviation(float(P[0, 0]), float(P[0, 1]), float(P[1, 1]))
    return True, Pose(float(x[0]), float(x[1]), float(x[2])), Uncertainty(sigma, math.sqrt(max(float(P[2, 2]), 0.0)))


def fuse(recent: Recent, now: int) -> bool:
    """Bring the filter up to the present step with all that arrives at it; return True if it has a pose."""
    filter_, stamps, n, arrived = recent.filter, recent.stamps, len(recent.steps), arriving_pose(recent, now)
    first = now
    if arrived >= 0 and stamps[_ORIGIN] < 0:
        _start(filter_, pose_at(recent, arrived), recent.robot.sensors)
        stamps[_ORIGIN] = arrived
    elif arrived >= 0:
        recent.steps[arrived % n, _POSE_IN] = 1.0
        first = arrived
    if stamps[_ORIGIN] < 0:
        # What is measured before the first pose is dropped.
        recent.steps[now % n, _HEADING_IN] = recent.steps[now % n, _SEEN_IN] = 0.0
        return False
    if stamps[_FIRST_END] < 0 and now > stamps[_ORIGIN]:
        stamps[_FIRST_END] = now
    first = max(first, stamps[_FIRST_END])
    for end in range(first, now + 1):
        if len(recent.memory) > 0:
            if end == first and end < now:
                filter_.memory[:] = recent.memory[end % n]
            else:
                recent.memory[end % n] = filter_.memory
        if end > stamps[_ORIGIN]:
            _odometry_step(recent, end)
        else:
            _fuse_stamp(recent, end)
    return True


def _start(filter_: FilterState, pose: Pose, sensors: SensorConfig) -> None:
    """Put the filter at the first pose; a heading of which nothing is known is 0."""
    P = _covariance(pose, sensors)
    if P[2, 2] >= _UNKNOWN_HEADING:
        P[2, :] = 0.0
        P[:, 2] = 0.0
        P[2, 2], pose = _UNKNOWN_HEADING, Pose(pose.x, pose.y, 0.0)
    start(filter_, pose, P)


def _odometry_step(recent: Recent, end: int) -> None:
    """Compute the odometry step that ends at ``end``, with the measurements in it."""
    filter_, options, plant = recent.filter, recent.robot.filter, recent.robot.plant
    t_s = plant.sampling_time
    row, stamps = recent.steps[end % len(recent.steps)], recent.stamps
    begin = stamps[_ORIGIN] if end == stamps[_FIRST_END] else end - 1
    encoder = WheelSpeeds(float(row[_LEFT]), float(row[_RIGHT]))
    twist, covariance = (
        body_twist(encoder, plant.wheels),
        encoder_covariance(encoder, plant.encoder_noise, plant.wheels),
    )
    value, variance = float(row[_RATE]), float(row[_RATE_VARIANCE])
    slip = TwistCovariance(0.0, 0.0, 0.0)
    if options.variances[BIAS - WHEELS] > 0.0 and variance < math.inf:
        whole = Motion(twist, (end - begin) * t_s, covariance, TurnRate(value, variance), 0.0)
        slip = slip_covariance(ekf.take_rate(filter_, options, whole), options.separation)
    else:
        variance = math.inf
    now = begin
    for stamp in range(begin + 1, end + 1):
        measured = recent.steps[stamp % len(recent.steps)]
        if stamp == end or measured[_POSE_IN] + measured[_HEADING_IN] + measured[_SEEN_IN] > 0.0:
            # The twist's error is constant over the step: the variances of its parts must add up to the whole.
            share, dt = (end - begin) / (stamp - now), (stamp - now) * t_s
            part = scale_twist_covariance(add_twist_covariance(covariance, slip), share)
            ekf.predict(filter_, options, Motion(twist, dt, part, TurnRate(value, share * variance), 0.0))
            now = stamp
        _fuse_stamp(recent, stamp)


def _fuse_stamp(recent: Recent, stamp: int) -> None:
    """Correct with the measurements of one stamp that belong to the history."""
    robot, filter_ = recent.robot, recent.filter
    options, sensors = robot.filter, robot.sensors
    row, time, nowhere = recent.steps[stamp % len(recent.steps)], stamp * robot.plant.sampling_time, Point(0.0, 0.0)
    if row[_POSE_IN] > 0.0:
        z, R, kind = row[_X : _THETA + 1].copy(), _covariance(pose_at(recent, stamp), sensors), POSE_FIX
        if R[2, 2] >= _UNKNOWN_HEADING:
            z, R, kind = z[:2].copy(), R[:2, :2].copy(), POSITION_FIX
        ekf.take(filter_, options, Reading(kind, _FIXES, _FIXES, time, z, R, nowhere))
    if row[_HEADING_IN] > 0.0:
        R = np.full((1, 1), uniform_variance(sensors.heading_error_max))
        z = row[_HEADING : _HEADING + 1].copy()
        ekf.take(filter_, options, Reading(HEADING, _HEADINGS, _HEADINGS, time, z, R, nowhere))
    if row[_SEEN_IN] > 0.0:
        seen = recent.seen[stamp % len(recent.seen)]
        for index in range(len(seen)):
            if seen[index, 2] > 0.0:
                R = np.zeros((2, 2))
                R[0, 0] = uniform_variance(sensors.landmark_range_error_max)
                R[1, 1] = uniform_variance(sensors.landmark_bearing_error_max)
                at, place = Point(float(robot.landmarks[index, 0]), float(robot.landmarks[index, 1])), _SOURCES + index
                z = seen[index, :2].copy()
                ekf.take(filter_, options, Reading(LANDMARK, _LANDMARKS, place, time, z, R, at))


def _covariance(pose: Pose, sensors: SensorConfig) -> Any:
    """Return the covariance (3, 3) that a measured pose claims."""
    claimed, R = claimed_noise(pose, sensors), np.empty((3, 3))
    R[0, 0], R[1, 1], R[2, 2] = claimed.xx, claimed.yy, claimed.tt
    R[0, 1] = R[1, 0] = claimed.xy
    R[0, 2] = R[2, 0] = claimed.xt
    R[1, 2] = R[2, 1] = claimed.yt
    return R
