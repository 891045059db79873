"""Drives of the simulated robot with known errors, to hold a calibration to."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.gyro import GyroSample
from diffbot_control.filter.measurements import FIXES, LandmarkMeasurement, PoseFix, Source
from diffbot_control.filter.measurements.fix import further_source
from diffbot_control.filter.odometry import OdometryStep
from diffbot_core.geometry import Point, Pose, range_and_bearing, wrap_angle
from diffbot_core.kinematics import Twist, body_twist, encoder_covariance
from diffbot_core.units import NS_PER_S, S_PER_NS
from diffbot_sim.model.actuators import ActuatorConfig
from diffbot_sim.model.philox import NoiseKey
from diffbot_sim.model.plant import PlantConfig, new_plant, plant_step_at
from diffbot_tools.calibration.events import Array, Collector, Events

NOISE, SIGMA_XY, SIGMA_YAW = 0.05, 0.05, 0.03
"""What the messages claim: bound of the relative error of each encoder, deviations of a fix [m], [rad]."""
SIGMA_RANGE, SIGMA_BEARING, SIGMA_GYRO = 0.05, 0.03, 0.01
"""The same of landmarks [m], [rad], and of the gyro [rad/s]."""
SECOND = "second_pose"
"""Topic of a second source of fixes, with the same deviations."""
_GRID, _SEEN, _GYRO_STEPS = 6.0, 5.0, 5
"""[m] between the landmarks; [m] at which they are seen; samples of the gyro in each step"""
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
    correlation_time: float = 0.0
    """[s] of the errors of fixes and of each landmark; 0: independent"""
    range_offset: float = 0.0
    """[m]"""
    range_scale: float = 0.0
    bearing_offset: float = 0.0
    """[rad]"""
    gyro_bias: float = 0.0
    """[rad/s]"""


class Sensors(NamedTuple):
    """Steps of 0.1 s between two measurements; 0: none, but for a fix at the start."""

    fixes: int = 2
    second: int = 0
    """fixes of a second source, whose errors are independent"""
    landmarks: int = 0
    """looks at the landmarks around, which stand in a grid"""
    gyro: bool = False


FIXES_ALONE = Sensors()


class Recording(NamedTuple):
    """Messages of a drive."""

    odometry: list[OdometryStep]
    fixes: list[PoseFix]
    commands: list[tuple[int, Twist]]
    """stamp [ns] and requested twist"""
    landmarks: list[LandmarkMeasurement]
    gyro: list[GyroSample]


def record(
    errors: Errors, seed: int, seconds: float = 300.0, sensors: Sensors = FIXES_ALONE, *, turning: bool = True
) -> Recording:
    """Drive curves, or straight on, with the plant; noise from ``seed``.

    Args:
        errors: of the robot.
        seed: of all noise.
        seconds: duration.
        sensors: of the robot.
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
    of_landmarks = np.diag((SIGMA_RANGE**2, SIGMA_BEARING**2))
    noise, second = _Noise(rng, errors), further_source(SECOND)

    def fix(stamp: int, pose: Pose, source: Source, time: float) -> PoseFix:
        dx, dy, turn = noise.next(source, stamp * S_PER_NS, (SIGMA_XY, SIGMA_XY, SIGMA_YAW), time)
        return PoseFix(stamp, Pose(pose.x + dx, pose.y + dy, wrap_angle(pose.theta + turn)), R, source)

    found = Recording([], [fix(_START_NS, state.pose, Source(FIXES), errors.correlation_time)], [], [], [])
    for k in range(round(seconds / t_s)):
        now = k * t_s
        omega = 0.6 * math.sin(0.17 * now + phase[1]) + 0.4 * math.sin(0.53 * now + phase[2])
        command = Twist(0.3 + 0.2 * math.sin(0.31 * now + phase[0]), omega if turning else 0.0)
        before, state = state.pose, plant_step_at(NoiseKey(seed, 0, k), state, command, config)
        stamp = _START_NS + round((now + t_s) * NS_PER_S)
        found.commands.append((stamp - round(t_s * NS_PER_S), command))
        covariance = encoder_covariance(state.encoder, NOISE, config.wheels)
        step = OdometryStep(
            stamp - round(errors.delay * NS_PER_S), body_twist(state.encoder, config.wheels), covariance
        )
        found.odometry.append(step)
        if sensors.fixes and (k + 1) % sensors.fixes == 0:
            found.fixes.append(fix(stamp, state.pose, Source(FIXES), errors.correlation_time))
        if sensors.second and (k + 1) % sensors.second == 0:
            found.fixes.append(fix(stamp, state.pose, second, 0.0))
        if sensors.landmarks and (k + 1) % sensors.landmarks == 0:
            for place in _landmarks_around(state.pose):
                distance, bearing = range_and_bearing(*state.pose, *place)
                far, turn = noise.next(place, stamp * S_PER_NS, (SIGMA_RANGE, SIGMA_BEARING), errors.correlation_time)
                distance = (1.0 + errors.range_scale) * distance + errors.range_offset + far
                bearing = wrap_angle(bearing + errors.bearing_offset + turn)
                found.landmarks.append(LandmarkMeasurement(stamp, distance, bearing, of_landmarks, place))
        for part in range(1, _GYRO_STEPS + 1) if sensors.gyro else ():
            rate = wrap_angle(state.pose.theta - before.theta) / t_s + errors.gyro_bias + noise.white(SIGMA_GYRO)
            at = stamp - round((1.0 - part / _GYRO_STEPS) * t_s * NS_PER_S)
            found.gyro.append(GyroSample(at, rate, SIGMA_GYRO**2))
    return found


class _Noise:
    """Errors of sensors; those of each source are a first-order Markov process."""

    def __init__(self, rng: np.random.Generator, errors: Errors) -> None:
        self._rng, self._factor = rng, errors.noise
        self._last: dict[Any, tuple[float, Array]] = {}

    def white(self, sigma: float) -> float:
        """Return an independent error."""
        return float(self._factor * sigma * self._rng.normal())

    def next(self, source: Any, now: float, sigmas: tuple[float, ...], time: float) -> list[float]:
        """Return the error of a source at a time, which lasts for ``time`` [s]."""
        fresh: Array = self._rng.normal(size=len(sigmas))
        if source in self._last and time > 0.0:
            last, before = self._last[source]
            c = math.exp(-(now - last) / time)
            fresh = c * before + math.sqrt(1.0 - c * c) * fresh
        self._last[source] = now, fresh
        return list((self._factor * fresh * sigmas).tolist())


def _landmarks_around(pose: Pose) -> list[Point]:
    """Return the points of the grid that are seen from a pose."""
    column, row = round(pose.x / _GRID), round(pose.y / _GRID)
    grid = [Point(_GRID * (column + i) + 1.0, _GRID * (row + j) + 1.0) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    return [one for one in grid if 0.3 < math.hypot(one.x - pose.x, one.y - pose.y) < _SEEN]


def events_of(recording: Recording, name: str = "simulated drive") -> Events:
    """Return a recording as events."""
    collector = Collector((SECOND,))
    for measurement in (*recording.fixes, *recording.landmarks):
        collector.on_measurement(measurement)
    for sample in recording.gyro:
        collector.on_gyro(sample)
    for step in recording.odometry:
        if step.stamp > recording.fixes[0].stamp:
            collector.on_odometry(step)
    return collector.events(name)
