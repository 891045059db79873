"""Absolute measurements of the true pose: when they are taken, when they arrive, and their errors.

``..._at`` functions name the noise by (seed, run, step); both loops sense with them.

Successive fixes may have correlated errors (``fix_noise_correlation``): e_n = a e_(n-1) + sqrt(1 - a^2) u_n with u_n
uniform within the bound and e_0 = u_0. The variance stays bound^2 / 3 at every fix and the autocorrelation is a^|lag|,
whatever the distribution of u; the errors themselves then reach up to sqrt((1 + a) / (1 - a)) times the bound.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.filter.dock import FixNoise
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose, range_and_bearing, wrap_angle
from diffbot_core.ranges import DISTANCE
from diffbot_core.schema import Spec, known_fields
from diffbot_sim.model.detector import DetectorConfig, detection_at, dock_of, noise_of, robot_seen
from diffbot_sim.model.philox import (
    FAULT_BLOCK,
    FIX_BLOCK,
    GYRO_BLOCK,
    LANDMARK_BLOCK,
    Draw,
    NoiseKey,
    direction,
    draw,
    probability,
)


@known_fields
class SensorConfig(NamedTuple):
    """The paper's measurement noise (section 4.1: uniform within bounds), and faults beyond it."""

    fix_rate: Annotated[
        float,
        Spec("rate of global_pose; 0: none; at most one a step", "Hz", minimum=0.0, maximum=1000.0),
    ] = 10.0
    eps_x_max: Annotated[float, Spec("bound of the error of x", "m", *DISTANCE)] = 0.3
    eps_y_max: Annotated[float, Spec("bound of the error of y", "m", *DISTANCE)] = 0.3
    eps_theta_max: Annotated[float, Spec("bound of the error of theta", "rad", minimum=0.0, maximum=math.pi)] = 0.17
    eps_xy_distance: Annotated[
        float,
        Spec(
            "distance from map's origin within which the errors of x, y shrink in proportion; 0: none",
            "m",
            *DISTANCE,
        ),
    ] = 0.0
    fix_delay: Annotated[float, Spec("time from measuring to arriving", "s", minimum=0.0, maximum=60.0)] = 0.0
    fix_delay_jitter: Annotated[
        float, Spec("bound of a random delay that is added, uniform from 0", "s", minimum=0.0, maximum=60.0)
    ] = 0.0
    fix_noise_correlation: Annotated[
        float,
        Spec("correlation of the errors of successive fixes, AR(1); their variance stays", minimum=0.0, maximum=0.999),
    ] = 0.0
    fix_dropout: Annotated[float, Spec("share of fixes that are lost", minimum=0.0, maximum=1.0)] = 0.0
    fix_outlier: Annotated[float, Spec("share of fixes that are outliers", minimum=0.0, maximum=1.0)] = 0.0
    fix_outlier_distance: Annotated[float, Spec("how far an outlier is off", "m", *DISTANCE)] = 3.0
    fix_covariance_scale: Annotated[
        float, Spec("factor on the covariance that fixes claim; 1: the right one", minimum=1e-6, maximum=1e6)
    ] = 1.0
    heading_rate: Annotated[float, Spec("rate of heading; 0: none", "Hz", minimum=0.0, maximum=1000.0)] = 0.0
    heading_error_max: Annotated[float, Spec("bound of the error of heading", "rad", minimum=0.0, maximum=math.pi)] = (
        0.087
    )
    heading_delay: Annotated[float, Spec("time from measuring to arriving", "s", minimum=0.0, maximum=60.0)] = 0.0
    landmark_rate: Annotated[float, Spec("rate of landmarks; 0: none", "Hz", minimum=0.0, maximum=1000.0)] = 0.0
    landmark_range: Annotated[float, Spec("how far landmarks are seen", "m", *DISTANCE)] = 15.0
    landmark_range_error_max: Annotated[float, Spec("bound of the error of a range", "m", *DISTANCE)] = 0.1
    landmark_bearing_error_max: Annotated[
        float, Spec("bound of the error of a bearing", "rad", minimum=0.0, maximum=math.pi)
    ] = 0.05
    gyro_rate: Annotated[float, Spec("rate of imu; 0: none; at most one a step", "Hz", minimum=0.0, maximum=1000.0)] = (
        0.0
    )
    gyro_error_max: Annotated[
        float, Spec("bound of the error of a turn rate, independent from step to step", "rad/s", 0.0, 10.0)
    ] = 0.01
    gyro_bias: Annotated[float, Spec("constant error of the turn rate", "rad/s", -1.0, 1.0)] = 0.02
    detector: DetectorConfig = DetectorConfig()


NO_ERRORS = Draw(math.nan, math.nan, math.nan, math.nan)
"""Before the first fix."""


class Fix(NamedTuple):
    """A measured pose, and what happens to it."""

    pose: Pose
    """[m, m, rad] in map"""
    errors: Draw
    """errors of x, y, theta in shares of their bounds, without an outlier's; the next fix depends on them"""
    lost: bool
    delay: float
    """[s] from measuring to arriving"""


def due(step: int, rate: float, sampling_time: float) -> bool:
    """Return True if a sensor of ``rate`` [Hz] measures at ``step``: when its count of whole periods increases."""
    if rate <= 0.0:
        return False
    per_step = rate * sampling_time
    # With a margin for rounding, so that 10 Hz at 0.1 s means each step.
    return step == 0 or math.floor(step * per_step + 1e-9) > math.floor((step - 1) * per_step + 1e-9)


def delay_in_steps(delay: float, sampling_time: float) -> int:
    """Return the steps after which a measurement arrives: at the first step that is not before its delay is over."""
    return math.ceil(delay / sampling_time - 1e-9)


def position_share(pose: Pose, config: SensorConfig) -> float:
    """Return the share of their bounds that the errors of x and y reach at ``pose``, from 0 to 1.

    It is proportional to the distance from the origin within ``eps_xy_distance``, as with a beacon at the goal.
    The covariance that a fix claims does not follow it.
    """
    distance = math.sqrt(pose.x * pose.x + pose.y * pose.y)
    return distance / config.eps_xy_distance if distance < config.eps_xy_distance else 1.0


def measured_pose(pose: Pose, noise: Draw, config: SensorConfig) -> Pose:
    """Return the true pose with errors of these shares of the bounds; ``noise`` is (x, y, theta, -)."""
    share = position_share(pose, config)
    return Pose(
        pose.x + share * config.eps_x_max * noise.a,
        pose.y + share * config.eps_y_max * noise.b,
        wrap_angle(pose.theta + config.eps_theta_max * noise.c),
    )


def measured_heading(pose: Pose, noise: Draw, config: SensorConfig) -> float:
    """Return the true heading [rad] with an error uniform within the bound; ``noise`` is (-, -, -, heading)."""
    return wrap_angle(pose.theta + config.heading_error_max * noise.d)


def measured_landmark(pose: Pose, x: float, y: float, noise: Draw, config: SensorConfig) -> tuple[float, float]:
    """Return range [m] and bearing [rad] of the point ``x``, ``y``; ``noise`` is (range, bearing, -, -).

    A range is not below 1 mm, whatever the error.
    """
    distance, bearing = range_and_bearing(pose.x, pose.y, pose.theta, x, y)
    return (
        max(distance + config.landmark_range_error_max * noise.a, 1e-3),
        wrap_angle(bearing + config.landmark_bearing_error_max * noise.b),
    )


def is_lost(fault: Draw, config: SensorConfig) -> bool:
    """Return True if a fix is dropped; ``fault`` is (dropout, outlier, direction, delay)."""
    return probability(fault.a) < config.fix_dropout


def with_outlier(measured: Pose, fault: Draw, config: SensorConfig) -> Pose:
    """Displace a fix by ``fix_outlier_distance`` in a random direction if it is an outlier."""
    if probability(fault.b) >= config.fix_outlier:
        return measured
    angle = direction(fault.c)
    return Pose(
        measured.x + config.fix_outlier_distance * math.cos(angle),
        measured.y + config.fix_outlier_distance * math.sin(angle),
        measured.theta,
    )


def uniform_variance(bound: float) -> float:
    """Return the variance of an error uniform within +-``bound``, at least (1e-4)^2.

    A filter cannot use an exact sensor.
    """
    return max(bound * bound / 3.0, 1e-8)


def fix_variances(config: SensorConfig) -> tuple[float, float, float]:
    """Return the variances that a fix claims for x [m^2], y [m^2] and theta [rad^2]."""
    scale = config.fix_covariance_scale
    var_x, var_y = uniform_variance(config.eps_x_max), uniform_variance(config.eps_y_max)
    return scale * var_x, scale * var_y, scale * uniform_variance(config.eps_theta_max)


def check_detector(config: SensorConfig) -> None:
    """Refuse what a loop of one filter cannot do: with a detector, its map is the frame of the dock.

    Raises:
        InvalidValueError: for a detector beside fixes, or a dock that is not at the origin.
    """
    if config.detector.detection_rate <= 0.0:
        return
    if config.fix_rate > 0.0:
        raise InvalidValueError("fix_rate", config.fix_rate, "0 with a detection_rate: these loops have one filter")
    if dock_of(config.detector) != (0.0, 0.0, 0.0):
        raise InvalidValueError("dock_x, dock_y, dock_yaw", tuple(dock_of(config.detector)), "0 in these loops")


def is_pose_due(step: int, config: SensorConfig, sampling_time: float) -> bool:
    """Return True if a loop of one filter measures a pose at ``step``: see :func:`measured_pose_at`."""
    rate = config.detector.detection_rate if config.detector.detection_rate > 0.0 else config.fix_rate
    return due(step, rate, sampling_time)


def measured_pose_at(key: NoiseKey, pose: Pose, before: Draw, config: SensorConfig) -> Fix:
    """Measure the true ``pose`` as :func:`fix_at`, or, with a detector, in the frame of the dock."""
    if config.detector.detection_rate <= 0.0:
        return fix_at(key, pose, before, config)
    found = detection_at(key, pose, config.detector)
    return Fix(robot_seen(found), NO_ERRORS, found.lost, config.detector.detection_delay)


def claimed_noise(measured: Pose, config: SensorConfig) -> FixNoise:
    """Return the covariance that a measured pose of :func:`measured_pose_at` claims."""
    if config.detector.detection_rate > 0.0:
        return noise_of(measured, config.detector)
    var_x, var_y, var_theta = fix_variances(config)
    return FixNoise(var_x, 0.0, var_y, 0.0, 0.0, var_theta)


def landmark_variances(config: SensorConfig) -> tuple[float, float]:
    """Return the variances of a range [m^2] and of a bearing [rad^2]."""
    return uniform_variance(config.landmark_range_error_max), uniform_variance(config.landmark_bearing_error_max)


def correlated(before: Draw, noise: Draw, correlation: float) -> Draw:
    """Return the errors of a fix after one with the errors ``before``, in shares of their bounds.

    Args:
        before: NO_ERRORS for none.
        noise: uniform in (-1, 1).
        correlation: a of the AR(1) process, 0 <= a < 1.
    """
    if correlation == 0.0 or math.isnan(before.a):
        return noise
    fresh = math.sqrt(1.0 - correlation * correlation)
    return Draw(
        correlation * before.a + fresh * noise.a,
        correlation * before.b + fresh * noise.b,
        correlation * before.c + fresh * noise.c,
        noise.d,
    )


def fix_at(key: NoiseKey, pose: Pose, before: Draw, config: SensorConfig) -> Fix:
    """Measure the true ``pose`` at a step; ``before`` are the errors of the fix before, NO_ERRORS if there is none."""
    noise = draw(key.seed, key.run, key.step, FIX_BLOCK)
    errors = correlated(before, noise, config.fix_noise_correlation)
    measured = measured_pose(pose, errors, config)
    if config.fix_dropout == 0.0 and config.fix_outlier == 0.0 and config.fix_delay_jitter == 0.0:
        return Fix(measured, errors, False, config.fix_delay)
    fault = draw(key.seed, key.run, key.step, FAULT_BLOCK)
    delay = config.fix_delay + config.fix_delay_jitter * probability(fault.d)
    return Fix(with_outlier(measured, fault, config), errors, is_lost(fault, config), delay)


def heading_at(key: NoiseKey, pose: Pose, config: SensorConfig) -> float:
    """Measure the heading [rad] of the true ``pose`` at a step."""
    return measured_heading(pose, draw(key.seed, key.run, key.step, FIX_BLOCK), config)


def turn_rate_at(key: NoiseKey, omega: float, config: SensorConfig) -> float:
    """Measure the true mean turn rate ``omega`` [rad/s] over the step that ends now."""
    noise = draw(key.seed, key.run, key.step, GYRO_BLOCK).a
    return omega + config.gyro_bias + config.gyro_error_max * noise


def turn_rate_due(step: int, config: SensorConfig, sampling_time: float) -> bool:
    """Return True if the gyro measures at ``step``; at the first one nothing has turned yet."""
    return step > 0 and due(step, config.gyro_rate, sampling_time)


def in_range(pose: Pose, x: float, y: float, config: SensorConfig) -> bool:
    """Return True if the robot is near enough to measure a landmark at ``x``, ``y`` [m]."""
    dx, dy = x - pose.x, y - pose.y
    return dx * dx + dy * dy <= config.landmark_range * config.landmark_range


def landmark_at(key: NoiseKey, index: int, pose: Pose, x: float, y: float, config: SensorConfig) -> tuple[float, float]:
    """Measure range [m] and bearing [rad] of the landmark ``index`` of the map, at ``x``, ``y`` [m], at a step."""
    return measured_landmark(pose, x, y, draw(key.seed, key.run, key.step, LANDMARK_BLOCK + index), config)
