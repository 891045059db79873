"""The simulated robot step by step: plant and sensors, for the plant node and for drives without ROS."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.measurement import GyroSample
from diffbot_control.filter.odometry import OdometryStep
from diffbot_core.data_sheet import MAX_COMMAND_LATENCY
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import Twist, body_twist, encoder_covariance
from diffbot_core.stamps import NS_PER_S
from diffbot_sim.config import WorldConfig
from diffbot_sim.noise import NoiseSource, quiet_noise
from diffbot_sim.plant import command_rows, delayed_command, new_plant, plant_step, stopped_by_dock, touches_dock
from diffbot_sim.sensors import (
    GYRO_ERROR_MAX,
    NO_ERRORS,
    delay_in_steps,
    detected_dock,
    fix_variances,
    in_range,
    is_due,
    is_gyro_due,
    measured_fix,
    measured_heading,
    measured_landmark,
    measured_turn_rate,
    purposes_of,
    uniform_variance,
)

Array = NDArray[np.float64]


class PoseReading(NamedTuple):
    """A measured pose: a fix in map, or a detected dock in the frame of the robot."""

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
    """id of the landmark in the map"""
    landmark: Point
    """position of the landmark [m]"""


class Arrivals(NamedTuple):
    """Measurements that arrive at one step. Poses may have been measured at earlier steps."""

    fixes: list[PoseReading]
    headings: list[HeadingReading]
    landmarks: list[LandmarkReading]
    detections: list[PoseReading]


class World:
    """The simulated robot. Its time is ``start_stamp`` [ns] plus whole sampling times."""

    def __init__(self, config: WorldConfig, start_stamp: int = 0) -> None:
        """Put the robot at the start, step 0."""
        self.start_stamp = start_stamp
        self.period = round(config.plant.sampling_time * NS_PER_S)
        self.state = new_plant(Pose(*config.start))
        self.odometry_P: Array = np.zeros((3, 3))
        """covariance of the odometry's pose"""
        self._source = NoiseSource()
        self._noise = quiet_noise(len(config.landmarks.landmark_ids))
        self._noise_step = -1
        self._fix_errors = NO_ERRORS
        self._fixes: list[tuple[int, PoseReading]] = []
        self._detections: list[tuple[int, PoseReading]] = []
        # For the longest delay that can be set at run time.
        self._commands = np.zeros((command_rows(MAX_COMMAND_LATENCY, config.plant.sampling_time), 2))
        self.config = config

    def configure(self, config: WorldConfig) -> None:
        """Apply noise bounds, rates and faults from the next step on. Sampling time and landmarks cannot change."""
        self.config, self._noise_step = config, -1

    @property
    def stamp(self) -> int:
        """Return the time [ns] of the present state."""
        return self.start_stamp + self.state.step * self.period

    def _step_noise(self) -> Any:
        """Return the noise (purposes, 4) of the present step."""
        config, step = self.config, self.state.step
        if self._noise_step != step:
            purposes = purposes_of(config.sensors, len(config.landmarks.landmark_ids), config.plant.slip_noise)
            self._source.rows(config.seed, config.run, step, self._noise, purposes)
            self._noise_step = step
        return self._noise[:, 0]

    def advance(self, command: Twist) -> None:
        """Hold ``command`` for one sampling time. It reaches the wheels after ``command_delay``."""
        before, plant, detector = self.state, self.config.plant, self.config.sensors.detector
        arrived = delayed_command(self._commands, before.step, command, plant.command_delay, plant.sampling_time)
        self.state = plant_step(before, arrived, self._step_noise(), plant)
        if self.touches_dock_at(before.pose):
            self.state = stopped_by_dock(before, self.state, detector)
        self._propagate_odometry_covariance(before.odometry)

    def touches_dock_at(self, pose: Pose) -> bool:
        """Return True if there is a detector and a robot at ``pose`` touches its dock."""
        detector = self.config.sensors.detector
        return detector.detection_rate > 0.0 and touches_dock(pose, detector)

    def odometry(self) -> OdometryStep:
        """Return the mean twist over the last step as measured by the encoders, with its covariance."""
        plant, encoder = self.config.plant, self.state.encoder
        covariance = encoder_covariance(encoder, plant.encoder_noise, plant.wheels)
        return OdometryStep(self.stamp, body_twist(encoder, plant.wheels), covariance)

    def _propagate_odometry_covariance(self, before: Pose) -> None:
        _, twist, (var_v, cov, var_omega) = self.odometry()
        t_s, after = self.config.plant.sampling_time, self.state.odometry
        dx, dy = after.x - before.x, after.y - before.y
        middle = before.theta + 0.5 * t_s * twist.omega
        F = np.array(((1.0, 0.0, -dy), (0.0, 1.0, dx), (0.0, 0.0, 1.0)))
        G = t_s * np.array(((math.cos(middle), -0.5 * dy), (math.sin(middle), 0.5 * dx), (0.0, 1.0)))
        M = np.array(((var_v, cov), (cov, var_omega)))
        self.odometry_P = F.dot(self.odometry_P).dot(F.T) + G.dot(M).dot(G.T)

    def sense(self) -> Arrivals:
        """Measure, and return the measurements that arrive. Call it once at each step, including step 0."""
        sensors, step, noise, pose = self.config.sensors, self.state.step, self._step_noise(), self.state.pose
        t_s, headings = self.config.plant.sampling_time, []
        if is_due(step, sensors.fix_rate, t_s):
            fix = measured_fix(pose, self._fix_errors, noise, sensors)
            self._fix_errors = fix.errors
            if not fix.lost:
                reading = PoseReading(self.stamp, fix.pose, np.diag(fix_variances(sensors)))
                self._fixes.append((step + delay_in_steps(sensors.fix_delay, t_s), reading))
        if is_due(step, sensors.heading_rate, t_s):
            R = np.array([[uniform_variance(sensors.heading_error_max)]])
            headings.append(HeadingReading(self.stamp, measured_heading(pose, noise, sensors), R))
        if is_due(step, sensors.detector.detection_rate, t_s):
            found = detected_dock(pose, noise, sensors.detector)
            if not found.lost:
                R = np.diag(np.square((found.sigma, found.sigma, found.yaw_sigma)))
                arrival = step + delay_in_steps(sensors.detector.detection_delay, t_s)
                self._detections.append((arrival, PoseReading(self.stamp, found.pose, R)))
        landmarks = self._measure_landmarks(noise) if is_due(step, sensors.landmark_rate, t_s) else []
        return Arrivals(_arrived(self._fixes, step), headings, landmarks, _arrived(self._detections, step))

    def _measure_landmarks(self, noise: Any) -> list[LandmarkReading]:
        sensors, pose = self.config.sensors, self.state.pose
        bounds = sensors.landmark_range_error_max, sensors.landmark_bearing_error_max
        R, found = np.diag([uniform_variance(bound) for bound in bounds]), []
        for index, (number, point) in enumerate(self.config.landmarks.points().items()):
            if in_range(pose, point.x, point.y, sensors):
                measured = measured_landmark(pose, index, point.x, point.y, noise, sensors)
                found.append(LandmarkReading(self.stamp, *measured, R, number, point))
        return found

    def turn_rate(self) -> GyroSample | None:
        """Return the gyro's turn rate over the last step; None if the gyro does not measure at this step."""
        sensors = self.config.sensors
        if not is_gyro_due(self.state.step, sensors, self.config.plant.sampling_time):
            return None
        rate = measured_turn_rate(self.state.twist.omega, self._step_noise(), sensors)
        return GyroSample(self.stamp, rate, uniform_variance(GYRO_ERROR_MAX))


def _arrived(waiting: list[tuple[int, PoseReading]], step: int) -> list[PoseReading]:
    """Remove and return the readings that arrive at ``step``, oldest first."""
    ready = [reading for arrival, reading in waiting if arrival <= step]
    waiting[:] = [one for one in waiting if one[0] > step]
    return ready
