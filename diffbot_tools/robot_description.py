"""The description of a robot and its parameter file. Every command imports this module, so it imports nothing heavy."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import (
    ACCELERATION,
    ANGLE,
    ANGULAR_ACCELERATION,
    LENGTH,
    SPEED,
    TURN_RATE,
    WHEEL_SIZE,
    Spec,
    known_fields,
    to_dict,
)

_RATE, _SHARE = (0.1, 1000.0), (0.0, 0.5)
_TEMPLATE = """\
# Drive it in the simulation: diffbot robot drive {name}
# On the robot: ros2 launch diffbot robot.launch.py parameters:={name}
/**: # the data sheet, for controller, ekf and plant
  ros__parameters:
    wheel_radius: {wheel_radius} # [m]
    wheel_separation: {wheel_separation} # [m], between the middles of the tyres
    linear.x.max_velocity: {linear.x.max_velocity} # [m/s]; for the first drives, half of the possible speed
    angular.z.max_velocity: {angular.z.max_velocity} # [rad/s]
    wheel.max_velocity: {max_wheel} # [rad/s], of each wheel
    linear.x.max_acceleration: {linear.x.max_acceleration} # [m/s^2]
    angular.z.max_acceleration: {angular.z.max_acceleration} # [rad/s^2]
    command_latency: {command_latency} # [s], from a pose's stamp to the motion that its command causes
    drive_time_constant: {drive_time_constant} # [s]
/**/controller:
  ros__parameters:
    xy_goal_tolerance: {xy_goal_tolerance} # [m]
    yaw_goal_tolerance: {yaw_goal_tolerance} # [rad]
/**/ekf:
  ros__parameters:
    odometry_noise: motion # ignore the covariance of odom, which is often missing or arbitrary
    global_pose_sigma_xy: {global_pose_sigma_xy} # [m], for a global_pose without covariance
    global_pose_sigma_yaw: {global_pose_sigma_yaw} # [rad]
    use_gyro: {use_gyro} # true: use the gyro on the topic imu
/**/plant: # the simulated robot; a real one does not read this section
  ros__parameters:
    initial_pose.x: 0.0 # [m]
    initial_pose.y: 0.0 # [m]
    initial_pose.yaw: 0.0 # [rad]
    sampling_time: {period} # [s], the period of odom
    fix_rate: {fix_rate} # [Hz], rate of global_pose
    fix_delay: {fix_delay} # [s], age of a global_pose when it arrives
    eps_xy_max: {eps_xy} # [m], 1.73 times the standard deviation
    eps_theta_max: {eps_yaw} # [rad]
    fix_noise_correlation: {correlation} # correlation of the errors of two consecutive poses
    gyro_rate: {gyro_rate} # [Hz], rate of imu
    slip_noise: {slip_noise} # share of the wheels' motion that is lost by slip, 1.25 times the typical share
    left_radius_error: 0.01 # the real wheels differ from the data sheet
    separation_error: -0.01
"""


@known_fields
class RobotDescription(NamedTuple):
    """Description of a robot. The defaults describe a small robot that is localized by AMCL.

    A field that is a parameter of a node has the name of the parameter, with ``_`` for the dots.
    """

    wheel_radius: Annotated[float, Spec("wheel radius", "m", *WHEEL_SIZE)] = 0.033
    wheel_separation: Annotated[float, Spec("distance between the middles of the tyres", "m", *WHEEL_SIZE)] = 0.16
    linear_x_max_velocity: Annotated[float, Spec("largest speed", "m/s", *SPEED, parameter="linear.x.max_velocity")] = (
        0.2
    )
    angular_z_max_velocity: Annotated[
        float, Spec("largest turn rate", "rad/s", *TURN_RATE, parameter="angular.z.max_velocity")
    ] = 2.0
    linear_x_max_acceleration: Annotated[
        float, Spec("largest acceleration", "m/s^2", *ACCELERATION, parameter="linear.x.max_acceleration")
    ] = 1.0
    angular_z_max_acceleration: Annotated[
        float,
        Spec("largest angular acceleration", "rad/s^2", *ANGULAR_ACCELERATION, parameter="angular.z.max_acceleration"),
    ] = 4.0
    command_latency: Annotated[
        float, Spec("time from a pose's stamp to the motion that its command causes", "s", 0.0, 2.0)
    ] = 0.1
    drive_time_constant: Annotated[float, Spec("time in which the drives reach 63 % of a new speed", "s", 0.0, 2.0)] = (
        0.05
    )
    odometry_rate: Annotated[float, Spec("rate of odom", "Hz", *_RATE)] = 20.0
    use_gyro: Annotated[bool, Spec("a gyro on the topic imu")] = False
    slip: Annotated[float, Spec("typical share of the wheels' motion that is lost by slip", "-", *_SHARE)] = 0.0
    fix_rate: Annotated[float, Spec("rate of global_pose: AMCL, markers, motion capture, GNSS ...", "Hz", *_RATE)] = 5.0
    fix_delay: Annotated[float, Spec("age of a global_pose when it arrives", "s", 0.0, 1.0)] = 0.1
    global_pose_sigma_xy: Annotated[float, Spec("standard deviation of x and y of global_pose", "m", 1e-4, 10.0)] = 0.03
    global_pose_sigma_yaw: Annotated[
        float, Spec("standard deviation of the heading of global_pose", "rad", 1e-4, math.pi)
    ] = 0.03
    pose_correlation: Annotated[
        float, Spec("correlation time of the errors of global_pose; 0: independent errors", "s", 0.0, 1000.0)
    ] = 0.0
    xy_goal_tolerance: Annotated[float, Spec("largest distance from a reached goal", "m", *LENGTH)] = 0.1
    yaw_goal_tolerance: Annotated[float, Spec("largest heading error at a reached goal", "rad", *ANGLE)] = 0.1

    def check(self) -> None:
        """Check that ``fix_rate`` is at most ``odometry_rate``: the plant measures at most one global_pose per step.

        Raises:
            InvalidValueError: if ``fix_rate`` is larger.
        """
        if self.fix_rate > self.odometry_rate:
            raise InvalidValueError("fix_rate", self.fix_rate, f"<= odometry_rate, {self.odometry_rate:g}")


PRESETS = {
    "turtlebot3_burger": RobotDescription(
        linear_x_max_velocity=0.22, angular_z_max_velocity=2.84, linear_x_max_acceleration=2.5,
        angular_z_max_acceleration=3.2, pose_correlation=2.0, xy_goal_tolerance=0.25, yaw_goal_tolerance=0.25,
    ),
    "turtlebot4": RobotDescription(
        wheel_radius=0.03575, wheel_separation=0.233, linear_x_max_velocity=0.31, angular_z_max_velocity=1.9,
        linear_x_max_acceleration=0.9, angular_z_max_acceleration=7.7, command_latency=0.12, use_gyro=True,
        pose_correlation=2.0, xy_goal_tolerance=0.15, yaw_goal_tolerance=0.15,
    ),
    "warehouse_agv": RobotDescription(
        wheel_radius=0.1, wheel_separation=0.55, linear_x_max_velocity=1.5, angular_z_max_velocity=1.2,
        linear_x_max_acceleration=0.7, angular_z_max_acceleration=1.5, command_latency=0.15, drive_time_constant=0.15,
        fix_rate=10.0, global_pose_sigma_xy=0.01, global_pose_sigma_yaw=0.006, xy_goal_tolerance=0.05,
        yaw_goal_tolerance=0.05,
    ),
    "gnss_mower": RobotDescription(
        wheel_radius=0.125, wheel_separation=0.42, linear_x_max_velocity=0.5, angular_z_max_velocity=1.0,
        linear_x_max_acceleration=0.6, angular_z_max_acceleration=1.5, command_latency=0.15, drive_time_constant=0.2,
        use_gyro=True, slip=0.03, fix_delay=0.2, global_pose_sigma_xy=0.02, global_pose_sigma_yaw=0.04,
        pose_correlation=10.0, xy_goal_tolerance=0.15, yaw_goal_tolerance=0.2,
    ),
}  # fmt: skip
"""Robots to start from: two TurtleBots by their data sheets, and two typical robots."""


def file_of_robot(robot: RobotDescription, name: str = "my_robot.yaml") -> str:
    """Return the text of a robot's parameter file; ``name`` is the name of the file."""
    rim_speed = max(robot.linear_x_max_velocity, 0.5 * robot.angular_z_max_velocity * robot.wheel_separation)
    correlation = math.exp(-1.0 / (robot.fix_rate * robot.pose_correlation)) if robot.pose_correlation else 0.0
    values = {
        **to_dict(robot),
        "max_wheel": rim_speed / robot.wheel_radius,
        "period": 1.0 / robot.odometry_rate,
        "eps_xy": math.sqrt(3.0) * robot.global_pose_sigma_xy,
        # The values are rounded to six digits. They must not exceed the bounds of the plant.
        "eps_yaw": min(math.sqrt(3.0) * robot.global_pose_sigma_yaw, 3.141592),
        "correlation": min(correlation, 0.999),
        "gyro_rate": robot.odometry_rate if robot.use_gyro else 0.0,
        "slip_noise": robot.slip / 0.8,
        "use_gyro": str(robot.use_gyro).lower(),
        "name": name,
    }
    text = _TEMPLATE
    for key, value in values.items():
        text = text.replace(f"{{{key}}}", str(round(value, 6) if isinstance(value, float) else value))
    parts = (line.partition(" # ") for line in text.splitlines())
    return "".join(f"{line:<44} # {comment}\n" if comment else f"{line}\n" for line, _, comment in parts)
