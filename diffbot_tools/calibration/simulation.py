"""Drives of the simulated robot with known errors, to hold a calibration to."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from diffbot_control.filter.measurements import PoseFix
from diffbot_control.filter.odometry import OdometryStep
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist, body_twist, encoder_covariance
from diffbot_core.units import NS_PER_S
from diffbot_sim.model.actuators import ActuatorConfig
from diffbot_sim.model.philox import NoiseKey
from diffbot_sim.model.plant import PlantConfig, new_plant, plant_step_at
from diffbot_tools.calibration.events import Collector, Events

NOISE, SIGMA_XY, SIGMA_YAW = 0.05, 0.05, 0.03
"""What the messages claim: bound of the relative error of each encoder, deviations of a fix [m], [rad]."""
_START_NS = 100 * NS_PER_S


class Errors(NamedTuple):
    """True errors of a simulated robot."""

    left: float = 0.0
    right: float = 0.0
    separation: float = 0.0
    delay: float = 0.0
    """[s] by which the motion follows the odometry's stamps"""
    noise: float = 1.0
    """factor on the deviations of encoders and fixes, beside what the messages claim"""


class Recording(NamedTuple):
    """Messages of a drive."""

    odometry: list[OdometryStep]
    fixes: list[PoseFix]
    commands: list[tuple[int, Twist]]
    """stamp [ns] and requested twist"""


def record(
    errors: Errors, seed: int, seconds: float = 300.0, fixes_every: int = 2, *, turning: bool = True
) -> Recording:
    """Drive curves, or straight on, with the plant; noise from ``seed``.

    Args:
        errors: of the robot.
        seed: of all noise.
        seconds: duration.
        fixes_every: steps of 0.1 s between two fixes.
        turning: vary the turn rate.
    """
    config = PlantConfig(
        encoder_noise=min(NOISE * errors.noise, 1.0),
        left_radius_error=errors.left,
        right_radius_error=errors.right,
        actuators=ActuatorConfig(separation_error=errors.separation),
    )
    rng = np.random.default_rng(seed)
    phase, state = rng.uniform(0.0, 2.0 * math.pi, 3), new_plant(Pose(0.0, 0.0, rng.uniform(-math.pi, math.pi)))
    t_s, R = config.sampling_time, np.diag((SIGMA_XY**2, SIGMA_XY**2, SIGMA_YAW**2))
    found = Recording([], [PoseFix(_START_NS, state.pose, R)], [])
    for k in range(round(seconds / t_s)):
        now = k * t_s
        omega = 0.6 * math.sin(0.17 * now + phase[1]) + 0.4 * math.sin(0.53 * now + phase[2])
        command = Twist(0.3 + 0.2 * math.sin(0.31 * now + phase[0]), omega if turning else 0.0)
        state = plant_step_at(NoiseKey(seed, 0, k), state, command, config)
        stamp = _START_NS + round((now + t_s) * NS_PER_S)
        found.commands.append((stamp - round(t_s * NS_PER_S), command))
        covariance = encoder_covariance(state.encoder, NOISE, config.wheels)
        step = OdometryStep(
            stamp - round(errors.delay * NS_PER_S), body_twist(state.encoder, config.wheels), covariance
        )
        found.odometry.append(step)
        if (k + 1) % fixes_every == 0:
            x, y, theta = state.pose
            dx, dy, turn = errors.noise * rng.normal(size=3) * (SIGMA_XY, SIGMA_XY, SIGMA_YAW)
            found.fixes.append(PoseFix(stamp, Pose(x + dx, y + dy, wrap_angle(theta + turn)), R))
    return found


def events_of(recording: Recording, name: str = "simulated drive") -> Events:
    """Return a recording as events."""
    collector = Collector()
    for fix in recording.fixes:
        collector.on_measurement(fix)
    for step in recording.odometry:
        if step.stamp > recording.fixes[0].stamp:
            collector.on_odometry(step)
    return collector.events(name)
