"""What has to be known of a robot, and the parameter file made of it."""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

from diffbot_core.errors import InvalidValueError
from diffbot_core.ranges import ACCELERATION, ANGLE, ANGULAR_ACCELERATION, LENGTH, SPEED, TURN_RATE, WHEEL_SIZE
from diffbot_core.schema import Spec

_RATE, _SHARE = (0.1, 1000.0), (0.0, 0.5)
_UNIFORM = math.sqrt(3.0)
"""bound of a uniform error over its standard deviation"""


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
        max_velocity=0.22,
        max_rotation=2.84,
        max_acceleration=2.5,
        max_angular_acceleration=3.2,
        pose_correlation=2.0,
        xy_goal_tolerance=0.25,
        yaw_goal_tolerance=0.25,
    ),
    "turtlebot4": RobotDescription(
        wheel_radius=0.03575,
        wheel_separation=0.233,
        max_velocity=0.31,
        max_rotation=1.9,
        max_acceleration=0.9,
        max_angular_acceleration=7.7,
        command_latency=0.12,
        gyro=True,
        pose_correlation=2.0,
        xy_goal_tolerance=0.15,
        yaw_goal_tolerance=0.15,
    ),
    "warehouse_agv": RobotDescription(
        wheel_radius=0.1,
        wheel_separation=0.55,
        max_velocity=1.5,
        max_rotation=1.2,
        max_acceleration=0.7,
        max_angular_acceleration=1.5,
        command_latency=0.15,
        drive_time_constant=0.15,
        pose_rate=10.0,
        pose_delay=0.1,
        pose_sigma_xy=0.01,
        pose_sigma_yaw=0.006,
        xy_goal_tolerance=0.05,
        yaw_goal_tolerance=0.05,
    ),
    "gnss_mower": RobotDescription(
        wheel_radius=0.125,
        wheel_separation=0.42,
        max_velocity=0.5,
        max_rotation=1.0,
        max_acceleration=0.6,
        max_angular_acceleration=1.5,
        command_latency=0.15,
        drive_time_constant=0.2,
        gyro=True,
        slip=0.03,
        pose_rate=5.0,
        pose_delay=0.2,
        pose_sigma_xy=0.02,
        pose_sigma_yaw=0.04,
        pose_correlation=10.0,
        xy_goal_tolerance=0.15,
        yaw_goal_tolerance=0.2,
    ),
}
"""Robots to start from: those of TurtleBot's data sheets, and two typical ones."""


def parameters_of_robot(robot: RobotDescription) -> dict[str, dict[str, tuple[Any, str]]]:
    """Return the values of a robot's parameter file with their comments, by section and name.

    The data sheet stands once, in the section of all nodes.
    """
    wheel = max(robot.max_velocity, 0.5 * robot.max_rotation * robot.wheel_separation) / robot.wheel_radius
    correlation = math.exp(-1.0 / (robot.pose_rate * robot.pose_correlation)) if robot.pose_correlation else 0.0
    xy, yaw = _UNIFORM * robot.pose_sigma_xy, min(_UNIFORM * robot.pose_sigma_yaw, math.pi)
    ekf: dict[str, tuple[Any, str]] = {
        "odometry_noise": ("motion", "odom without a covariance, or with a made-up one"),
        "global_pose_sigma_xy": (robot.pose_sigma_xy, "[m], for a global_pose without covariance"),
        "global_pose_sigma_yaw": (robot.pose_sigma_yaw, "[rad]"),
    }
    plant: dict[str, tuple[Any, str]] = {
        "initial_pose.x": (0.0, "[m]"),
        "initial_pose.y": (0.0, "[m]"),
        "initial_pose.yaw": (0.0, "[rad]"),
        "sampling_time": (1.0 / robot.odometry_rate, "[s], the period of odom"),
        "fix_rate": (robot.pose_rate, "[Hz] of global_pose"),
        "fix_delay": (robot.pose_delay, "[s] its age"),
        "eps_x_max": (xy, "[m], 1.73 times the standard deviation"),
        "eps_y_max": (xy, "[m]"),
        "eps_theta_max": (yaw, "[rad]"),
        "fix_noise_correlation": (correlation, "from pose to pose"),
        "slip_noise": (robot.slip / 0.8, "share lost on the ground, 1.25 times its mean"),
        "left_radius_error": (0.01, "the wheels are not exactly as the data sheet says"),
        "separation_error": (-0.01, ""),
    }
    if robot.gyro:
        ekf["use_gyro"] = (True, "imu")
        plant["gyro_rate"] = (robot.odometry_rate, "[Hz] of imu")
    sections: dict[str, dict[str, tuple[Any, str]]] = {
        "/**": {
            "wheel_radius": (robot.wheel_radius, "[m]"),
            "wheel_separation": (robot.wheel_separation, "[m], between the middles of the tyres"),
            "linear.x.max_velocity": (robot.max_velocity, "[m/s]; for the first drives, half of what it can do"),
            "angular.z.max_velocity": (robot.max_rotation, "[rad/s]"),
            "wheel.max_velocity": (wheel, "[rad/s] of each wheel"),
            "linear.x.max_acceleration": (robot.max_acceleration, "[m/s^2]"),
            "angular.z.max_acceleration": (robot.max_angular_acceleration, "[rad/s^2]"),
            "command_latency": (robot.command_latency, "[s], from a pose's stamp to the motion that it causes"),
            "drive_time_constant": (robot.drive_time_constant, "[s]"),
        },
        "/**/controller": {
            "xy_goal_tolerance": (robot.xy_goal_tolerance, "[m]"),
            "yaw_goal_tolerance": (robot.yaw_goal_tolerance, "[rad]"),
        },
        "/**/ekf": ekf,
        "/**/plant": plant,
    }
    return {
        section: {
            name: (round(value, 6) if isinstance(value, float) else value, text) for name, (value, text) in one.items()
        }
        for section, one in sections.items()
    }


_HEADINGS = {
    "/**": "the data sheet, read by controller, ekf and plant",
    "/**/controller": "when a goal counts as reached; more: docs/reference/parameters",
    "/**/ekf": "",
    "/**/plant": "the simulated robot; a real one does not read this section",
}


def file_of_robot(robot: RobotDescription, name: str) -> str:
    """Return the text of a robot's parameter file; ``name`` is that of the file."""
    lines = [
        f"# Drive it in the simulation: diffbot robot drive {name}",
        f"# On the robot: ros2 launch diffbot robot.launch.py parameters:={name}",
    ]
    for section, values in parameters_of_robot(robot).items():
        lines.append(f"{section}:" + (f"  # {_HEADINGS[section]}" if _HEADINGS[section] else ""))
        lines.append("  ros__parameters:")
        for key, (value, comment) in values.items():
            text = f"    {key}: {_yaml(value)}"
            lines.append(f"{text:<44}# {comment}" if comment else text)
    return "\n".join(lines) + "\n"


def _yaml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)
