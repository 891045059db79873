"""Options of the filter: variant, gate, relocation and process noise."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.filter.chi_square import chi_square_bound
from diffbot_control.filter.landmark_calibration import NO_ERRORS, LandmarkErrors
from diffbot_control.filter.slip import MAX_SLIP
from diffbot_core.errors import InvalidValueError
from diffbot_core.ranges import TIMEOUT
from diffbot_core.schema import Spec, known_fields

EKF, CALIBRATING, FNN, FNN_CALIBRATING = "ekf", "ekf_calibrating", "ekf_fnn", "ekf_fnn_calibrating"
FILTERS = (EKF, CALIBRATING, FNN, FNN_CALIBRATING)
"""Three states; with the radius errors of both wheels as two more; with a fuzzy-neural adaptation of R and Q."""

REJECT, WEIGH = "reject", "weigh"
_MAX_TIME = 1e4
"""[s] A correlation time; longer ones are an offset."""
_KNOWN_SIGMA = 1e-6
"""[m], [rad] Deviation of a known error that is a state because the others are: P stays positive definite."""
_MAX_SIGMAS, _MAX_ERROR = 5.0, 0.1
"""An estimated radius error beyond five initial deviations and beyond 10 % is a slipping wheel, not a radius error.
With a gyro, some more of slip is estimated like a radius error, see :mod:`slip`."""


@known_fields
class FilterConfig(NamedTuple):
    """Parameters of the filter."""

    filter: Annotated[str, Spec("variant of the filter", choices=FILTERS, read_only=True)] = CALIBRATING
    gate_probability: Annotated[
        float,
        Spec("share of good measurements that pass the chi-square gate; 1: no gate", minimum=0.5, maximum=1.0),
    ] = 0.999
    relocation_fixes: Annotated[
        int,
        Spec(
            "rejected fixes in a row that relocate the filter if they agree with each other",
            minimum=2,
            maximum=1_000_000,
        ),
    ] = 3
    relocation_timeout: Annotated[
        float,
        Spec(
            "duration of a streak of at least relocation_fixes rejections after which the newest measurement relocates",
            "s",
            *TIMEOUT,
        ),
    ] = 1.5
    wheel_radius_sigma: Annotated[
        float, Spec("standard deviation of each wheel's relative radius error at the start", minimum=1e-6, maximum=0.2)
    ] = 0.01
    wheel_radius_walk: Annotated[
        float,
        Spec("random-walk deviation of each wheel's relative radius error", "1/sqrt(s)", minimum=0.0, maximum=0.1),
    ] = 1e-4
    wheel_separation_sigma: Annotated[
        float,
        Spec(
            "standard deviation of the wheel separation's relative error at the start, one more state of the "
            "calibrating variants; it changes as fast as the radii; 0: no state",
            minimum=0.0,
            maximum=0.2,
            read_only=True,
        ),
    ] = 0.02
    wheels_as_configured: Annotated[
        float,
        Spec(
            "probability that the errors of the wheels are exactly as configured; the reported pose averages over "
            "that and what the calibrating variants estimate; 0: they surely differ",
            minimum=0.0,
            maximum=1.0,
        ),
    ] = 0.5
    left_radius_error: Annotated[
        float,
        Spec("relative error of the left wheel's radius at the start, e.g. by calibration", minimum=-0.5, maximum=0.5),
    ] = 0.0
    right_radius_error: Annotated[
        float, Spec("relative error of the right wheel's radius at the start", minimum=-0.5, maximum=0.5)
    ] = 0.0
    wheel_separation_error: Annotated[
        float,
        Spec(
            "relative error of the wheel separation at the start; acts only if it is a state", minimum=-0.5, maximum=0.5
        ),
    ] = 0.0
    landmark_gate: Annotated[
        str,
        Spec(
            "landmarks beyond the gate: reject them, or weigh them by bound / NIS, which needs no relocation",
            choices=(REJECT, WEIGH),
        ),
    ] = REJECT
    fix_correlation_time: Annotated[
        float,
        Spec("how long the errors of fixes last; 0: independent from fix to fix", "s", minimum=0.0, maximum=_MAX_TIME),
    ] = 0.0
    detect_correlation: Annotated[
        bool,
        Spec(
            "find how long the errors of fixes and of landmarks last, unless fix_correlation_time or "
            "landmark_correlation_time says it; not with the ekf_fnn variants"
        ),
    ] = True
    heading_correlation_time: Annotated[
        float, Spec("how long the errors of headings last; 0: independent", "s", minimum=0.0, maximum=_MAX_TIME)
    ] = 0.0
    landmark_correlation_time: Annotated[
        float, Spec("how long the errors of each landmark last; 0: independent", "s", minimum=0.0, maximum=_MAX_TIME)
    ] = 0.0

    landmark_range_offset: Annotated[
        float,
        Spec(
            "constant error of all ranges to landmarks; positive: too long",
            "m",
            minimum=-10.0,
            maximum=10.0,
            read_only=True,
        ),
    ] = 0.0
    landmark_range_offset_sigma: Annotated[
        float,
        Spec(
            "deviation of that offset; with a map of landmarks, and one of the three deviations > 0, all three errors "
            "are states",
            "m",
            minimum=0.0,
            maximum=10.0,
            read_only=True,
        ),
    ] = 0.05
    landmark_range_scale: Annotated[
        float,
        Spec(
            "relative error of the ranges' scale; 0.02: they are 2 % too long",
            minimum=-0.5,
            maximum=1.0,
            read_only=True,
        ),
    ] = 0.0
    landmark_range_scale_sigma: Annotated[
        float, Spec("deviation of the ranges' scale error", minimum=0.0, maximum=0.5, read_only=True)
    ] = 0.01
    landmark_bearing_offset: Annotated[
        float,
        Spec("constant error of all bearings of landmarks", "rad", minimum=-math.pi, maximum=math.pi, read_only=True),
    ] = 0.0
    landmark_bearing_offset_sigma: Annotated[
        float, Spec("deviation of the bearings' constant error", "rad", minimum=0.0, maximum=math.pi, read_only=True)
    ] = 0.01

    use_gyro: Annotated[
        bool,
        Spec("fuse the turn rate of imu with the wheels'; its bias is one more state", read_only=True),
    ] = False
    gyro_bias_sigma: Annotated[
        float, Spec("deviation of the gyro's bias at the start", "rad/s", minimum=1e-6, maximum=1.0)
    ] = 0.05
    gyro_bias_walk: Annotated[
        float, Spec("random-walk deviation of the gyro's bias", "rad/s/sqrt(s)", minimum=0.0, maximum=0.1)
    ] = 1e-4

    def check(self) -> None:
        """Refuse options that contradict each other.

        Raises:
            InvalidValueError: if the errors of fixes are correlated and R is to be learnt from their differences.
        """
        if self.fix_correlation_time > 0.0 and self.filter in (FNN, FNN_CALIBRATING):
            raise InvalidValueError(
                "fix_correlation_time", self.fix_correlation_time, f"0 with {self.filter}: it learns R from differences"
            )


class CorrelationTimes(NamedTuple):
    """How long errors last [s]; 0: independent errors."""

    headings: float
    landmarks: float
    """of each"""
    fixes: float


class FilterOptions(NamedTuple):
    """The plain numbers that the filter needs of a :class:`FilterConfig`."""

    adaptive: bool
    gates: tuple[float, float, float]
    """bounds of the NIS of measurements of one, two and three numbers; inf without a gate"""
    relocation_fixes: int
    relocation_timeout: float
    """[s]"""
    radius_variance: float
    """of each wheel's relative radius error at the start; 0 if it is no state"""
    radius_random_walk: float
    """[1/s] its random-walk variance per second"""
    max_radius_error: float
    """bound of its estimate; beyond it the estimate is reset"""
    separation_variance: float
    """of the wheel separation's relative error at the start; 0 if it is no state"""
    max_separation_error: float
    """bound of its estimate"""
    wheel_errors: tuple[float, float, float]
    """relative errors of the radii, left, right, and of the wheel separation at the start"""
    wheels_as_configured: float
    """probability that these are exact"""
    weigh_landmarks: bool
    """weigh landmarks beyond the gate instead of rejecting them"""
    correlation_times: CorrelationTimes
    detects_fix_correlation: bool
    """find the correlation of the errors of fixes"""
    detects_landmark_correlation: bool
    """find how long the errors of each landmark last"""
    landmark_errors: LandmarkErrors
    """of the sensor of landmarks, at the start where they are states"""
    landmark_sigmas: LandmarkErrors
    """their standard deviations at the start, all > 0; all 0 if they are no states"""
    gyro_bias_variance: float
    """[rad^2/s^2] of the gyro's bias at the start; 0 without a gyro"""
    gyro_bias_random_walk: float
    """[rad^2/s^3] its random-walk variance per second"""


def options_of(config: FilterConfig, *, landmarks: bool = False) -> FilterOptions:
    """Derive the filter's numbers from its configuration; the bounds are chi-square quantiles.

    ``landmarks``: there are some; without them the errors of their sensor are no states.
    """
    adaptive = config.filter in (FNN, FNN_CALIBRATING)
    calibrating = config.filter in (CALIBRATING, FNN_CALIBRATING)
    rest = 1.0 - config.gate_probability
    largest = MAX_SLIP if config.use_gyro else _MAX_ERROR
    first, second, third = (chi_square_bound(dof, rest) if rest > 0.0 else math.inf for dof in (1, 2, 3))
    return FilterOptions(
        adaptive,
        (first, second, third),
        config.relocation_fixes,
        config.relocation_timeout,
        config.wheel_radius_sigma**2 if calibrating else 0.0,
        config.wheel_radius_walk**2 if calibrating else 0.0,
        max(_MAX_SIGMAS * config.wheel_radius_sigma, largest) if calibrating else 0.0,
        config.wheel_separation_sigma**2 if calibrating else 0.0,
        max(_MAX_SIGMAS * config.wheel_separation_sigma, _MAX_ERROR) if calibrating else 0.0,
        (config.left_radius_error, config.right_radius_error, config.wheel_separation_error)
        if calibrating
        else (0.0, 0.0, 0.0),
        config.wheels_as_configured,
        config.landmark_gate == WEIGH,
        CorrelationTimes(
            config.heading_correlation_time, config.landmark_correlation_time, config.fix_correlation_time
        ),
        config.detect_correlation and config.fix_correlation_time == 0.0 and not adaptive,
        config.detect_correlation and config.landmark_correlation_time == 0.0 and not adaptive and landmarks,
        LandmarkErrors(config.landmark_range_offset, config.landmark_range_scale, config.landmark_bearing_offset),
        _landmark_sigmas(config) if landmarks else NO_ERRORS,
        config.gyro_bias_sigma**2 if config.use_gyro else 0.0,
        config.gyro_bias_walk**2,
    )


def _landmark_sigmas(config: FilterConfig) -> LandmarkErrors:
    """Return the deviations of the errors of landmarks; all 0 if all are known."""
    sigmas = (
        config.landmark_range_offset_sigma,
        config.landmark_range_scale_sigma,
        config.landmark_bearing_offset_sigma,
    )
    return LandmarkErrors(*(max(one, _KNOWN_SIGMA) for one in sigmas)) if any(sigmas) else NO_ERRORS
