"""Drives of the simulated robot with known errors, to hold a calibration to."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from diffbot_control.filter.config import LocalizationConfig, PoseSource, PoseSources, sources_of
from diffbot_control.filter.measurement import FIXES, GyroSample, Measurement, pose_fix
from diffbot_control.filter.odometry import OdometryStep
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist, body_twist, encoder_covariance
from diffbot_core.stamps import NS_PER_S, S_PER_NS
from diffbot_sim.config import PlantConfig
from diffbot_sim.noise import MOTION, NoiseSource
from diffbot_sim.plant import new_plant, plant_step
from diffbot_tools.calibration.events import Array, Collector, Events

NOISE, SIGMA_XY, SIGMA_YAW = 0.05, 0.05, 0.03
"""What the messages claim: bound of the relative error of each encoder, deviations of a fix [m], [rad]."""
SIGMA_GYRO = 0.01
"""[rad/s] the same of the gyro"""
SECOND = "second_pose"
"""Topic of a second source of fixes, with the same deviations."""
SECOND_FIXES = PoseSource(SECOND, 0.0, 0.0, 0.0).source
SOURCES = sources_of(LocalizationConfig(sources=PoseSources((SECOND,))))
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
    correlation_time: float = 0.0
    """[s] of the errors of fixes; 0: independent"""
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
    fixes: list[Measurement]
    commands: list[tuple[int, Twist]]
    """stamp [ns] and requested twist"""
    gyro: list[GyroSample]


def record(errors: Errors, seed: int, seconds: float = 300.0, sensors: Sensors = FIXES_ALONE) -> Recording:
    """Drive curves with the plant for ``seconds``; all noise follows from ``seed``."""
    config = PlantConfig(
        encoder_noise=min(NOISE * errors.noise, 1.0),
        left_radius_error=errors.left,
        right_radius_error=errors.right,
        separation_error=errors.separation,
    )
    rng = np.random.default_rng(seed)
    phase, state = rng.uniform(0.0, 2.0 * math.pi, 3), new_plant(Pose(0.0, 0.0, rng.uniform(-math.pi, math.pi)))
    steps = round(seconds / config.sampling_time)
    motion = NoiseSource().run(seed, 0, steps, (MOTION,))
    t_s, R = config.sampling_time, np.diag((SIGMA_XY**2, SIGMA_XY**2, SIGMA_YAW**2))
    noise = _Noise(rng, errors)

    def fix(stamp: int, pose: Pose, source: str, time: float) -> Measurement:
        dx, dy, turn = noise.next(source, stamp * S_PER_NS, (SIGMA_XY, SIGMA_XY, SIGMA_YAW), time)
        return pose_fix(stamp, Pose(pose.x + dx, pose.y + dy, wrap_angle(pose.theta + turn)), R, source)

    found = Recording([], [fix(_START_NS, state.pose, FIXES, errors.correlation_time)], [], [])
    for k in range(steps):
        now = k * t_s
        omega = 0.6 * math.sin(0.17 * now + phase[1]) + 0.4 * math.sin(0.53 * now + phase[2])
        command = Twist(0.3 + 0.2 * math.sin(0.31 * now + phase[0]), omega)
        before, state = state.pose, plant_step(state, command, motion[:, k], config)
        stamp = _START_NS + round((now + t_s) * NS_PER_S)
        found.commands.append((stamp - round(t_s * NS_PER_S), command))
        covariance = encoder_covariance(state.encoder, NOISE, config.wheels)
        step = OdometryStep(
            stamp - round(errors.delay * NS_PER_S), body_twist(state.encoder, config.wheels), covariance
        )
        found.odometry.append(step)
        if sensors.fixes and (k + 1) % sensors.fixes == 0:
            found.fixes.append(fix(stamp, state.pose, FIXES, errors.correlation_time))
        if sensors.second and (k + 1) % sensors.second == 0:
            found.fixes.append(fix(stamp, state.pose, SECOND_FIXES, 0.0))
        for part in range(1, _GYRO_STEPS + 1) if sensors.gyro else ():
            rate = wrap_angle(state.pose.theta - before.theta) / t_s + errors.gyro_bias + noise.white(SIGMA_GYRO)
            at = stamp - round((1.0 - part / _GYRO_STEPS) * t_s * NS_PER_S)
            found.gyro.append(GyroSample(at, rate, SIGMA_GYRO**2))
    return found


class _Noise:
    """Errors of sensors; those of each source are a first-order Markov process."""

    def __init__(self, rng: np.random.Generator, errors: Errors) -> None:
        self._rng, self._factor = rng, errors.noise
        self._last: dict[str, tuple[float, Array]] = {}

    def white(self, sigma: float) -> float:
        """Return an independent error."""
        return float(self._factor * sigma * self._rng.normal())

    def next(self, source: str, now: float, sigmas: tuple[float, ...], time: float) -> list[float]:
        """Return the error of a source at a time, which lasts for ``time`` [s]."""
        fresh: Array = self._rng.normal(size=len(sigmas))
        if source in self._last and time > 0.0:
            last, before = self._last[source]
            c = math.exp(-(now - last) / time)
            fresh = c * before + math.sqrt(1.0 - c * c) * fresh
        self._last[source] = now, fresh
        return list((self._factor * fresh * sigmas).tolist())


def events_of(recording: Recording, name: str = "simulated drive") -> Events:
    """Return a recording as events."""
    collector = Collector(SOURCES)
    for measurement in recording.fixes:
        collector.on_measurement(measurement)
    for sample in recording.gyro:
        collector.on_gyro(sample)
    for step in recording.odometry:
        if step.stamp > recording.fixes[0].stamp:
            collector.on_odometry(step)
    return collector.events(name)
