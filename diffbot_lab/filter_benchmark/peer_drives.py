"""Drives of the simulated robot for the comparison with robot_localization, and what a filter gets of them."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.gyro import GyroSample
from diffbot_control.filter.landmark_calibration import NO_ERRORS, LandmarkErrors
from diffbot_control.filter.landmark_map import LandmarkMap
from diffbot_control.filter.measurements import LandmarkMeasurement, Measurement, PoseFix, PositionFix
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.filter.options import FilterConfig
from diffbot_core.geometry import wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.units import NS_PER_S
from diffbot_sim.model.actuators import ActuatorConfig
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig
from diffbot_sim.model.simulator import StartPose, World, WorldConfig
from diffbot_sim.reference_loop import measurements_of

Array = NDArray[np.float64]

DURATION = 300.0
"""[s]"""
RATE = 50
"""[Hz] of odometry and gyro"""
START = NS_PER_S * 1_000_000
"""[ns] stamp of the first step; to some a stamp of zero means *now*"""
_RADIUS = 12.0
"""[m] about the start in which the robot drives"""


class PeerCase(NamedTuple):
    """What differs from the nominal robot."""

    name: str
    text: str
    sensors: SensorConfig
    plant: PlantConfig = PlantConfig()
    filter: FilterConfig = FilterConfig()
    with_heading: bool = True
    """False: fixes measure the position alone"""
    landmarks: LandmarkMap = LandmarkMap()
    """which the peer does not get"""
    landmark_errors: LandmarkErrors = NO_ERRORS
    """of the sensor that measures them"""


_DRIVES = ActuatorConfig(acceleration_max=0.5, angular_acceleration_max=1.5)
_SMOOTH = PlantConfig(actuators=_DRIVES)
_MIX = PlantConfig(
    left_radius_error=0.02,
    actuators=_DRIVES._replace(command_delay=0.1, drive_time_constant=0.1, separation_error=0.03),
)
_LATE = SensorConfig(fix_rate=5.0, fix_delay=0.15)
GYRO = SensorConfig(fix_rate=1.0, gyro_rate=float(RATE), gyro_error_max=0.005 * math.sqrt(3.0), gyro_bias=0.02)
_GNSS = 0.5 * math.sqrt(3.0)
CASES = (
    PeerCase("nominal", "fixes at 5 Hz", SensorConfig(fix_rate=5.0)),
    PeerCase("late", "fixes 0.3 s late", SensorConfig(fix_rate=5.0, fix_delay=0.3)),
    PeerCase(
        "outliers",
        "5 % of the fixes are 3 m off, all are 0.15 s late",
        _LATE._replace(fix_outlier=0.05, fix_outlier_distance=3.0),
        _SMOOTH,
    ),
    PeerCase(
        "radius",
        "left radius 2 % wrong, fixes at 1 Hz, 0.15 s late",
        _LATE._replace(fix_rate=1.0),
        _SMOOTH._replace(left_radius_error=0.02),
    ),
    PeerCase("mix", "left radius 2 %, separation 3 % wrong; dead time, lag; fixes 0.15 s late", _LATE, _MIX),
    PeerCase(
        "gyro",
        "gyro with a bias of 0.02 rad/s, fixes at 1 Hz, 5 % slip of the right wheel for 100 s",
        GYRO,
        _SMOOTH._replace(slip_right=0.05, slip_start=100.0, slip_duration=100.0),
        FilterConfig(use_gyro=True),
    ),
    PeerCase(
        "gnss",
        "positions alone, 0.5 m (one deviation), at 1 Hz",
        SensorConfig(fix_rate=1.0, eps_x_max=_GNSS, eps_y_max=_GNSS),
        _SMOOTH,
        with_heading=False,
    ),
)


class Event(NamedTuple):
    """A message and when it arrives."""

    arrival: int
    """[ns]"""
    content: Measurement | OdometryStep | GyroSample


class Drive(NamedTuple):
    """What a filter gets, and where the robot was."""

    events: list[Event]
    truth: Array
    """(n, 3) pose at each step, x, y, yaw [m, m, rad]"""


def record_drive(case: PeerCase, seed: int, duration: float = DURATION) -> Drive:
    """Drive at random about the start: turns, straights and stops of some seconds each."""
    plant = case.plant._replace(sampling_time=1.0 / RATE)
    rng, events, truth = random.Random(seed), [], []
    start = StartPose(0.0, 0.0, rng.uniform(-math.pi, math.pi))
    world = World(WorldConfig(plant, case.sensors, start, seed, landmarks=case.landmarks), START)
    until, command = 0.0, Twist(0.0, 0.0)
    for step in range(round(duration * RATE) + 1):
        pose, now = world.state.pose, step / RATE
        if math.hypot(pose.x, pose.y) > _RADIUS:
            back = wrap_angle(math.atan2(-pose.y, -pose.x) - pose.theta)
            command, until = Twist(0.5, max(-0.8, min(0.8, back))), now + 1.0
        elif now >= until:
            until = now + rng.uniform(2.0, 7.0)
            v = 0.0 if rng.random() < 0.15 else rng.uniform(0.2, 1.0)
            command = Twist(v, 0.0 if rng.random() < 0.3 else rng.uniform(-0.8, 0.8))
        events += [Event(world.stamp, one) for one in _messages(world, case)]
        truth.append(pose)
        world.advance(command)
    return Drive(events, np.array(truth))


def _messages(world: World, case: PeerCase) -> Iterator[Measurement | OdometryStep | GyroSample]:
    """Yield what arrives at the present step, in the order of the graph."""
    for one in measurements_of(world.sense()):
        if isinstance(one, PoseFix) and not case.with_heading:
            yield PositionFix(one.stamp, one.pose.x, one.pose.y, one.R[:2, :2])
        elif isinstance(one, LandmarkMeasurement):
            offset, scale, bearing = case.landmark_errors
            yield replace(one, range=(1.0 + scale) * one.range + offset, bearing=wrap_angle(one.bearing + bearing))
        else:
            yield one
    reading = world.turn_rate()
    if reading is not None:
        yield GyroSample(*reading)
    yield world.odometry()


def steps_of(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the numbers of the steps that the stamps are of."""
    steps: NDArray[np.int64] = np.rint((stamps - START) * RATE / NS_PER_S).astype(np.int64)
    return steps
