"""Parameters of the filter, its sources and its map, and the options computed from them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Annotated, NamedTuple

from diffbot_control.filter.consistency import chi_square_bound
from diffbot_control.filter.ekf import MAX_SLIP
from diffbot_control.filter.measurement import FIXES, HEADINGS, LANDMARKS
from diffbot_control.filter.models import state_size
from diffbot_control.filter.odometry import OdometryConfig
from diffbot_control.filter.state import Options
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import MAX_COORDINATE, Point
from diffbot_core.kinematics import WheelGeometry
from diffbot_core.schema import Spec, known_fields

EKF, CALIBRATING, FNN, FNN_CALIBRATING = "ekf", "ekf_calibrating", "ekf_fnn", "ekf_fnn_calibrating"
FILTERS = (EKF, CALIBRATING, FNN, FNN_CALIBRATING)
"""The plain filter has three states. The calibrating variants also estimate the errors of the wheels. The FNN variants
find the scale of R by fuzzy rules."""
GLOBAL_POSE = "global_pose"
"""Topic of the first source of fixes, which always exists."""
_MAX_TIME = 1e4
"""[s] largest correlation time; an error that lasts longer is an offset"""
_MAX_SIGMAS, _MAX_ERROR = 5.0, 0.1
"""Bounds of an estimated radius error: five initial deviations, and at least 10 %. Beyond them the wheel slips. With a
gyro the second bound is wider, since the filter estimates a part of the slip as a radius error, see
:func:`ekf.take_rate`."""
_WHEEL_WALK, _BIAS_WALK = 1e-4, 1e-4
"""[1/sqrt(s)], [rad/s/sqrt(s)] random-walk deviation of the errors of the wheels and of the gyro's bias"""
_LANDMARK_SIGMAS = 0.05, 0.01, 0.01
"""[m], [-], [rad] initial deviations of the range offset, the range scale and the bearing offset. They
are typical of lidars and cameras; one drive past some landmarks determines the errors better."""
_MAX_SOURCES = 8
MIN_SIGMA, MAX_SIGMA = 1e-4, 1e3
"""[m], [rad] range of standard deviations within which the filter stays accurate"""
_MAX_DELAY = 60.0
_TOPIC_NAME = re.compile(r"[~/]?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
_NUMBERS = 2**31
"""Bound of the ids of landmarks, which messages hold as int32."""


@known_fields
class FilterConfig(NamedTuple):
    """Parameters of the filter."""

    filter: Annotated[str, Spec("variant of the filter", choices=FILTERS, read_only=True)] = CALIBRATING
    gate_probability: Annotated[
        float, Spec("share of good measurements that pass the chi-square gate; 1: no gate", minimum=0.5, maximum=1.0)
    ] = 0.999
    relocation_fixes: Annotated[
        int,
        Spec(
            "number of successive rejected fixes that agree with each other and so relocate the filter",
            minimum=2,
            maximum=1_000_000,
        ),
    ] = 3
    wheel_radius_sigma: Annotated[
        float, Spec("initial deviation of each wheel's relative radius error", minimum=1e-6, maximum=0.2)
    ] = 0.01
    wheel_separation_sigma: Annotated[
        float,
        Spec(
            "initial deviation of the relative error of the wheel separation; 0: the error is known",
            minimum=0.0,
            maximum=0.2,
            read_only=True,
        ),
    ] = 0.02
    wheels_as_configured: Annotated[
        float,
        Spec(
            "probability that the errors of the wheels are exactly as configured; the reported pose averages over "
            "this case and the estimated errors; 0: the errors certainly differ",
            minimum=0.0,
            maximum=1.0,
        ),
    ] = 0.5
    left_radius_error: Annotated[
        float, Spec("initial relative error of the left wheel's radius", minimum=-0.5, maximum=0.5)
    ] = 0.0
    right_radius_error: Annotated[
        float, Spec("initial relative error of the right wheel's radius", minimum=-0.5, maximum=0.5)
    ] = 0.0
    wheel_separation_error: Annotated[
        float, Spec("initial relative error of the wheel separation", minimum=-0.5, maximum=0.5)
    ] = 0.0
    detect_correlation: Annotated[
        bool,
        Spec(
            "find the scale of each source's covariances and the correlation time of its errors, unless "
            "correlation_times gives the time; the ekf_fnn variants find the scale by fuzzy rules"
        ),
    ] = True
    correlation_times: Annotated[
        tuple[float, ...],
        Spec(
            "correlation times of the errors of global_pose, heading, landmarks and each of pose_sources, in this "
            "order; 0 or missing: to be found",
            "s",
            minimum=0.0,
            maximum=_MAX_TIME,
        ),
    ] = ()
    landmark_range_offset: Annotated[
        float,
        Spec(
            "initial constant error of all ranges; positive: too long", "m", minimum=-10.0, maximum=10.0, read_only=True
        ),
    ] = 0.0
    landmark_range_scale: Annotated[
        float,
        Spec("initial relative error of all ranges; 0.02: 2 % too long", minimum=-0.5, maximum=1.0, read_only=True),
    ] = 0.0
    landmark_bearing_offset: Annotated[
        float,
        Spec("initial constant error of all bearings", "rad", minimum=-math.pi, maximum=math.pi, read_only=True),
    ] = 0.0
    use_gyro: Annotated[
        bool, Spec("fuse the turn rate of imu with the wheels', and estimate its bias", read_only=True)
    ] = False
    gyro_bias_sigma: Annotated[
        float, Spec("initial deviation of the gyro's bias", "rad/s", minimum=1e-6, maximum=1.0)
    ] = 0.05


class PoseSource(NamedTuple):
    """Settings of one further source of fixes."""

    topic: str
    sigma_xy: float
    """[m] deviation for fixes without a usable covariance; 0: drop them"""
    sigma_yaw: float
    """[rad] deviation of the heading; 0: drop fixes without a usable covariance; pi or more: no heading"""
    delay: float
    """[s] from the measurement to its stamp"""

    @property
    def source(self) -> str:
        """Return the name of the source in the filter."""
        return f"{FIXES} of {self.topic}"


@known_fields
class PoseSources(NamedTuple):
    """Sources of fixes beside global_pose. The lists after the first have one value for each source, or are empty."""

    pose_sources: Annotated[
        tuple[str, ...],
        Spec("topics of fixes (PoseWithCovarianceStamped) beside global_pose, e.g. [gps]", read_only=True),
    ] = ()
    pose_source_sigma_xy: Annotated[
        tuple[float, ...],
        Spec(
            "deviation of x and y of each source without a usable covariance; 0 or empty: drop the fix",
            "m",
            minimum=0.0,
            maximum=MAX_SIGMA,
        ),
    ] = ()
    pose_source_sigma_yaw: Annotated[
        tuple[float, ...],
        Spec(
            "deviation of the heading of each source; 0 or empty: drop the fix; pi or more: no heading",
            "rad",
            minimum=0.0,
            maximum=MAX_SIGMA,
        ),
    ] = ()
    pose_source_delay: Annotated[
        tuple[float, ...],
        Spec("time from a measurement to its stamp, of each source; empty: 0", "s", minimum=0.0, maximum=_MAX_DELAY),
    ] = ()

    def check(self) -> None:
        """Refuse names that are not topics, and lists whose lengths differ.

        Raises:
            InvalidValueError: with the list, its value and the bound.
        """
        names = self.pose_sources
        if len(names) > _MAX_SOURCES or len({*names, GLOBAL_POSE}) != len(names) + 1:
            raise InvalidValueError(
                "pose_sources", list(names), f"at most {_MAX_SOURCES} different topics, not {GLOBAL_POSE}"
            )
        for name in names:
            if not _TOPIC_NAME.fullmatch(name):
                raise InvalidValueError("pose_sources", name, "the name of a topic")
        for field, values in zip(self._fields[1:], self[1:], strict=True):
            if len(values) not in (0, len(names)):
                raise InvalidValueError(field, list(values), f"empty or as many as pose_sources: {len(names)}")
        for field in ("pose_source_sigma_xy", "pose_source_sigma_yaw"):
            if any(0.0 < one < MIN_SIGMA for one in getattr(self, field)):
                raise InvalidValueError(field, list(getattr(self, field)), f"0 or >= {MIN_SIGMA:g} each")

    def settings(self) -> list[PoseSource]:
        """Return the settings of each source."""
        columns = [values or (0.0,) * len(self.pose_sources) for values in self[1:]]
        return [PoseSource(*row) for row in zip(self.pose_sources, *columns, strict=True)]


@known_fields
class LandmarkMap(NamedTuple):
    """Landmarks whose range and bearing the robot can measure: three lists with one value for each landmark."""

    landmark_ids: Annotated[
        tuple[int, ...], Spec("ids of the landmarks", minimum=-_NUMBERS, maximum=_NUMBERS - 1, read_only=True)
    ] = ()
    landmark_x: Annotated[
        tuple[float, ...],
        Spec("x of each landmark in map", "m", minimum=-MAX_COORDINATE, maximum=MAX_COORDINATE, read_only=True),
    ] = ()
    landmark_y: Annotated[
        tuple[float, ...],
        Spec("y of each landmark in map", "m", minimum=-MAX_COORDINATE, maximum=MAX_COORDINATE, read_only=True),
    ] = ()

    def check(self) -> None:
        """Refuse inconsistent lists.

        Raises:
            InvalidValueError: if their lengths differ, or two landmarks have the same id.
        """
        count = len(self.landmark_ids)
        if len(set(self.landmark_ids)) != count:
            raise InvalidValueError("landmark_ids", list(self.landmark_ids), sentence="a number occurs twice")
        for name, values in (("landmark_x", self.landmark_x), ("landmark_y", self.landmark_y)):
            if len(values) != count:
                raise InvalidValueError(name, list(values), f"as many as landmark_ids: {count}")

    def points(self) -> dict[int, Point]:
        """Return the positions [m] by id, sorted by position: simultaneous measurements are fused in this order."""
        positions = map(Point, self.landmark_x, self.landmark_y)
        return dict(sorted(zip(self.landmark_ids, positions, strict=True), key=lambda one: one[1]))


@known_fields
class LocalizationConfig(NamedTuple):
    """Parameters of the fusion."""

    history_length: Annotated[float, Spec("how late a measurement may arrive", "s", minimum=0.0, maximum=60.0)] = 1.0
    filter: FilterConfig = FilterConfig()
    odometry: OdometryConfig = OdometryConfig()
    sources: PoseSources = PoseSources()

    def check(self) -> None:
        """Refuse delays that are longer than the history, and correlation times without a source.

        Raises:
            InvalidValueError: with the list, its value and the bound.
        """
        delays, times = self.sources.pose_source_delay, self.filter.correlation_times
        if any(delay > self.history_length for delay in delays):
            raise InvalidValueError("pose_source_delay", list(delays), f"<= history_length: {self.history_length:g}")
        if len(times) > (count := len(sources_of(self))):
            raise InvalidValueError("correlation_times", list(times), f"at most {count} values, one for each source")


def sources_of(config: LocalizationConfig) -> list[str]:
    """Return the names of the sources in the order of their rows in the filter."""
    return [FIXES, HEADINGS, LANDMARKS, *(one.source for one in config.sources.settings())]


def options_of(
    config: LocalizationConfig,
    separation: float = WheelGeometry().wheel_separation,
    landmarks: Sequence[Point] = (),
) -> Options:
    """Return the options of the filter; the bounds of its gate are chi-square quantiles.

    Args:
        config: parameters.
        separation: wheel separation L [m].
        landmarks: positions of the landmarks; without any, the errors of the landmark sensor are not estimated.
    """
    one = config.filter
    calibrating = one.filter in (CALIBRATING, FNN_CALIBRATING)
    rest = 1.0 - one.gate_probability
    gates = [chi_square_bound(dof, rest) if rest > 0.0 else math.inf for dof in (1, 2, 3)]
    largest = MAX_SLIP if one.use_gyro else _MAX_ERROR
    sigmas = _sigmas_of(one, calibrating, bool(landmarks))
    return Options(
        state_size(calibrating, one.use_gyro, bool(landmarks)),
        separation,
        (gates[0], gates[1], gates[2]),
        one.relocation_fixes,
        (
            one.left_radius_error if calibrating else 0.0,
            one.right_radius_error if calibrating else 0.0,
            one.wheel_separation_error if calibrating else 0.0,
            0.0,
            one.landmark_range_offset,
            one.landmark_range_scale,
            one.landmark_bearing_offset,
        ),
        tuple(sigma * sigma for sigma in sigmas),  # type: ignore[arg-type]
        _WHEEL_WALK**2,
        _BIAS_WALK**2,
        max(_MAX_SIGMAS * one.wheel_radius_sigma, largest) if calibrating else 0.0,
        max(_MAX_SIGMAS * one.wheel_separation_sigma, _MAX_ERROR) if calibrating else 0.0,
        one.wheels_as_configured,
        one.filter in (FNN, FNN_CALIBRATING),
        one.detect_correlation and one.filter in (EKF, CALIBRATING),
        (*one.correlation_times, *[0.0] * (len(sources_of(config)) - len(one.correlation_times))),
    )


def _sigmas_of(config: FilterConfig, calibrating: bool, landmarks: bool) -> tuple[float, ...]:
    """Return the initial deviations of the seven errors in the order of the states; 0: the error is not estimated."""
    zero = 0.0, 0.0, 0.0
    wheels = config.wheel_radius_sigma, config.wheel_radius_sigma, config.wheel_separation_sigma
    bias = config.gyro_bias_sigma if config.use_gyro else 0.0
    return (*(wheels if calibrating else zero), bias, *(_LANDMARK_SIGMAS if landmarks else zero))
