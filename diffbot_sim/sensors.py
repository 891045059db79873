"""Measurements of the true pose: their times and their errors. Pure functions of floats.

The errors of successive fixes may be correlated (``fix_noise_correlation`` a): e_n = a e_(n-1) + sqrt(1 - a^2) u_n with
u_n uniform within the bound and e_0 = u_0. The variance is bound^2 / 3 at each fix, and the autocorrelation is a^|lag|.
The errors can reach sqrt((1 + a) / (1 - a)) times the bound.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from diffbot_control.filter.dock import robot_at_dock
from diffbot_core.geometry import Pose, into_frame, range_and_bearing, wrap_angle
from diffbot_sim.config import DetectorConfig, SensorConfig, dock_pose
from diffbot_sim.noise import DETECTION, DETECTION_FAULT, FIX, FIX_FAULT, FURTHER, LANDMARKS, MOTION, uniform

FIX_OUTLIER_DISTANCE, DETECTION_OUTLIER_DISTANCE = 3.0, 0.5
"""[m]"""
DETECTION_NEAREST, DETECTION_FARTHEST = 0.3, 8.0
"""[m] range of distances at which the dock is detected"""
DETECTION_SIGMA, DETECTION_YAW_SIGMA, DETECTION_SIGMA_PER_METRE = 0.01, 0.02, 0.01
"""Standard deviations of a detection at the dock [m], [rad], and their increase with distance [m/m], [rad/m]. They are
the defaults of dock_ekf."""
GYRO_ERROR_MAX = 0.01
"""[rad/s] bound of the error of a turn rate without its bias, independent in each step; typical of MEMS gyros"""
_BOUND = math.sqrt(3.0)
"""Bound of a uniform error, in standard deviations."""


class FixErrors(NamedTuple):
    """Errors of a fix as shares of their bounds, without outliers. Correlated errors of the next fix depend on them."""

    x: float
    y: float
    theta: float


NO_ERRORS = FixErrors(math.nan, math.nan, math.nan)
"""Value before the first fix."""


class Fix(NamedTuple):
    """A measured pose."""

    pose: Pose
    """[m, m, rad] in map"""
    errors: FixErrors
    lost: bool
    """True if the fix does not arrive"""


class FixNoise(NamedTuple):
    """Covariance of a pose: upper triangle of the (3, 3) matrix of x, y [m], theta [rad]."""

    xx: float
    xy: float
    yy: float
    xt: float
    yt: float
    tt: float


class Detection(NamedTuple):
    """A measurement of the dock."""

    pose: Pose
    """[m, m, rad] of the dock in the frame of the robot"""
    sigma: float
    """[m] standard deviation of x and of y"""
    yaw_sigma: float
    """[rad] standard deviation of the heading"""
    lost: bool
    """True if the dock is not in view or the detection does not arrive"""


def is_due(step: int, rate: float, sampling_time: float) -> bool:
    """Return True if a sensor of ``rate`` [Hz] measures at ``step``: at step 0, and when a period has ended."""
    if rate <= 0.0:
        return False
    per_step = rate * sampling_time
    # The margin absorbs rounding errors: a sensor of 10 Hz measures in each step of 0.1 s.
    return step == 0 or math.floor(step * per_step + 1e-9) > math.floor((step - 1) * per_step + 1e-9)


def delay_in_steps(delay: float, sampling_time: float) -> int:
    """Return the number of steps after which a measurement with a ``delay`` [s] arrives, rounded up."""
    return math.ceil(delay / sampling_time - 1e-9)


def purposes_of(sensors: SensorConfig, landmarks: int, slip_noise: float) -> list[int]:
    """Return the purposes of noise that a configuration uses, see :mod:`noise`."""
    detector, used = sensors.detector, [MOTION]
    if slip_noise > 0.0 or sensors.heading_rate > 0.0 or sensors.gyro_rate > 0.0:
        used.append(FURTHER)
    if sensors.fix_rate > 0.0:
        used.append(FIX)
        used += [FIX_FAULT] if sensors.fix_dropout > 0.0 or sensors.fix_outlier > 0.0 else []
    if detector.detection_rate > 0.0:
        used += [DETECTION, DETECTION_FAULT]
    if sensors.landmark_rate > 0.0:
        used += range(LANDMARKS, LANDMARKS + (landmarks + 1) // 2)
    return used


def uniform_variance(bound: float) -> float:
    """Return the variance of an error uniform within +-``bound``.

    It is at least (1e-4)^2, since the filter cannot use an exact sensor.
    """
    return max(bound * bound / 3.0, 1e-8)


def fix_variances(config: SensorConfig) -> tuple[float, float, float]:
    """Return the variances in the message of a fix for x [m^2], y [m^2] and theta [rad^2]."""
    scale = config.fix_covariance_scale
    var_xy = scale * uniform_variance(config.eps_xy_max)
    return var_xy, var_xy, scale * uniform_variance(config.eps_theta_max)


def measured_fix(pose: Pose, before: FixErrors, noise: Any, config: SensorConfig) -> Fix:
    """Measure the true ``pose`` in map.

    Within ``eps_xy_distance`` of the origin, the errors of x and y are proportional to the distance from the origin, as
    with a beacon at the goal. The covariance of the fix does not depend on the distance.

    Args:
        pose: true pose [m, m, rad].
        before: errors of the previous fix; NO_ERRORS for the first fix.
        noise: (purposes, 4) numbers in [0, 1) of this step.
        config: configuration of the sensors.
    """
    fresh = FixErrors(uniform(noise[FIX, 0], 1.0), uniform(noise[FIX, 1], 1.0), uniform(noise[FIX, 2], 1.0))
    errors, a = fresh, config.fix_noise_correlation
    if a > 0.0 and not math.isnan(before.x):
        b = math.sqrt(1.0 - a * a)
        errors = FixErrors(a * before.x + b * fresh.x, a * before.y + b * fresh.y, a * before.theta + b * fresh.theta)
    distance = math.sqrt(pose.x * pose.x + pose.y * pose.y)
    share = distance / config.eps_xy_distance if distance < config.eps_xy_distance else 1.0
    x, y = pose.x + share * config.eps_xy_max * errors.x, pose.y + share * config.eps_xy_max * errors.y
    if config.fix_outlier > 0.0 and noise[FIX_FAULT, 1] < config.fix_outlier:
        x, y = _displaced(x, y, noise[FIX_FAULT, 2], FIX_OUTLIER_DISTANCE)
    theta = wrap_angle(pose.theta + config.eps_theta_max * errors.theta)
    lost = config.fix_dropout > 0.0 and noise[FIX_FAULT, 0] < config.fix_dropout
    return Fix(Pose(x, y, theta), errors, lost)


def _displaced(x: float, y: float, number: float, distance: float) -> tuple[float, float]:
    """Displace a position by ``distance`` [m] in a direction that ``number`` in [0, 1) determines."""
    angle = uniform(number, math.pi)
    return x + distance * math.cos(angle), y + distance * math.sin(angle)


def measured_heading(pose: Pose, noise: Any, config: SensorConfig) -> float:
    """Return the true heading [rad] with an error uniform within the bound."""
    return wrap_angle(pose.theta + uniform(noise[FURTHER, 0], config.heading_error_max))


def measured_turn_rate(omega: float, noise: Any, config: SensorConfig) -> float:
    """Measure the true mean turn rate ``omega`` [rad/s] over the step that ends now."""
    return omega + config.gyro_bias + uniform(noise[FURTHER, 1], GYRO_ERROR_MAX)


def is_gyro_due(step: int, config: SensorConfig, sampling_time: float) -> bool:
    """Return True if the gyro measures at ``step``. It does not measure at step 0, before the first motion."""
    return step > 0 and is_due(step, config.gyro_rate, sampling_time)


def in_range(pose: Pose, x: float, y: float, config: SensorConfig) -> bool:
    """Return True if the robot is near enough to measure a landmark at ``x``, ``y`` [m]."""
    dx, dy = x - pose.x, y - pose.y
    return dx * dx + dy * dy <= config.landmark_range * config.landmark_range


def measured_landmark(
    pose: Pose, index: int, x: float, y: float, noise: Any, config: SensorConfig
) -> tuple[float, float]:
    """Measure range [m] and bearing [rad] of the landmark ``index`` of the map, at ``x``, ``y`` [m].

    The range is at least 1 mm.
    """
    distance, bearing = range_and_bearing(pose.x, pose.y, pose.theta, x, y)
    purpose, column = LANDMARKS + index // 2, 2 * (index % 2)
    return (
        max(distance + uniform(noise[purpose, column], config.landmark_range_error_max), 1e-3),
        wrap_angle(bearing + uniform(noise[purpose, column + 1], config.landmark_bearing_error_max)),
    )


def detected_dock(pose: Pose, noise: Any, config: DetectorConfig) -> Detection:
    """Measure the dock from the true ``pose`` in map. The detector looks in all directions."""
    dock = into_frame(dock_pose(config), pose)
    sigma, yaw_sigma = detection_deviations(dock)
    x = dock.x + uniform(noise[DETECTION, 0], _BOUND * sigma)
    y = dock.y + uniform(noise[DETECTION, 1], _BOUND * sigma)
    if noise[DETECTION_FAULT, 1] < config.detection_outlier:
        x, y = _displaced(x, y, noise[DETECTION_FAULT, 2], DETECTION_OUTLIER_DISTANCE)
    measured = Pose(x, y, wrap_angle(dock.theta + uniform(noise[DETECTION, 2], _BOUND * yaw_sigma)))
    in_view = DETECTION_NEAREST <= math.sqrt(dock.x * dock.x + dock.y * dock.y) <= DETECTION_FARTHEST
    lost = not in_view or noise[DETECTION_FAULT, 0] < config.detection_dropout
    sigma, yaw_sigma = detection_deviations(measured)
    return Detection(measured, sigma, yaw_sigma, lost)


def detection_deviations(pose: Pose) -> tuple[float, float]:
    """Return the standard deviations of position [m] and heading [rad] of a detection.

    They depend only on the distance between robot and dock, so ``pose`` may be in the frame of either.
    """
    increase = DETECTION_SIGMA_PER_METRE * math.sqrt(pose.x * pose.x + pose.y * pose.y)
    return DETECTION_SIGMA + increase, DETECTION_YAW_SIGMA + increase


def is_pose_due(step: int, config: SensorConfig, sampling_time: float) -> bool:
    """Return True if :func:`measured_pose` measures at ``step``."""
    rate = config.detector.detection_rate if config.detector.detection_rate > 0.0 else config.fix_rate
    return is_due(step, rate, sampling_time)


def pose_delay(config: SensorConfig) -> float:
    """Return the delay [s] of the poses of :func:`measured_pose`."""
    return config.detector.detection_delay if config.detector.detection_rate > 0.0 else config.fix_delay


def measured_pose(pose: Pose, before: FixErrors, noise: Any, config: SensorConfig) -> Fix:
    """Measure the true ``pose`` in the frame of the dock if there is a detector, otherwise by :func:`measured_fix`."""
    if config.detector.detection_rate <= 0.0:
        return measured_fix(pose, before, noise, config)
    found = detected_dock(pose, noise, config.detector)
    return Fix(robot_at_dock(found.pose), before, found.lost)


def _noise_at_dock(robot: Pose, var_position: float, var_heading: float) -> FixNoise:
    """Return the covariance of :func:`robot_at_dock` to first order, as :meth:`DockedPose.covariance` computes it.

    An error of the measured heading rotates the robot about the dock, so the position error grows with the distance.

    Args:
        robot: pose of the robot in the frame of the dock.
        var_position: variance of the measured x and of the measured y, which are independent [m^2].
        var_heading: variance of the measured heading [rad^2].
    """
    x, y = robot.x, robot.y
    return FixNoise(
        var_position + var_heading * y * y,
        -var_heading * x * y,
        var_position + var_heading * x * x,
        -var_heading * y,
        var_heading * x,
        var_heading,
    )


def claimed_noise(measured: Pose, config: SensorConfig) -> FixNoise:
    """Return the covariance that the sensor claims for a pose of :func:`measured_pose`."""
    if config.detector.detection_rate > 0.0:
        sigma, yaw_sigma = detection_deviations(measured)
        return _noise_at_dock(measured, sigma * sigma, yaw_sigma * yaw_sigma)
    var_x, var_y, var_theta = fix_variances(config)
    return FixNoise(var_x, 0.0, var_y, 0.0, 0.0, var_theta)
