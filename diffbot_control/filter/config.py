"""Parameters of the filter, its sources and its map, and the options of the filter computed from them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Annotated, NamedTuple

from diffbot_control.filter.consistency import chi_square_bound
from diffbot_control.filter.measurement import FIXES, HEADINGS, LANDMARKS
from diffbot_control.filter.models import MAX_SLIP, state_size
from diffbot_control.filter.odometry import OdometryConfig
from diffbot_control.filter.state import Options
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import MAX_COORDINATE, Point
from diffbot_core.kinematics import WheelGeometry
from diffbot_core.schema import Spec, known_fields

EKF, CALIBRATING, FNN, FNN_CALIBRATING = "ekf", "ekf_calibrating", "ekf_fnn", "ekf_fnn_calibrating"
FILTERS = (EKF, CALIBRATING, FNN, FNN_CALIBRATING)
"""Variants of the filter. EKF has three states. The calibrating variants also estimate the wheel errors. The FNN
variants scale R and Q by fuzzy rules."""
GLOBAL_POSE = "global_pose"
"""Topic of the first source of fixes, which always exists."""
_MAX_TIME = 1e4
"""[s] largest correlation time; an error that lasts longer is a constant offset"""
_MAX_SIGMAS, _MAX_ERROR = 5.0, 0.1
"""Bound of an estimated wheel error: five initial deviations, but at least 10 %. An error beyond the bound is slip, not
an error of the wheel. With a gyro, MAX_SLIP replaces the 10 % for radius errors, because the filter then explains slip
by radius errors, see :func:`ekf.take_rate`."""
_WHEEL_WALK, _BIAS_WALK = 1e-4, 1e-4
"""[1/sqrt(s)], [rad/s/sqrt(s)] random-walk deviations of the wheel errors and of the gyro bias"""
_LANDMARK_SIGMAS = 0.05, 0.01, 0.01
"""[m], [-], [rad] Initial deviations of range offset, range scale and bearing offset, typical of lidars and cameras.
Within one drive, the filter estimates the errors much more accurately."""
_MAX_SOURCES = 8
MIN_SIGMA, MAX_SIGMA = 1e-4, 1e3
"""[m], [rad] smallest and largest standard deviation for which the filter is numerically accurate"""
_MAX_DELAY = 60.0
_TOPIC_NAME = re.compile(r"(~?/)?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
_MAX_ID = 2**31 - 1
"""Largest id of a landmark; messages contain ids as int32."""


@known_fields
class FilterConfig(NamedTuple):
    """Parameters of the filter."""

    filter: Annotated[str, Spec("variant of the filter", choices=FILTERS, read_only=True)] = CALIBRATING
    gate_probability: Annotated[
        float,
        Spec("probability that a correct measurement passes the chi-square gate; 1: no gate", minimum=0.5, maximum=1.0),
    ] = 0.999
    relocation_fixes: Annotated[
        int,
        Spec(
            "number of successive rejected fixes that relocate the filter if they agree with each other",
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
            "initial deviation of the relative error of the wheel separation; 0: do not estimate it",
            minimum=0.0,
            maximum=0.2,
            read_only=True,
        ),
    ] = 0.02
    wheels_as_configured: Annotated[
        float,
        Spec(
            "probability that the wheel errors are exactly as configured; the reported pose averages over this case "
            "and over the estimated errors; 0: use the estimated errors only",
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
            "estimate a factor on the covariances of each source and the correlation time of its errors, unless "
            "correlation_times gives the time; the ekf_fnn variants set the factor by fuzzy rules instead"
        ),
    ] = True
    correlation_times: Annotated[
        tuple[float, ...],
        Spec(
            "correlation times of the errors of global_pose, heading, landmarks and each of pose_sources, in this "
            "order; 0 or missing: unknown, see detect_correlation",
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
        bool, Spec("fuse the turn rates of imu and wheels, and estimate the bias of imu", read_only=True)
    ] = False
    gyro_bias_sigma: Annotated[
        float, Spec("initial deviation of the gyro's bias", "rad/s", minimum=1e-6, maximum=1.0)
    ] = 0.05


class PoseSource(NamedTuple):
    """Settings of one source of fixes beside global_pose."""

    topic: str
    sigma_xy: float
    """[m] deviation of x and y for fixes without a usable covariance; 0: drop these fixes"""
    sigma_yaw: float
    """[rad] deviation of the heading for fixes without a usable covariance; 0: drop these fixes; pi or more: the fixes
    have no heading"""
    delay: float
    """[s] time from a measurement to its stamp"""

    @property
    def source(self) -> str:
        """Return the name of the source in the filter."""
        return f"{FIXES} of {self.topic}"


@known_fields
class PoseSources(NamedTuple):
    """Sources of fixes beside global_pose. Each list after pose_sources has one value per source, or is empty."""

    pose_sources: Annotated[
        tuple[str, ...],
        Spec("topics of fixes (PoseWithCovarianceStamped) beside global_pose, e.g. [gps]", read_only=True),
    ] = ()
    pose_source_sigma_xy: Annotated[
        tuple[float, ...],
        Spec(
            "deviation of x and y of each source, for fixes without a usable covariance; 0 or empty: drop these fixes",
            "m",
            minimum=0.0,
            maximum=MAX_SIGMA,
        ),
    ] = ()
    pose_source_sigma_yaw: Annotated[
        tuple[float, ...],
        Spec(
            "deviation of the heading of each source, for fixes without a usable covariance; 0 or empty: drop these "
            "fixes; pi or more: the fixes have no heading",
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
        """Check the names of the topics, the lengths of the lists, and the deviations.

        Raises:
            InvalidValueError: if a name is not a topic, two lengths differ, or a deviation is too small.
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
                raise InvalidValueError(
                    field, list(values), f"empty or {len(names)} values, one for each of pose_sources"
                )
        for field in ("pose_source_sigma_xy", "pose_source_sigma_yaw"):
            if any(0.0 < sigma < MIN_SIGMA for sigma in getattr(self, field)):
                raise InvalidValueError(field, list(getattr(self, field)), f"0 or >= {MIN_SIGMA:g} each")

    def settings(self) -> list[PoseSource]:
        """Return the settings of each source."""
        columns = [values or (0.0,) * len(self.pose_sources) for values in self[1:]]
        return [PoseSource(*row) for row in zip(self.pose_sources, *columns, strict=True)]


@known_fields
class LandmarkMap(NamedTuple):
    """Landmarks that the robot can measure: three lists with one value for each landmark."""

    landmark_ids: Annotated[
        tuple[int, ...], Spec("ids of the landmarks", minimum=-_MAX_ID - 1, maximum=_MAX_ID, read_only=True)
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
        """Check the lists.

        Raises:
            InvalidValueError: if their lengths differ, or two landmarks have the same id.
        """
        count = len(self.landmark_ids)
        if len(set(self.landmark_ids)) != count:
            raise InvalidValueError("landmark_ids", list(self.landmark_ids), sentence="two landmarks have the same id")
        for name, values in (("landmark_x", self.landmark_x), ("landmark_y", self.landmark_y)):
            if len(values) != count:
                raise InvalidValueError(name, list(values), f"{count} values, one for each of landmark_ids")

    def points(self) -> dict[int, Point]:
        """Return the positions [m] by id, sorted by position, so that the order of the lists does not matter."""
        positions = map(Point, self.landmark_x, self.landmark_y)
        return dict(sorted(zip(self.landmark_ids, positions, strict=True), key=lambda item: item[1]))


@known_fields
class LocalizationConfig(NamedTuple):
    """Parameters of the fusion."""

    history_length: Annotated[
        float, Spec("largest time by which a measurement may arrive late", "s", minimum=0.0, maximum=60.0)
    ] = 1.0
    filter: FilterConfig = FilterConfig()
    odometry: OdometryConfig = OdometryConfig()
    sources: PoseSources = PoseSources()

    def check(self) -> None:
        """Check the delays and the correlation times.

        Raises:
            InvalidValueError: if a delay is longer than the history, or there are more correlation times than sources.
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
    """Return the options of the filter.

    Args:
        config: parameters of the fusion.
        separation: wheel separation L [m].
        landmarks: positions of the landmarks; if empty, the errors of the landmark sensor are not estimated.
    """
    values = config.filter
    calibrating = values.filter in (CALIBRATING, FNN_CALIBRATING)
    tail = 1.0 - values.gate_probability
    gates = [chi_square_bound(dof, tail) if tail > 0.0 else math.inf for dof in (1, 2, 3)]
    radius_sigma, separation_sigma = values.wheel_radius_sigma, values.wheel_separation_sigma
    sigmas = (
        *((radius_sigma, radius_sigma, separation_sigma) if calibrating else (0.0, 0.0, 0.0)),
        values.gyro_bias_sigma if values.use_gyro else 0.0,
        *(_LANDMARK_SIGMAS if landmarks else (0.0, 0.0, 0.0)),
    )
    max_radius_error = max(_MAX_SIGMAS * radius_sigma, MAX_SLIP if values.use_gyro else _MAX_ERROR)
    return Options(
        size=state_size(calibrating, values.use_gyro, bool(landmarks)),
        separation=separation,
        gates=(gates[0], gates[1], gates[2]),
        relocation_fixes=values.relocation_fixes,
        errors=(
            values.left_radius_error if calibrating else 0.0,
            values.right_radius_error if calibrating else 0.0,
            values.wheel_separation_error if calibrating else 0.0,
            0.0,
            values.landmark_range_offset,
            values.landmark_range_scale,
            values.landmark_bearing_offset,
        ),
        variances=tuple(sigma * sigma for sigma in sigmas),  # type: ignore[arg-type]
        wheel_walk=_WHEEL_WALK**2,
        bias_walk=_BIAS_WALK**2,
        max_radius_error=max_radius_error if calibrating else 0.0,
        max_separation_error=max(_MAX_SIGMAS * separation_sigma, _MAX_ERROR) if calibrating else 0.0,
        wheels_as_configured=values.wheels_as_configured,
        fuzzy=values.filter in (FNN, FNN_CALIBRATING),
        finds_noise=values.detect_correlation and values.filter in (EKF, CALIBRATING),
        times=(*values.correlation_times, *[0.0] * (len(sources_of(config)) - len(values.correlation_times))),
    )
