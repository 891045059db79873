"""Convert a recorded drive to arrays in the order of the stamps, for the likelihood of its innovations."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

from diffbot_control.filter.config import sources_of
from diffbot_control.filter.measurement import FIXES, HEADINGS, LANDMARKS, GyroSample, Key, Measurement
from diffbot_control.filter.models import HEADING, LANDMARK, POSE_FIX, WHEELS, is_fix, with_wheel_errors
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.stamps import S_PER_NS
from diffbot_tools.refilter import Answer, FilterRun

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
"""(k,) True for the measurements that count"""
RESET = -1
"""Kind of an event that sets the pose. All other kinds are measurements."""
FIX_SENSOR, HEADING_SENSOR, LANDMARK_SENSOR, FURTHER_SENSORS = 0, 1, 2, 3
"""Indices of the sensors in :func:`sources_of`. The further sources of fixes begin at FURTHER_SENSORS."""
STATES = 10
"""Number of states of the filter with all errors. The errors of single sources are further states."""
MIN_MEASUREMENTS, MIN_DURATION = 30, 10.0
"""A drive with fewer measurements or a shorter duration [s] is refused."""
_MAX_GAP = 1000.0
"""[s] The filter restarts after a longer gap between two odometry messages."""
_MAX_ERRORS = 32
"""Largest number of states for the errors of sources."""
_MAX_RATE_GAP = 5.0
"""The turn rate is unknown during a gap of more than this many periods of the gyro."""
_NO_RATE, UNKNOWN_RATE = 1e6, 1.0
"""[rad^2/s^2] Variance of the turn rate in a gap of the gyro, and the variance above which a turn rate is unknown."""
_NEIGHBOURS = np.array((1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0)) / 6.0
"""Weights of a message's neighbours in :func:`with_noise_of_neighbours`."""
_BY_HAND = ""
"""Source of a pose that was set by hand."""


class Odometry(NamedTuple):
    """Mean twists; message k is the mean over (start[k], end[k]]."""

    start: Array
    """(n,) [s]"""
    end: Array
    """(n,) [s]"""
    twist: Array
    """(n, 2) v [m/s], omega [rad/s]"""
    covariance: Array
    """(n, 3) variance of v, covariance, variance of omega; all zero if unknown"""
    smooth: Array
    """(n, 2) twists for noise and derivatives, see :func:`with_noise_of_neighbours`; (0, 2) to use ``twist``"""


class Rates(NamedTuple):
    """Integrated turn rates of a gyro; each sample is the mean turn rate since the previous sample."""

    time: Array
    """(g,) [s]"""
    angle: Array
    """(g,) [rad] sum of rate dt"""
    variance: Array
    """(g,) [rad^2] sum of variance dt^2"""


class Measurements(NamedTuple):
    """Measurements and resets of the pose, in the order in which the filter fuses them."""

    time: Array
    """(k,) [s]"""
    kind: NDArray[np.int64]
    """(k,) a kind of :mod:`models`, or RESET"""
    sensor: NDArray[np.int64]
    """(k,) index in :func:`sources_of`; -1 for a pose that was set by hand"""
    source: NDArray[np.int64]
    """(k,) number of the source. Only errors of one source are correlated in time. Each landmark is a source."""
    values: Array
    """(k, 3) measured numbers, padded with zeros"""
    R: Array
    """(k, 3, 3) covariance of the values"""
    place: Array
    """(k, 2) position of the landmark [m]"""
    gap: Array
    """(k,) [s] time since the previous measurement of the source; inf if its error is not in the states"""
    slot: NDArray[np.int64]
    """(k,) index of the first state that is an error of the source; -1 if the errors are not states"""


class Events(NamedTuple):
    """One drive; times count from its first event."""

    name: str
    odometry: Odometry
    rates: Rates
    measurements: Measurements
    zero: int
    """[ns] stamp of time 0"""
    errors: int = 0
    """number of states for the errors of sources, see :func:`with_error_states`"""

    @property
    def duration(self) -> float:
        """Return the time [s] of the last odometry message."""
        return float(self.odometry.end[-1])


class Collector:
    """Replacement of a Localization that stores its input, and refuses messages that the filter would drop."""

    def __init__(self, sources: Sequence[str] = (FIXES, HEADINGS, LANDMARKS)) -> None:
        """Create an empty collector for the ``sources`` returned by :func:`sources_of`."""
        self._sources = list(sources)
        self.rates: list[GyroSample] = []
        self.segments: list[tuple[int, OdometryStep]] = []
        self.measured: list[Measurement] = []
        self.resets: list[Measurement] = []
        self._stamp: int | None = None
        self._keys: set[Key] = set()

    def initialise(self, pose: Pose, P: Any, stamp: int | None = None, source: str = _BY_HAND) -> None:
        """Add a reset of the filter to a pose with covariance ``P`` (3, 3), measured by a source."""
        if self._stamp is None:
            self._stamp = stamp
        self.resets.append(Measurement(-1 if self._stamp is None else self._stamp, source, POSE_FIX, np.array(pose), P))

    def on_odometry(self, odometry: OdometryStep) -> None:
        """Add an odometry message.

        Raises:
            BadMessageError: if the filter would drop the message.
            DiffbotError: after a gap at which the filter would restart.
        """
        if not self.resets:
            raise BadMessageError("no fix yet")
        last = odometry.stamp if self._stamp is None else self._stamp
        self._stamp = max(last, odometry.stamp)
        gap = (odometry.stamp - last) * S_PER_NS
        if gap <= 0.0:
            raise BadMessageError("odometry out of order or repeated")
        if gap > _MAX_GAP:
            if not self.segments:
                # The first fix was latched before the recording, as AMCL's. The drive begins with this message.
                raise BadMessageError("long after the first fix")
            raise DiffbotError(
                f"odometry has a gap of {gap:.0f} s, but the filter restarts after a gap of more than {_MAX_GAP:g} s"
            )
        self.segments.append((last, odometry))

    def on_gyro(self, sample: GyroSample) -> None:
        """Add a turn rate.

        Raises:
            BadMessageError: if the turn rate is not finite.
        """
        if not math.isfinite(sample.rate + sample.variance):
            raise BadMessageError("measurement not finite")
        self.rates.append(sample)

    def on_measurements(self, measurements: Iterable[Measurement]) -> list[BadMessageError]:
        """Add the measurements of a message, and return an error for each measurement that the filter would drop."""
        errors = []
        for measurement in measurements:
            try:
                self.on_measurement(measurement)
            except BadMessageError as error:
                errors.append(error)
        return errors

    def on_measurement(self, measurement: Measurement) -> None:
        """Add a measurement. The first fix sets the pose.

        Raises:
            BadMessageError: if the filter would drop the measurement.
        """
        if measurement.source not in self._sources:
            raise BadMessageError("not used by the calibration")
        if measurement.key in self._keys:
            raise BadMessageError("duplicate")
        if not math.isfinite(sum(measurement.key[3])):
            raise BadMessageError("measurement not finite")
        if not self.resets:
            if not is_fix(measurement.kind):
                raise BadMessageError("no fix yet")
            m = len(measurement.z)
            pose, P = np.zeros(3), np.diag((0.0, 0.0, math.pi**2))
            pose[:m], P[:m, :m] = measurement.z, measurement.R
            self.initialise(Pose(*pose.tolist()), P, measurement.stamp, measurement.source)
            return
        self._keys.add(measurement.key)
        self.measured.append(measurement)

    def events(self, name: str, until: float = math.inf, reasons: str = "") -> Events:
        """Return the collected events of the first ``until`` [s].

        Args:
            name: name of the drive, for error messages.
            until: length [s] of the part to use.
            reasons: why messages were dropped, for error messages.

        Raises:
            DiffbotError: if the drive is too short to determine anything.
        """
        because = f" ({reasons})" if reasons else ""
        if not self.segments:
            raise DiffbotError(f"{name}: no odometry that the filter can use{because}")
        first = self.segments[0][0]
        segments = [one for one in self.segments if (one[1].stamp - first) * S_PER_NS <= until] or self.segments[:1]
        last = segments[-1][1].stamp
        measured = sorted((one for one in self.measured if first <= one.stamp <= last), key=attrgetter("key"))
        duration = (last - first) * S_PER_NS
        if len(measured) < MIN_MEASUREMENTS:
            raise DiffbotError(
                f"{name}: {len(measured)} measurements while driving, at least {MIN_MEASUREMENTS} are needed{because}"
            )
        if duration < MIN_DURATION:
            raise DiffbotError(f"{name}: {duration:.1f} s of odometry, at least {MIN_DURATION:g} s are needed")
        resets = [replace(one, stamp=max(one.stamp, first)) for one in self.resets if one.stamp <= last]
        rates = [one for one in self.rates if first <= one.stamp <= last]
        measurements = _measurements(resets, measured, first, self._sources)
        return Events(name, _odometry(segments, first), _rates(rates, first), measurements, first)


class EventReader(FilterRun):
    """Collects the events of recorded messages, which it converts as the filter does."""

    def __init__(self, config: EkfNodeConfig, topics: dict[str, str]) -> None:
        """Create a reader without events. The arguments are those of the base class."""
        super().__init__(config, topics)
        self.localization: Any = Collector(sources_of(config.localization))

    def _answer(self, odometry: OdometryStep) -> Answer | None:
        self.localization.on_odometry(odometry)
        return None

    def events(self, name: str, until: float = math.inf) -> Events:
        """Return the events of the first ``until`` [s]; see :meth:`Collector.events`."""
        found: Events = self.localization.events(name, until, self.reasons())
        return found


def _odometry(segments: list[tuple[int, OdometryStep]], zero: int) -> Odometry:
    return Odometry(
        np.array([(start - zero) * S_PER_NS for start, _ in segments]),
        np.array([(one.stamp - zero) * S_PER_NS for _, one in segments]),
        np.array([one.twist for _, one in segments], dtype=np.float64),
        np.array([one.covariance for _, one in segments], dtype=np.float64),
        np.zeros((0, 2)),
    )


def _rates(samples: list[GyroSample], zero: int) -> Rates:
    """Integrate the samples. If several samples have the same stamp, use the last of them."""
    rows = {one.stamp: (one.rate, one.variance) for one in samples}
    stamps = sorted(rows)
    time = np.array([(one - zero) * S_PER_NS for one in stamps])
    if len(time) < 2:
        return Rates(*np.zeros((3, 0)))
    usual = float(np.median(np.diff(time)))
    dt = np.diff(time, prepend=time[0] - usual)
    rate, variance = np.array([rows[one] for one in stamps]).T
    variance = np.where(dt > _MAX_RATE_GAP * usual, _NO_RATE, variance)
    sums = np.cumsum((dt, rate * dt, variance * dt * dt), axis=1)
    return Rates(*np.pad(sums, ((0, 0), (1, 0))) + np.array([[time[0] - usual], [0.0], [0.0]]))


def _measurements(
    resets: list[Measurement], measured: list[Measurement], zero: int, sources: list[str]
) -> Measurements:
    rows = [(one.stamp, 0, RESET, one) for one in resets] + [(one.stamp, 1, one.kind, one) for one in measured]
    rows.sort(key=lambda row: row[:2])  # The sort is stable: measurements keep their order.
    count = len(rows)
    values, R, place = np.zeros((count, 3)), np.zeros((count, 3, 3)), np.zeros((count, 2))
    own: dict[Any, int] = {}
    sensor, source, none = np.full(count, -1), np.zeros(count, dtype=np.int64), np.full(count, -1)
    for index, (*_, one) in enumerate(rows):
        m = len(one.z)
        values[index, :m], R[index, :m, :m], place[index] = one.z, one.R, one.at
        if one.source != _BY_HAND:
            sensor[index] = sources.index(one.source)
        source[index] = own.setdefault((one.source, one.at), len(own))
    time = np.array([(stamp - zero) * S_PER_NS for stamp, *_ in rows])
    kinds = np.array([row[2] for row in rows], dtype=np.int64)
    return Measurements(time, kinds, sensor, source, values, R, place, np.full(count, np.inf), none)


def with_error_states(events: Events, sensors: set[int]) -> Events:
    """Assign states of the filter to the errors of these sensors.

    If there are more landmarks than states, the landmarks that were measured last have states. A
    landmark with measurements of different kinds counts as one source for each kind.
    """
    measured = events.measurements
    slot, gap = np.full_like(measured.slot, -1), np.full_like(measured.gap, np.inf)
    indices = np.flatnonzero(np.isin(measured.sensor, list(sensors))).tolist()
    # Landmarks are last: a landmark may replace the landmark that has not been measured for the longest time.
    indices.sort(key=lambda index: measured.kind[index] >= LANDMARK)
    slots: tuple[dict[Any, int], dict[Any, int]] = {}, {}
    newest: dict[Any, float] = {}
    size = 0
    for index in indices:
        kind = int(measured.kind[index])
        is_landmark = kind >= LANDMARK
        source, of = (int(measured.source[index]), kind if is_landmark else 0), slots[is_landmark]
        width = 1 if kind == HEADING else 2 if is_landmark else 3
        if source in of:
            of[source] = of.pop(source)
        elif size + width <= _MAX_ERRORS:
            of[source] = STATES + size
            size += width
        else:
            oldest = next(iter(of))
            of[source] = of.pop(oldest)
            del newest[oldest]
        slot[index] = of[source]
        gap[index] = measured.time[index] - newest.get(source, -math.inf)
        newest[source] = float(measured.time[index])
    return events._replace(measurements=measured._replace(slot=slot, gap=gap), errors=size)


def averaged(events: Events, period: float) -> Events:
    """Join odometry messages into means over at most ``period`` [s]: fewer steps, nearly the same likelihood.

    Longer messages are kept. The covariance of a mean assumes that the errors of the messages are independent.
    """
    start, end, twist, covariance, _ = events.odometry
    # A new group begins with the message that would make the present one too long.
    first = [0]
    for index in range(1, len(start)):
        if end[index] - start[first[-1]] > period * 1.001:
            first.append(index)
    at = np.array(first)
    last = np.append(at[1:], len(start)) - 1
    dt = (end - start)[:, None]
    whole = (end[last] - start[at])[:, None]
    mean = np.add.reduceat(twist * dt, at) / whole
    joint = np.add.reduceat(covariance * dt * dt, at) / (whole * whole)
    return events._replace(odometry=Odometry(start[at], end[last], mean, joint, np.zeros((0, 2))))


def with_noise_of_neighbours(events: Events) -> Events:
    """Compute the noise of each odometry message, and the twist for its derivatives, from its neighbours.

    The error of an encoder often grows with the speed. A message that measures too large a speed then also has too
    large a variance or derivative. The resulting bias of the wheel radii is about the variance of the relative error,
    which may exceed the standard deviation of the radii in a long drive. The errors of neighbours are independent of
    the error of the message.
    """
    odometry = events.odometry
    covariance, smooth = (
        convolve1d(one, _NEIGHBOURS, axis=0, mode="nearest") for one in (odometry.covariance, odometry.twist)
    )
    return events._replace(odometry=odometry._replace(covariance=covariance, smooth=smooth))


def with_noise_of_wheels(events: Events, wheel_errors: Array, separation: float) -> Events:
    """Convert the covariances of odometry messages to covariances of the true twists.

    The covariance in a message describes the twist in the message. If the wheels are larger than configured, the true
    twist is larger, and so is its error.

    Args:
        events: events of a drive.
        wheel_errors: (3,) relative errors of the wheels.
        separation: configured wheel separation [m].
    """
    x = np.concatenate((np.zeros(WHEELS), wheel_errors))
    J = np.array([with_wheel_errors(one, x, separation) for one in (Twist(1.0, 0.0), Twist(0.0, 1.0))]).T
    covariance = events.odometry.covariance
    joint = J @ covariance[:, [[0, 1], [1, 2]]] @ J.T
    # In the order of C, as before: numba compiles the filter for each order.
    ordered = np.ascontiguousarray(joint[:, (0, 0, 1), (0, 1, 1)])
    return events._replace(odometry=events.odometry._replace(covariance=ordered))
