"""Drives of the simulated robot with known errors, to hold a calibration to."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from diffbot_control.filter.gyro import GyroSample
from diffbot_control.filter.measurements import FIXES, PoseFix, Source
from diffbot_control.filter.measurements.fix import further_source
from diffbot_control.filter.odometry import OdometryStep
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist, body_twist, encoder_covariance
from diffbot_core.units import NS_PER_S
from diffbot_sim.model.actuators import ActuatorConfig
from diffbot_sim.model.philox import NoiseKey
from diffbot_sim.model.plant import PlantConfig, new_plant, plant_step_at

NOISE, SIGMA_XY, SIGMA_YAW = 0.05, 0.05, 0.03
"""What the messages claim: bound of the relative error of each encoder, deviations of a fix [m], [rad]."""
SIGMA_GYRO = 0.01
"""The same of the gyro [rad/s]."""
SECOND = "second_pose"
"""Topic of a second source of fixes, with the same deviations."""
_GYRO_STEPS = 5
"""Samples of the gyro in each step."""
_START_NS = 100 * NS_PER_S


class Errors(NamedTuple):
    """True errors of a simulated robot."""

    left: float = 0.0
    right: float = 0.0
    separation: float = 0.0
    delay: float = 0.0
    """[s] by which the motion follows the odometry's stamps"""
    noise: float = 1.0
    """factor on the deviations of encoders and sensors, beside what the messages claim"""
    gyro_bias: float = 0.0
    """[rad/s]"""


class Sensors(NamedTuple):
    """Steps of 0.1 s between two measurements; 0: none, but for a fix at the start."""

    fixes: int = 2
    second: int = 0
    """fixes of a second source, whose errors are independent"""
    gyro: bool = False


FIXES_ALONE = Sensors()


class Recording(NamedTuple):
    """Messages of a drive."""

    odometry: list[OdometryStep]
    fixes: list[PoseFix]
    commands: list[tuple[int, Twist]]
    """stamp [ns] and requested twist"""
    gyro: list[GyroSample]


def record(errors: Errors, seed: int, seconds: float = 300.0, sensors: Sensors = FIXES_ALONE) -> Recording:
    """Drive curves for this time [s] with the plant; ``seed`` is of all noise."""
    config = PlantConfig(
        encoder_noise=min(NOISE * errors.noise, 1.0),
        left_radius_error=errors.left,
        right_radius_error=errors.right,
        actuators=ActuatorConfig(separation_error=errors.separation),
    )
    rng = np.random.default_rng(seed)
    phase, state = rng.uniform(0.0, 2.0 * math.pi, 3), new_plant(Pose(0.0, 0.0, rng.uniform(-math.pi, math.pi)))
    t_s, R = config.sampling_time, np.diag((SIGMA_XY**2, SIGMA_XY**2, SIGMA_YAW**2))
    second = further_source(SECOND)

    def fix(stamp: int, pose: Pose, source: Source) -> PoseFix:
        dx, dy, turn = (errors.noise * rng.normal(scale=(SIGMA_XY, SIGMA_XY, SIGMA_YAW))).tolist()
        return PoseFix(stamp, Pose(pose.x + dx, pose.y + dy, wrap_angle(pose.theta + turn)), R, source)

    found = Recording([], [fix(_START_NS, state.pose, Source(FIXES))], [], [])
    for k in range(round(seconds / t_s)):
        now = k * t_s
        omega = 0.6 * math.sin(0.17 * now + phase[1]) + 0.4 * math.sin(0.53 * now + phase[2])
        command = Twist(0.3 + 0.2 * math.sin(0.31 * now + phase[0]), omega)
        before, state = state.pose, plant_step_at(NoiseKey(seed, 0, k), state, command, config)
        stamp = _START_NS + round((now + t_s) * NS_PER_S)
        found.commands.append((stamp - round(t_s * NS_PER_S), command))
        covariance = encoder_covariance(state.encoder, NOISE, config.wheels)
        step = OdometryStep(
            stamp - round(errors.delay * NS_PER_S), body_twist(state.encoder, config.wheels), covariance
        )
        found.odometry.append(step)
        if sensors.fixes and (k + 1) % sensors.fixes == 0:
            found.fixes.append(fix(stamp, state.pose, Source(FIXES)))
        if sensors.second and (k + 1) % sensors.second == 0:
            found.fixes.append(fix(stamp, state.pose, second))
        for part in range(1, _GYRO_STEPS + 1) if sensors.gyro else ():
            error = errors.gyro_bias + errors.noise * rng.normal(scale=SIGMA_GYRO)
            rate = wrap_angle(state.pose.theta - before.theta) / t_s + error
            at = stamp - round((1.0 - part / _GYRO_STEPS) * t_s * NS_PER_S)
            found.gyro.append(GyroSample(at, rate, SIGMA_GYRO**2))
    return found
