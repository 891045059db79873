"""Sensing and filtering at one step of a simulation with plain numbers only, in the order of the graph."""

from __future__ import annotations

from typing import Any, NamedTuple

from diffbot_control.filter.models import Motion
from diffbot_control.filter.options import FilterOptions
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import body_twist, encoder_covariance
from diffbot_sim.compiled.scalar_belief import PoseFix
from diffbot_sim.compiled.scalar_ekf import LandmarkMeasurement
from diffbot_sim.compiled.scalar_filter import Track, advance, take_fix, take_heading, take_landmark
from diffbot_sim.model.philox import FAULT_BLOCK, FIX_BLOCK, LANDMARK_BLOCK, draw
from diffbot_sim.model.plant import PlantConfig, PlantState
from diffbot_sim.model.sensors import (
    SensorConfig,
    due,
    is_lost,
    measured_heading,
    measured_landmark,
    measured_pose,
    uniform_variance,
    with_outlier,
)


class Robot(NamedTuple):
    """Configuration that determines the measurements of a run."""

    plant: PlantConfig
    sensors: SensorConfig
    filter: FilterOptions
    landmarks: Any
    """(n, 2) array of their x, y [m]"""


class NoiseKey(NamedTuple):
    """Identifies the random numbers of a step."""

    seed: int
    run: int
    step: int


def fix_at(moment: NoiseKey, pose: Pose, sensors: SensorConfig) -> tuple[Pose, bool]:
    """Return a fix of the true ``pose``, and whether it is lost."""
    fix = measured_pose(pose, draw(moment.seed, moment.run, moment.step, FIX_BLOCK), sensors)
    if sensors.fix_dropout == 0.0 and sensors.fix_outlier == 0.0:
        return fix, False
    fault = draw(moment.seed, moment.run, moment.step, FAULT_BLOCK)
    return with_outlier(fix, fault, sensors), is_lost(fault, sensors)


def observe(track: Track, moment: NoiseKey, state: PlantState, robot: Robot) -> Track:
    """Predict with the encoders, then correct with the fix, the heading and the landmarks that are due."""
    plant, sensors, options = robot.plant, robot.sensors, robot.filter
    t_s, step = plant.sampling_time, moment.step
    if step > 0 and track.initialised:
        noise = encoder_covariance(state.encoder, plant.encoder_noise, plant.wheels)
        twist = body_twist(state.encoder, plant.wheels)
        track = advance(track, Motion(twist, t_s, noise), plant.wheels.wheel_separation, options)
    if due(step, sensors.fix_rate, t_s):
        fix, lost = fix_at(moment, state.pose, sensors)
        if not lost:
            scale = sensors.fix_covariance_scale
            var_x, var_y = uniform_variance(sensors.eps_x_max), uniform_variance(sensors.eps_y_max)
            var_theta = uniform_variance(sensors.eps_theta_max)
            track = take_fix(track, PoseFix(fix, scale * var_x, scale * var_y, scale * var_theta), options)
    if track.initialised and due(step, sensors.heading_rate, t_s):
        heading = measured_heading(state.pose, draw(moment.seed, moment.run, step, FIX_BLOCK), sensors)
        track = take_heading(track, heading, uniform_variance(sensors.heading_error_max), options)
    if track.initialised and due(step, sensors.landmark_rate, t_s):
        track = _with_landmarks(track, moment, state.pose, robot)
    return track


def _with_landmarks(track: Track, moment: NoiseKey, pose: Pose, robot: Robot) -> Track:
    sensors = robot.sensors
    var_range = uniform_variance(sensors.landmark_range_error_max)
    var_bearing = uniform_variance(sensors.landmark_bearing_error_max)
    for index in range(len(robot.landmarks)):
        x, y = robot.landmarks[index, 0], robot.landmarks[index, 1]
        if (x - pose.x) ** 2 + (y - pose.y) ** 2 <= sensors.landmark_range**2:
            noise = draw(moment.seed, moment.run, moment.step, LANDMARK_BLOCK + index)
            distance, bearing = measured_landmark(pose, x, y, noise, sensors)
            measured = LandmarkMeasurement(distance, bearing, Point(x, y), var_range, var_bearing)
            track = take_landmark(track, measured, robot.filter)
    return track
