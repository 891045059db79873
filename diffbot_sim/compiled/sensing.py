"""Sensing and filtering at one step of a simulation with plain numbers only, in the order of the graph."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diffbot_control.filter.models import Motion, TurnRate
from diffbot_control.filter.options import FilterOptions
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import add_twist_covariance, body_twist, encoder_covariance
from diffbot_sim.compiled.gated_filter import (
    LandmarkMeasurement,
    PoseFix,
    Track,
    advance,
    take_fix,
    take_heading,
    take_landmark,
    take_rate,
)
from diffbot_sim.model.philox import Draw, NoiseKey
from diffbot_sim.model.plant import PlantConfig, PlantState
from diffbot_sim.model.sensors import (
    SensorConfig,
    claimed_noise,
    due,
    heading_at,
    in_range,
    is_pose_due,
    landmark_at,
    landmark_variances,
    measured_pose_at,
    turn_rate_at,
    turn_rate_due,
    uniform_variance,
)


class Robot(NamedTuple):
    """Configuration that determines the measurements of a run."""

    plant: PlantConfig
    sensors: SensorConfig
    filter: FilterOptions
    landmarks: Any
    """(n, 2) array of their x, y [m]"""


def observe(
    track: Track, arrays: Any, seen: Any, errors: Draw, moment: NoiseKey, state: PlantState, robot: Robot
) -> tuple[Track, Draw]:
    """Predict with the encoders, then correct with the fix, the heading and the landmarks that are due, none late.

    Args:
        track: state of the filter.
        arrays: of the filter, changed in place.
        seen: the newest measurement of each landmark, changed in place.
        errors: of the newest fix, NO_ERRORS before the first.
        moment: this step.
        state: of the plant.
        robot: that measures.

    Returns:
        The track, and the errors of the newest fix.
    """
    plant, sensors, options = robot.plant, robot.sensors, robot.filter
    t_s, step = plant.sampling_time, moment.step
    if step > 0 and track.initialised:
        noise = encoder_covariance(state.encoder, plant.encoder_noise, plant.wheels)
        twist, separation = body_twist(state.encoder, plant.wheels), plant.wheels.wheel_separation
        motion = Motion(twist, t_s, noise, measured_rate(moment, state.twist.omega, t_s, sensors))
        track, slip = take_rate(track, arrays, motion, separation, options)
        motion = Motion(twist, t_s, add_twist_covariance(noise, slip), motion.rate)
        track = advance(track, arrays, motion, separation, options)
    if is_pose_due(step, sensors, t_s):
        fix = measured_pose_at(moment, state.pose, errors, sensors)
        errors = fix.errors
        if not fix.lost:
            track = take_fix(track, arrays, PoseFix(fix.pose, claimed_noise(fix.pose, sensors)), options)
    if track.initialised and due(step, sensors.heading_rate, t_s):
        heading = heading_at(moment, state.pose, sensors)
        track = take_heading(track, arrays, heading, uniform_variance(sensors.heading_error_max), options)
    if track.initialised and due(step, sensors.landmark_rate, t_s):
        track = take_landmarks(track, arrays, seen, moment, state.pose, robot)
    return track, errors


def measured_rate(moment: NoiseKey, omega: float, sampling_time: float, sensors: SensorConfig) -> TurnRate:
    """Return what the gyro measures of the mean turn rate ``omega`` [rad/s] over the step that ends now."""
    if not turn_rate_due(moment.step, sensors, sampling_time):
        return TurnRate(0.0, math.inf)
    return TurnRate(turn_rate_at(moment, omega, sensors), uniform_variance(sensors.gyro_error_max))


def take_landmarks(track: Track, arrays: Any, seen: Any, moment: NoiseKey, pose: Pose, robot: Robot) -> Track:
    """Correct with the landmarks in range of the true ``pose``."""
    sensors, time = robot.sensors, moment.step * robot.plant.sampling_time
    var_range, var_bearing = landmark_variances(sensors)
    for index in range(len(robot.landmarks)):
        x, y = robot.landmarks[index, 0], robot.landmarks[index, 1]
        if in_range(pose, x, y, sensors):
            distance, bearing = landmark_at(moment, index, pose, x, y, sensors)
            measured = LandmarkMeasurement(distance, bearing, Point(x, y), var_range, var_bearing)
            track = take_landmark(track, arrays, seen[index], measured, time, robot.filter)
    return track
