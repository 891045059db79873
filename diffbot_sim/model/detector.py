"""A detector of a dock, camera-like or lidar-like: it measures the dock's pose in the frame of the robot."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.filter.dock import FixNoise, noise_at_dock, robot_at_dock
from diffbot_core.geometry import Pose, into_frame, wrap_angle
from diffbot_core.ranges import DISTANCE, HEADING, POSITION
from diffbot_core.schema import Spec, known_fields
from diffbot_sim.model.philox import DETECTION_BLOCK, DETECTION_FAULT_BLOCK, NoiseKey, direction, draw, probability

_BOUND = math.sqrt(3.0)
"""Bound of a uniform error in standard deviations."""


@known_fields
class DetectorConfig(NamedTuple):
    """Where the dock is, and how well it is seen. Errors are uniform, independent from detection to detection."""

    dock_x: Annotated[float, Spec("x of the docked robot in map", "m", *POSITION)] = 0.0
    dock_y: Annotated[float, Spec("y of the docked robot in map", "m", *POSITION)] = 0.0
    dock_yaw: Annotated[float, Spec("heading of the docked robot in map", "rad", *HEADING)] = 0.0
    detection_rate: Annotated[
        float, Spec("rate of detected_dock_pose; 0: none; at most one a step", "Hz", minimum=0.0, maximum=1000.0)
    ] = 0.0
    detection_sigma: Annotated[float, Spec("deviation of x and of y at the dock", "m", *DISTANCE)] = 0.01
    detection_sigma_per_metre: Annotated[
        float, Spec("what a metre of distance adds to it", "m/m", minimum=0.0, maximum=1.0)
    ] = 0.01
    detection_yaw_sigma: Annotated[float, Spec("deviation of the heading at the dock", "rad", 0.0, 1.0)] = 0.02
    detection_yaw_sigma_per_metre: Annotated[
        float, Spec("what a metre of distance adds to it", "rad/m", minimum=0.0, maximum=1.0)
    ] = 0.01
    detection_delay: Annotated[float, Spec("time from measuring to arriving", "s", minimum=0.0, maximum=60.0)] = 0.1
    detection_dropout: Annotated[float, Spec("share of detections that are lost", minimum=0.0, maximum=1.0)] = 0.2
    detection_outlier: Annotated[float, Spec("share of detections that are outliers", minimum=0.0, maximum=1.0)] = 0.0
    detection_outlier_distance: Annotated[float, Spec("how far an outlier is off", "m", *DISTANCE)] = 0.5
    detection_nearest: Annotated[float, Spec("nearer than this the dock is not seen", "m", *DISTANCE)] = 0.3
    detection_farthest: Annotated[float, Spec("farther than this the dock is not seen", "m", *DISTANCE)] = 8.0
    detection_half_angle: Annotated[
        float, Spec("the dock is seen within this bearing of the leading end; pi: all round", "rad", 0.0, math.pi)
    ] = math.pi
    detection_behind: Annotated[bool, Spec("the detector looks backwards")] = False


DOCK_HALF_WIDTH = 0.2
"""[m] of the dock that the robot runs against"""


class Detection(NamedTuple):
    """What the detector measures at a step."""

    pose: Pose
    """[m, m, rad] of the dock in the frame of the robot"""
    sigma: float
    """[m] deviation of its x and of its y"""
    yaw_sigma: float
    """[rad] of its heading"""
    lost: bool
    """there is none: not in view, or lost"""


def dock_of(config: DetectorConfig) -> Pose:
    """Return the pose of the docked robot in map."""
    return Pose(config.dock_x, config.dock_y, config.dock_yaw)


def in_view(seen: Pose, config: DetectorConfig) -> bool:
    """Return True if the detector can see the dock at this pose in the robot's frame."""
    distance = math.sqrt(seen.x * seen.x + seen.y * seen.y)
    bearing = math.atan2(seen.y, seen.x)
    if config.detection_behind:
        bearing = wrap_angle(bearing + math.pi)
    return (
        config.detection_nearest <= distance <= config.detection_farthest
        and abs(bearing) <= config.detection_half_angle
    )


def detection_at(key: NoiseKey, pose: Pose, config: DetectorConfig) -> Detection:
    """Measure the dock from the true ``pose`` in map at a step."""
    seen = into_frame(dock_of(config), pose)
    distance = math.sqrt(seen.x * seen.x + seen.y * seen.y)
    sigma, yaw_sigma = deviations_at(distance, config)
    noise = draw(key.seed, key.run, key.step, DETECTION_BLOCK)
    x = seen.x + _BOUND * sigma * noise.a
    y = seen.y + _BOUND * sigma * noise.b
    fault = draw(key.seed, key.run, key.step, DETECTION_FAULT_BLOCK)
    if probability(fault.b) < config.detection_outlier:
        angle = direction(fault.c)
        x += config.detection_outlier_distance * math.cos(angle)
        y += config.detection_outlier_distance * math.sin(angle)
    measured = Pose(x, y, wrap_angle(seen.theta + _BOUND * yaw_sigma * noise.c))
    lost = not in_view(seen, config) or probability(fault.a) < config.detection_dropout
    sigma, yaw_sigma = deviations_at(math.sqrt(x * x + y * y), config)
    return Detection(measured, sigma, yaw_sigma, lost)


def deviations_at(distance: float, config: DetectorConfig) -> tuple[float, float]:
    """Return the deviations of position [m] and heading [rad] of a detection at a distance [m], at least 0.1 mm."""
    return (
        max(config.detection_sigma + config.detection_sigma_per_metre * distance, 1e-4),
        max(config.detection_yaw_sigma + config.detection_yaw_sigma_per_metre * distance, 1e-4),
    )


def noise_of(robot: Pose, config: DetectorConfig) -> FixNoise:
    """Return the covariance of the robot's pose in the dock's frame that a detection at this pose claims."""
    sigma, yaw_sigma = deviations_at(math.sqrt(robot.x * robot.x + robot.y * robot.y), config)
    return noise_at_dock(robot, sigma * sigma, yaw_sigma * yaw_sigma)


def meets_dock(pose: Pose, config: DetectorConfig) -> bool:
    """Return True if a robot at ``pose`` in map is not before its dock any more but against it."""
    lateral = into_frame(pose, dock_of(config)).y
    return 0.0 <= depth_at_dock(pose, config) <= DOCK_HALF_WIDTH and abs(lateral) <= DOCK_HALF_WIDTH


def depth_at_dock(pose: Pose, config: DetectorConfig) -> float:
    """Return how far [m] a robot at ``pose`` in map is beyond the docked one."""
    x = into_frame(pose, dock_of(config)).x
    return -x if config.detection_behind else x


def robot_seen(detection: Detection) -> Pose:
    """Return the pose of the robot in the dock's frame by a detection."""
    return robot_at_dock(detection.pose)
