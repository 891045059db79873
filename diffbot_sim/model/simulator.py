"""The plant with its sensors and its clock, driven by the plant node and by the reference loop."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.landmark_map import LandmarkMap
from diffbot_control.filter.odometry import OdometryStep
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import Twist, WheelSpeeds, body_twist, encoder_covariance
from diffbot_core.ranges import HEADING, POSITION
from diffbot_core.schema import Spec, known_fields
from diffbot_core.units import NS_PER_S
from diffbot_sim.model.actuators import MAX_COMMAND_DELAY, command_rows, delayed_command
from diffbot_sim.model.detector import DetectorConfig, depth_at_dock, detection_at, meets_dock
from diffbot_sim.model.philox import NoiseKey
from diffbot_sim.model.plant import PlantConfig, PlantState, new_plant, plant_step_at
from diffbot_sim.model.sensors import (
    NO_ERRORS,
    SensorConfig,
    delay_in_steps,
    due,
    fix_at,
    fix_variances,
    heading_at,
    in_range,
    landmark_at,
    landmark_variances,
    turn_rate_at,
    turn_rate_due,
    uniform_variance,
)

Array = NDArray[np.float64]


@known_fields
class StartPose(NamedTuple):
    """Where the robot starts; the default is the start of the paper's simulation A."""

    x: Annotated[
        float,
        Spec("start x in map", "m", *POSITION, parameter="initial_pose.x"),
    ] = -2.0
    y: Annotated[
        float,
        Spec("start y in map", "m", *POSITION, parameter="initial_pose.y"),
    ] = -5.5
    theta: Annotated[float, Spec("start heading in map", "rad", *HEADING, parameter="initial_pose.yaw")] = (
        0.5235987755982988
    )


@known_fields
class WorldConfig(NamedTuple):
    """Plant, sensors, start and the one seed of all random numbers."""

    plant: PlantConfig = PlantConfig()
    sensors: SensorConfig = SensorConfig()
    start: StartPose = StartPose()
    seed: Annotated[int, Spec("seed of all noise", minimum=0, maximum=2**63 - 1)] = 1
    run: Annotated[int, Spec("number of the run under this seed", minimum=0, maximum=2**63 - 1)] = 0
    landmarks: LandmarkMap = LandmarkMap()


class FixReading(NamedTuple):
    """A measured pose."""

    stamp: int
    """[ns]"""
    pose: Pose
    R: Array
    """(3, 3) covariance [m, m, rad]"""


class HeadingReading(NamedTuple):
    """A measured heading."""

    stamp: int
    """[ns]"""
    theta: float
    """[rad]"""
    R: Array
    """(1, 1) variance [rad^2]"""


class LandmarkReading(NamedTuple):
    """Range and bearing of one landmark of the map, in the frame of the robot."""

    stamp: int
    """[ns]"""
    range: float
    """[m]"""
    bearing: float
    """[rad]"""
    R: Array
    """(2, 2) covariance [m, rad]"""
    number: int
    """of the landmark in the map"""
    landmark: Point
    """its position [m]"""


class GyroReading(NamedTuple):
    """A measured turn rate."""

    stamp: int
    """[ns]"""
    rate: float
    """[rad/s]"""
    variance: float
    """[rad^2/s^2] but for the bias"""


class DetectionReading(NamedTuple):
    """A dock as the detector sees it."""

    stamp: int
    """[ns]"""
    pose: Pose
    """of the docked robot in the frame of the robot"""
    R: Array
    """(3, 3) covariance [m, m, rad]"""


_Sensed = TypeVar("_Sensed", FixReading, HeadingReading, DetectionReading)


class Arrivals(NamedTuple):
    """Measurements that arrive at one step, oldest first; some may have been taken earlier."""

    fixes: list[FixReading]
    headings: list[HeadingReading]
    landmarks: list[LandmarkReading]
    detections: list[DetectionReading]


class World:
    """The simulated robot. Time is ``start_stamp`` [ns] plus whole sampling times."""

    def __init__(self, config: WorldConfig, start_stamp: int = 0) -> None:
        """Put the robot at the start, step 0."""
        self.start_stamp = start_stamp
        self.period = round(config.plant.sampling_time * NS_PER_S)
        self.state = new_plant(Pose(*config.start))
        self.odometry_P = np.zeros((3, 3))
        """(3, 3) covariance of the odometry's pose, accumulated from the start"""
        self._fixes: list[tuple[int, FixReading]] = []
        self._headings: list[tuple[int, HeadingReading]] = []
        self._detections: list[tuple[int, DetectionReading]] = []
        self._fix_errors = NO_ERRORS
        # Long enough for any delay that may be set later.
        self._commands = np.zeros((command_rows(MAX_COMMAND_DELAY, config.plant.sampling_time), 2))
        self.configure(config)

    def configure(self, config: WorldConfig) -> None:
        """Take over noise bounds, rates and faults from the next step on; the sampling time stays."""
        self.config = config
        sensors = config.sensors
        self._fix_R = np.diag(fix_variances(sensors))
        self._heading_R = np.array([[uniform_variance(sensors.heading_error_max)]])
        self._landmark_R = np.diag(landmark_variances(sensors))

    @property
    def stamp(self) -> int:
        """Time [ns] of the present state."""
        return self.start_stamp + self.state.step * self.period

    def advance(self, command: Twist) -> None:
        """Request ``command`` for one sampling time; it reaches the wheels after ``command_delay``."""
        config, step = self.config, self.state.step
        plant, before = config.plant, self.state.odometry
        arrived = delayed_command(self._commands, step, command, plant.actuators.command_delay, plant.sampling_time)
        before_step, detector = self.state, config.sensors.detector
        self.state = plant_step_at(NoiseKey(config.seed, config.run, step), before_step, arrived, plant)
        if detector.detection_rate > 0.0 and meets_dock(before_step.pose, detector):
            self.state = held_by_dock(before_step, self.state, detector)
        self._grow_odometry_covariance(before)

    def odometry(self) -> OdometryStep:
        """Return the mean twist over the last step as the encoders measured it, with covariance."""
        plant = self.config.plant
        encoder = self.state.encoder
        return OdometryStep(
            self.stamp,
            body_twist(encoder, plant.wheels),
            encoder_covariance(encoder, plant.encoder_noise, plant.wheels),
        )

    def _grow_odometry_covariance(self, before: Pose) -> None:
        t_s, plant = self.config.plant.sampling_time, self.config.plant
        after, encoder = self.state.odometry, self.state.encoder
        dx, dy = after.x - before.x, after.y - before.y
        middle = before.theta + 0.5 * t_s * body_twist(encoder, plant.wheels).omega
        var_v, cov, var_omega = encoder_covariance(encoder, plant.encoder_noise, plant.wheels)
        F = np.array(((1.0, 0.0, -dy), (0.0, 1.0, dx), (0.0, 0.0, 1.0)))
        G = t_s * np.array(((math.cos(middle), -0.5 * dy), (math.sin(middle), 0.5 * dx), (0.0, 1.0)))
        M = np.array(((var_v, cov), (cov, var_omega)))
        self.odometry_P = F.dot(self.odometry_P).dot(F.T) + G.dot(M).dot(G.T)

    def sense(self) -> Arrivals:
        """Measure at the present step and return what arrives at it; to be called once a step, step 0 included."""
        config, sensors, step = self.config, self.config.sensors, self.state.step
        t_s, pose = config.plant.sampling_time, self.state.pose
        key = NoiseKey(config.seed, config.run, step)
        if due(step, sensors.heading_rate, t_s):
            heading = heading_at(key, pose, sensors)
            arrival = step + delay_in_steps(sensors.heading_delay, t_s)
            self._headings.append((arrival, HeadingReading(self.stamp, heading, self._heading_R)))
        if due(step, sensors.fix_rate, t_s):
            fix = fix_at(key, pose, self._fix_errors, sensors)
            self._fix_errors = fix.errors
            if not fix.lost:
                arrival = step + delay_in_steps(fix.delay, t_s)
                self._fixes.append((arrival, FixReading(self.stamp, fix.pose, self._fix_R)))
        if due(step, sensors.detector.detection_rate, t_s):
            self._detect(key)
        landmarks = self._measure_landmarks(key) if due(step, sensors.landmark_rate, t_s) else []
        waiting = _arrived(self._fixes, step), _arrived(self._headings, step)
        return Arrivals(*waiting, landmarks, _arrived(self._detections, step))

    def _detect(self, key: NoiseKey) -> None:
        config = self.config.sensors.detector
        found = detection_at(key, self.state.pose, config)
        if not found.lost:
            arrival = key.step + delay_in_steps(config.detection_delay, self.config.plant.sampling_time)
            R = np.diag(np.square((found.sigma, found.sigma, found.yaw_sigma)))
            self._detections.append((arrival, DetectionReading(self.stamp, found.pose, R)))

    @property
    def touches_dock(self) -> bool:
        """True if the robot stands against the dock that it detects."""
        detector = self.config.sensors.detector
        return detector.detection_rate > 0.0 and meets_dock(self.state.pose, detector)

    def turn_rate(self) -> GyroReading | None:
        """Return what the gyro measures over the step that ends now; None if it is not due."""
        config, sensors, step = self.config, self.config.sensors, self.state.step
        if not turn_rate_due(step, sensors, config.plant.sampling_time):
            return None
        rate = turn_rate_at(NoiseKey(config.seed, config.run, step), self.state.twist.omega, sensors)
        return GyroReading(self.stamp, rate, uniform_variance(sensors.gyro_error_max))

    def _measure_landmarks(self, key: NoiseKey) -> list[LandmarkReading]:
        sensors, pose = self.config.sensors, self.state.pose
        observed: list[LandmarkReading] = []
        for index, (number, point) in enumerate(self.config.landmarks.points().items()):
            if in_range(pose, point.x, point.y, sensors):
                distance, bearing = landmark_at(key, index, pose, point.x, point.y, sensors)
                reading = LandmarkReading(self.stamp, distance, bearing, self._landmark_R, number, point)
                observed.append(reading)
        return observed


def held_by_dock(before: PlantState, after: PlantState, config: DetectorConfig) -> PlantState:
    """Return the state of a robot that stood against its dock: it cannot get farther, and its wheels are stalled."""
    if depth_at_dock(after.pose, config) <= depth_at_dock(before.pose, config):
        return after
    rest = WheelSpeeds(0.0, 0.0)
    return after._replace(
        pose=before.pose, twist=Twist(0.0, 0.0), encoder=rest, angles=before.angles, odometry=before.odometry
    )


def _arrived(waiting: list[tuple[int, _Sensed]], step: int) -> list[_Sensed]:
    """Remove and return what arrives at ``step``, oldest first; a random delay lets measurements overtake others."""
    ready = [measured for arrival, measured in waiting if arrival <= step]
    if ready:
        waiting[:] = [one for one in waiting if one[0] > step]
    return ready
