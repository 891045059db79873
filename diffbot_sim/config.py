"""Configurations of the simulated robot: plant, sensors, start and seed."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.filter.config import LandmarkMap
from diffbot_core.data_sheet import CommandLatency, MaxAcceleration, MaxAngularAcceleration
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import WheelGeometry
from diffbot_core.schema import DISTANCE, HEADING, POSITION, TIME, TIMEOUT, WHEEL_SPEED, Spec, known_fields

_INF = math.inf
_ADDED = 0.0, 1e3
"""[m/s], [rad/s] allowed range of the bounds of the noise that is added to the twist"""
_RATE = 0.0, 1000.0
"""[Hz]"""
_DELAY = 0.0, 60.0
"""[s]"""
_SHARE = 0.0, 1.0


@known_fields
class PlantConfig(NamedTuple):
    """The robot and its faults. The defaults are the paper's robot with noise of +-5 % in each drive and encoder.

    The dead time and the acceleration limits have the same names as in the controller's data sheet, so that the section
    ``/**`` of a parameter file sets both.
    """

    wheels: WheelGeometry = WheelGeometry()
    sampling_time: Annotated[float, Spec("sampling time Ts", "s", minimum=1e-3, maximum=10.0, read_only=True)] = 0.1
    exact_arc: Annotated[bool, Spec("integrate along the exact arc; false: by Euler's method, Eq. (3)")] = True
    drive_noise: Annotated[float, Spec("bound of the relative error of each wheel's speed", "-", *_SHARE)] = 0.05
    eps_v_max: Annotated[float, Spec("bound of the noise added to v (paper: 0.065)", "m/s", *_ADDED)] = 0.0
    eps_omega_max: Annotated[float, Spec("bound of the noise added to omega (paper: 0.2167)", "rad/s", *_ADDED)] = 0.0
    encoder_noise: Annotated[float, Spec("bound of the relative error of each encoder's speed", "-", *_SHARE)] = 0.05
    left_radius_error: Annotated[float, Spec("relative error of the left wheel's radius", "-", -0.5, 0.5)] = 0.0
    right_radius_error: Annotated[float, Spec("relative error of the right wheel's radius", "-", -0.5, 0.5)] = 0.0
    separation_error: Annotated[float, Spec("relative error of the distance between the wheels", "-", -0.5, 0.5)] = 0.0
    slip_noise: Annotated[
        float,
        Spec(
            "scale of the half-normal distribution of the share of its motion that a wheel loses in each step; the mean"
            " share is 0.8 times the scale",
            "-",
            *_SHARE,
        ),
    ] = 0.0
    slip_right: Annotated[float, Spec("share of the right wheel's motion lost while it slips", "-", *_SHARE)] = 0.0
    slip_start: Annotated[float, Spec("time at which the slip begins", "s", *TIME)] = 0.0
    slip_duration: Annotated[float, Spec("duration of the slip", "s", *TIME)] = 0.0
    kidnap_time: Annotated[float, Spec("time at which the robot is kidnapped; 0: never", "s", *TIME)] = 0.0
    kidnap_x: Annotated[float, Spec("displacement of the kidnapped robot along x of map", "m", *POSITION)] = 0.0
    kidnap_yaw: Annotated[float, Spec("rotation of the kidnapped robot", "rad", -math.pi, math.pi)] = 0.0
    command_delay: CommandLatency = 0.0
    drive_time_constant: Annotated[
        float, Spec("time constant of the drives' first-order lag; 0: no lag", "s", 0.0, 10.0)
    ] = 0.0
    acceleration_max: MaxAcceleration = _INF
    angular_acceleration_max: MaxAngularAcceleration = _INF
    wheel_speed_max: Annotated[float, Spec("largest |speed| of a wheel", "rad/s", *WHEEL_SPEED, allow_inf=True)] = _INF
    dead_band: Annotated[float, Spec("smallest |speed| at which a wheel turns", "rad/s", 0.0, 1000.0)] = 0.0
    cmd_vel_timeout: Annotated[float, Spec("time without a command after which the robot stops", "s", *TIMEOUT)] = 0.5


@known_fields
class DetectorConfig(NamedTuple):
    """Pose of the dock, and its detector. The errors of detections are uniform and independent."""

    dock_x: Annotated[float, Spec("x of the docked robot in map", "m", *POSITION)] = 0.0
    dock_y: Annotated[float, Spec("y of the docked robot in map", "m", *POSITION)] = 0.0
    dock_yaw: Annotated[float, Spec("heading of the docked robot in map", "rad", *HEADING)] = 0.0
    detection_rate: Annotated[
        float, Spec("rate of detected_dock_pose, at most one per step; 0: none", "Hz", *_RATE)
    ] = 0.0
    detection_delay: Annotated[float, Spec("time from a measurement to its arrival", "s", *_DELAY)] = 0.1
    detection_dropout: Annotated[float, Spec("share of detections that are lost", "-", *_SHARE)] = 0.2
    detection_outlier: Annotated[float, Spec("share of detections that are 0.5 m off", "-", *_SHARE)] = 0.0
    detection_behind: Annotated[bool, Spec("true if the robot docks with its rear")] = False


@known_fields
class SensorConfig(NamedTuple):
    """The paper's measurement noise (section 4.1, uniform within bounds), further sensors and faults."""

    fix_rate: Annotated[float, Spec("rate of global_pose, at most one per step; 0: none", "Hz", *_RATE)] = 10.0
    eps_xy_max: Annotated[float, Spec("bound of the errors of x and y of a fix", "m", *DISTANCE)] = 0.3
    eps_theta_max: Annotated[float, Spec("bound of the error of theta of a fix", "rad", 0.0, math.pi)] = 0.17
    eps_xy_distance: Annotated[
        float,
        Spec(
            "radius around the origin of map within which the errors of x and y are proportional to the distance from"
            " the origin; 0: the errors are the same everywhere",
            "m",
            *DISTANCE,
        ),
    ] = 0.0
    fix_delay: Annotated[float, Spec("time from a measurement to its arrival", "s", *_DELAY)] = 0.0
    fix_noise_correlation: Annotated[
        float,
        Spec("AR(1) correlation of the errors of successive fixes; it does not change their variance", "-", 0.0, 0.999),
    ] = 0.0
    fix_dropout: Annotated[float, Spec("share of fixes that are lost", "-", *_SHARE)] = 0.0
    fix_outlier: Annotated[float, Spec("share of fixes that are 3 m off", "-", *_SHARE)] = 0.0
    fix_covariance_scale: Annotated[
        float, Spec("covariance in the messages of fixes, relative to the true covariance", "-", 1e-6, 1e6)
    ] = 1.0
    heading_rate: Annotated[float, Spec("rate of heading; 0: none", "Hz", *_RATE)] = 0.0
    heading_error_max: Annotated[float, Spec("bound of the error of a heading", "rad", 0.0, math.pi)] = 0.087
    landmark_rate: Annotated[float, Spec("rate of landmarks; 0: none", "Hz", *_RATE)] = 0.0
    landmark_range: Annotated[float, Spec("distance up to which landmarks are measured", "m", *DISTANCE)] = 15.0
    landmark_range_error_max: Annotated[float, Spec("bound of the error of a range", "m", *DISTANCE)] = 0.1
    landmark_bearing_error_max: Annotated[float, Spec("bound of the error of a bearing", "rad", 0.0, math.pi)] = 0.05
    gyro_rate: Annotated[float, Spec("rate of imu, at most one per step; 0: none", "Hz", *_RATE)] = 0.0
    gyro_bias: Annotated[float, Spec("constant error of the turn rate", "rad/s", -1.0, 1.0)] = 0.02
    detector: DetectorConfig = DetectorConfig()


@known_fields
class StartPose(NamedTuple):
    """Initial pose of the robot. The default is the start of the paper's simulation A."""

    x: Annotated[float, Spec("start x in map", "m", *POSITION, parameter="initial_pose.x")] = -2.0
    y: Annotated[float, Spec("start y in map", "m", *POSITION, parameter="initial_pose.y")] = -5.5
    theta: Annotated[float, Spec("start heading in map", "rad", *HEADING, parameter="initial_pose.yaw")] = (
        0.5235987755982988
    )


@known_fields
class WorldConfig(NamedTuple):
    """Plant, sensors, start, and seed of all random numbers."""

    plant: PlantConfig = PlantConfig()
    sensors: SensorConfig = SensorConfig()
    start: StartPose = StartPose()
    seed: Annotated[int, Spec("seed of all noise", minimum=0, maximum=2**63 - 1)] = 1
    run: Annotated[int, Spec("number of the run under this seed", minimum=0, maximum=2**63 - 1)] = 0
    landmarks: LandmarkMap = LandmarkMap()


def dock_pose(config: DetectorConfig) -> Pose:
    """Return the pose of the docked robot in map."""
    return Pose(config.dock_x, config.dock_y, config.dock_yaw)
