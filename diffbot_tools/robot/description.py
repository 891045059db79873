"""What has to be known of a robot, and the parameter file made of it."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_core.errors import InvalidValueError
from diffbot_core.ranges import ACCELERATION, ANGLE, ANGULAR_ACCELERATION, LENGTH, SPEED, TURN_RATE, WHEEL_SIZE
from diffbot_core.schema import Spec, known_fields

_RATE, _SHARE = (0.1, 1000.0), (0.0, 0.5)
_TEMPLATE = """\
# Drive it in the simulation: diffbot robot drive {name}
# On the robot: ros2 launch diffbot robot.launch.py parameters:={name}
/**: # the data sheet, read by controller, ekf and plant
  ros__parameters:
    wheel_radius: {wheel_radius} # [m]
    wheel_separation: {wheel_separation} # [m], between the middles of the tyres
    linear.x.max_velocity: {max_velocity} # [m/s]; for the first drives, half of what it can do
    angular.z.max_velocity: {max_rotation} # [rad/s]
    wheel.max_velocity: {max_wheel} # [rad/s] of each wheel
    linear.x.max_acceleration: {max_acceleration} # [m/s^2]
    angular.z.max_acceleration: {max_angular_acceleration} # [rad/s^2]
    command_latency: {command_latency} # [s], from a pose's stamp to the motion that it causes
    drive_time_constant: {drive_time_constant} # [s]
/**/controller:
  ros__parameters:
    xy_goal_tolerance: {xy_goal_tolerance} # [m]
    yaw_goal_tolerance: {yaw_goal_tolerance} # [rad]
/**/ekf:
  ros__parameters:
    odometry_noise: motion # odom has no covariance, or a made-up one
    global_pose_sigma_xy: {pose_sigma_xy} # [m], for a global_pose without covariance
    global_pose_sigma_yaw: {pose_sigma_yaw} # [rad]
    use_gyro: {gyro} # imu
/**/plant: # the simulated robot; a real one does not read this section
  ros__parameters:
    initial_pose.x: 0.0 # [m]
    initial_pose.y: 0.0 # [m]
    initial_pose.yaw: 0.0 # [rad]
    sampling_time: {period} # [s], the period of odom
    fix_rate: {pose_rate} # [Hz] of global_pose
    fix_delay: {pose_delay} # [s], its age
    eps_x_max: {eps_xy} # [m], 1.73 times the standard deviation
    eps_y_max: {eps_xy} # [m]
    eps_theta_max: {eps_yaw} # [rad]
    fix_noise_correlation: {correlation} # from pose to pose
    gyro_rate: {gyro_rate} # [Hz] of imu
    slip_noise: {slip_noise} # share of the wheels' motion lost on the ground, 1.25 times its mean
    left_radius_error: 0.01 # the wheels are not exactly as the data sheet says
    separation_error: -0.01
"""


@known_fields
class RobotDescription(NamedTuple):
    """Answers about a robot; the defaults are a small one's that finds itself by AMCL."""

    wheel_radius: Annotated[float, Spec("wheel radius", "m", *WHEEL_SIZE)] = 0.033
    wheel_separation: Annotated[float, Spec("distance between the middles of the tyres", "m", *WHEEL_SIZE)] = 0.16
    max_velocity: Annotated[float, Spec("largest speed", "m/s", *SPEED)] = 0.2
    max_rotation: Annotated[float, Spec("largest turn rate", "rad/s", *TURN_RATE)] = 2.0
    max_acceleration: Annotated[float, Spec("largest acceleration", "m/s^2", *ACCELERATION)] = 1.0
    max_angular_acceleration: Annotated[
        float, Spec("largest angular acceleration", "rad/s^2", *ANGULAR_ACCELERATION)
    ] = 4.0
    command_latency: Annotated[
        float, Spec("time from a pose's stamp to the motion that its command causes", "s", 0.0, 2.0)
    ] = 0.1
    drive_time_constant: Annotated[float, Spec("time in which the drives reach 63 % of a new speed", "s", 0.0, 2.0)] = (
        0.05
    )
    odometry_rate: Annotated[float, Spec("rate of odom", "Hz", *_RATE)] = 20.0
    gyro: Annotated[bool, Spec("a gyro on the topic imu")] = False
    slip: Annotated[float, Spec("typical share of the wheels' motion that is lost on the ground", "-", *_SHARE)] = 0.0
    pose_rate: Annotated[float, Spec("rate of global_pose: AMCL, markers, motion capture, GNSS ...", "Hz", *_RATE)] = (
        5.0
    )
    pose_delay: Annotated[float, Spec("age of such a pose when it arrives", "s", 0.0, 1.0)] = 0.1
    pose_sigma_xy: Annotated[float, Spec("standard deviation of its x and y", "m", 1e-4, 10.0)] = 0.03
    pose_sigma_yaw: Annotated[float, Spec("standard deviation of its heading", "rad", 1e-4, math.pi)] = 0.03
    pose_correlation: Annotated[
        float, Spec("how long its errors last; 0: each pose has a new one", "s", 0.0, 1000.0)
    ] = 0.0
    xy_goal_tolerance: Annotated[float, Spec("distance from the goal that counts as reached", "m", *LENGTH)] = 0.1
    yaw_goal_tolerance: Annotated[float, Spec("heading error that counts as reached", "rad", *ANGLE)] = 0.1

    def check(self) -> None:
        """Refuse poses that come more often than the odometry, which the plant cannot simulate.

        Raises:
            InvalidValueError: if they do.
        """
        if self.pose_rate > self.odometry_rate:
            raise InvalidValueError("pose_rate", self.pose_rate, f"<= odometry_rate, {self.odometry_rate:g}")


PRESETS = {
    "turtlebot3_burger": RobotDescription(
        max_velocity=0.22, max_rotation=2.84, max_acceleration=2.5, max_angular_acceleration=3.2,
        pose_correlation=2.0, xy_goal_tolerance=0.25, yaw_goal_tolerance=0.25,
    ),
    "turtlebot4": RobotDescription(
        wheel_radius=0.03575, wheel_separation=0.233, max_velocity=0.31, max_rotation=1.9, max_acceleration=0.9,
        max_angular_acceleration=7.7, command_latency=0.12, gyro=True,
        pose_correlation=2.0, xy_goal_tolerance=0.15, yaw_goal_tolerance=0.15,
    ),
    "warehouse_agv": RobotDescription(
        wheel_radius=0.1, wheel_separation=0.55, max_velocity=1.5, max_rotation=1.2, max_acceleration=0.7,
        max_angular_acceleration=1.5, command_latency=0.15, drive_time_constant=0.15,
        pose_rate=10.0, pose_sigma_xy=0.01, pose_sigma_yaw=0.006, xy_goal_tolerance=0.05, yaw_goal_tolerance=0.05,
    ),
    "gnss_mower": RobotDescription(
        wheel_radius=0.125, wheel_separation=0.42, max_velocity=0.5, max_rotation=1.0, max_acceleration=0.6,
        max_angular_acceleration=1.5, command_latency=0.15, drive_time_constant=0.2, gyro=True, slip=0.03,
        pose_delay=0.2, pose_sigma_xy=0.02, pose_sigma_yaw=0.04, pose_correlation=10.0,
        xy_goal_tolerance=0.15, yaw_goal_tolerance=0.2,
    ),
}  # fmt: skip
"""Robots to start from: those of TurtleBot's data sheets, and two typical ones."""


def file_of_robot(robot: RobotDescription, name: str = "my_robot.yaml") -> str:
    """Return the text of a robot's parameter file, with the data sheet once; ``name`` is that of the file."""
    wheel = max(robot.max_velocity, 0.5 * robot.max_rotation * robot.wheel_separation) / robot.wheel_radius
    root = math.sqrt(3.0)
    values = {
        **robot._asdict(),
        "max_wheel": wheel,
        "period": 1.0 / robot.odometry_rate,
        "eps_xy": root * robot.pose_sigma_xy,
        "eps_yaw": min(root * robot.pose_sigma_yaw, math.pi),
        "correlation": math.exp(-1.0 / (robot.pose_rate * robot.pose_correlation)) if robot.pose_correlation else 0.0,
        "gyro_rate": robot.odometry_rate if robot.gyro else 0.0,
        "slip_noise": robot.slip / 0.8,
        "gyro": str(robot.gyro).lower(),
    }
    plain = {key: round(value, 6) if isinstance(value, float) else value for key, value in values.items()}
    lines = _TEMPLATE.format(name=name, **plain).splitlines()
    parts = (line.partition(" # ") for line in lines)
    return "".join(f"{text:<44} # {comment}\n" if comment else f"{text}\n" for text, _, comment in parts)
