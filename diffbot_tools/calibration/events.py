"""A recorded drive as arrays: what the likelihood of its innovations needs, in the order of the stamps."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.gyro import GyroSample
from diffbot_control.filter.measurements import (
    FIXES,
    HEADINGS,
    LANDMARKS,
    Heading,
    LandmarkMeasurement,
    Measurement,
    PoseFix,
    PositionFix,
    Source,
)
from diffbot_control.filter.measurements.fix import further_source
from diffbot_control.filter.measurements.measurement import Key, key_of
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.geometry import Pose
from diffbot_core.units import S_PER_NS
from diffbot_sim.compiled.ekf import GYRO, POSE
from diffbot_tools.refilter.filter_run import Answer, FilterRun

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
"""(k,) which measurements count"""
HEADING, LANDMARK, FIX, RESET = 0, 1, 2, 3
"""Kinds of event."""
MIN_MEASUREMENTS, MIN_DURATION = 30, 10.0
"""A drive with fewer measurements, or shorter than this [s], determines nothing."""
_MAX_GAP = 1000.0
"""[s] between two odometry messages; the filter would start again"""
_STATES = (0, 3, 8, 16, 32)
"""Numbers of errors of sources that can be states: the filter is compiled for each number once."""
_MAX_RATE_GAP = 5.0
"""Periods of a gyro without a sample, beyond which nothing is known of the turn rate."""
_NO_RATE, UNKNOWN_RATE = 1e6, 1.0
"""[rad^2/s^2] variance of a turn rate in such a gap; one that is larger than the second is not known"""
_ORIGIN = Pose(0.0, 0.0, 0.0)
_NO_SOURCE = Source("")
"""Of a pose that was put in by hand."""
Usable = PoseFix | PositionFix | Heading | LandmarkMeasurement
"""Measurements that the kernel knows."""


class Odometry(NamedTuple):
    """Mean twists; message k is the mean over (start[k], end[k]]."""

    start: Array
    """(n,) [s]"""
    end: Array
    """(n,) [s]"""
    twist: Array
    """(n, 2) v [m/s], omega [rad/s]"""
    covariance: Array
    """(n, 3) of v, of both, of omega; all zero: unknown"""


class Rates(NamedTuple):
    """Turn rates of a gyro, summed up: what a sample says is said of the time since the sample before."""

    time: Array
    """(g,) [s]"""
    angle: Array
    """(g,) [rad] sum of rate dt"""
    variance: Array
    """(g,) [rad^2] sum of variance dt^2"""


class Measurements(NamedTuple):
    """Measurements and resets of the pose, in the order in which the filter fuses them.

    Their sensors: 0 headings, 1 landmarks, 2 fixes on ``global_pose``, and then one for each further source of fixes;
    -1 for a pose that was put in by hand.
    """

    time: Array
    """(k,) [s]"""
    kind: NDArray[np.int64]
    """(k,) HEADING, LANDMARK, FIX or RESET"""
    sensor: NDArray[np.int64]
    """(k,)"""
    source: NDArray[np.int64]
    """(k,) 0, 1, ...: sources whose errors may be correlated in time; each landmark is one"""
    values: Array
    """(k, 3) theta; range and bearing; x, y and theta"""
    R: Array
    """(k, 3, 3) covariance of the values; inf on the diagonal: not measured"""
    place: Array
    """(k, 2) of the landmark [m]"""
    gap: Array
    """(k,) [s] since the measurement before of the same source; inf: none, or its error is no state any more"""
    slot: NDArray[np.int64]
    """(k,) first of the states that are the errors of the source; -1: they are none"""


class Events(NamedTuple):
    """One drive; times count from its first event."""

    name: str
    odometry: Odometry
    rates: Rates
    measurements: Measurements
    zero: int
    """[ns] stamp of time 0"""
    errors: int = 0
    """number of errors of sources that are states, see :func:`with_error_states`"""

    @property
    def duration(self) -> float:
        """Time [s] of the last odometry."""
        return float(self.odometry.end[-1])


class Collector:
    """Stands in the place of a localization and keeps its input; refuses what the filter would drop."""

    def __init__(self, further: tuple[str, ...] = ()) -> None:
        """Start without a pose; ``further`` are the topics of fixes beside ``global_pose``."""
        self._sensors = (HEADINGS, LANDMARKS, FIXES, *(further_source(one).sensor for one in further))
        self.rates: list[GyroSample] = []
        self.segments: list[tuple[int, OdometryStep]] = []
        self.measured: list[Usable] = []
        self.resets: list[PoseFix] = []
        self._stamp: int | None = None
        self._keys: set[Key] = set()

    def initialise(self, pose: Pose, P: Any, stamp: int | None = None, source: Source = _NO_SOURCE) -> None:
        """Put the filter at a pose with covariance ``P`` (3, 3), measured by a source."""
        if self._stamp is None:
            self._stamp = stamp
        self.resets.append(PoseFix(-1 if self._stamp is None else self._stamp, pose, P, source))

    def on_odometry(self, odometry: OdometryStep) -> None:
        """Add a message.

        Raises:
            BadMessageError: if the filter would not use it.
            DiffbotError: after a gap at which the filter would start again.
        """
        if not self.resets:
            raise BadMessageError("no fix yet")
        last = odometry.stamp if self._stamp is None else self._stamp
        self._stamp = max(last, odometry.stamp)
        if odometry.stamp <= last:
            raise BadMessageError("odometry out of order or repeated")
        if (odometry.stamp - last) * S_PER_NS > _MAX_GAP:
            raise DiffbotError(
                f"odometry has a gap of {(odometry.stamp - last) * S_PER_NS:.0f} s: at most {_MAX_GAP:g}"
            )
        self.segments.append((last, odometry))

    def on_gyro(self, sample: GyroSample) -> None:
        """Add a turn rate.

        Raises:
            BadMessageError: if it is not finite.
        """
        if not math.isfinite(sample.rate + sample.variance):
            raise BadMessageError("measurement not finite")
        self.rates.append(sample)

    def on_measurements(self, measurements: Iterable[Measurement]) -> list[BadMessageError]:
        """Add the measurements of a message, and return an error for each that the filter would not use."""
        errors = []
        for measurement in measurements:
            try:
                self.on_measurement(measurement)
            except BadMessageError as error:
                errors.append(error)
        return errors

    def on_measurement(self, measurement: Measurement) -> None:
        """Add a measurement; the first fix puts the filter there.

        Raises:
            BadMessageError: if the filter would not use it.
        """
        if not isinstance(measurement, (PoseFix, PositionFix, Heading, LandmarkMeasurement)):
            raise BadMessageError("not used by the calibration")
        key = key_of(measurement)
        if key in self._keys:
            raise BadMessageError("duplicate")
        if not math.isfinite(sum(key[2])):
            raise BadMessageError("measurement not finite")
        if not self.resets:
            start = measurement.restart(_ORIGIN)
            if start is None:
                raise BadMessageError("no fix yet")
            self.initialise(*start, measurement.stamp, measurement.source)
            return
        self._keys.add(key)
        self.measured.append(measurement)

    def events(self, name: str, until: float = math.inf, reasons: str = "") -> Events:
        """Return what was collected in the first ``until`` [s]; ``reasons`` why messages were dropped, for an error.

        Raises:
            DiffbotError: if that is too little to determine anything.
        """
        if not self.segments:
            raise DiffbotError(f"{name}: no odometry that the filter can use{reasons}")
        first = self.segments[0][0]
        segments = [one for one in self.segments if (one[1].stamp - first) * S_PER_NS <= until] or self.segments[:1]
        last = segments[-1][1].stamp
        measured = sorted((one for one in self.measured if first <= one.stamp <= last), key=key_of)
        duration = (last - first) * S_PER_NS
        if len(measured) < MIN_MEASUREMENTS:
            raise DiffbotError(
                f"{name}: {len(measured)} measurements while driving, at least {MIN_MEASUREMENTS} are needed{reasons}"
            )
        if duration < MIN_DURATION:
            raise DiffbotError(f"{name}: {duration:.1f} s of odometry, at least {MIN_DURATION:g} s are needed")
        resets = [replace(one, stamp=max(one.stamp, first)) for one in self.resets if one.stamp <= last]
        measurements = _measurements(resets, measured, first, self._sensors)
        rates = _rates([one for one in self.rates if first <= one.stamp <= last], first)
        return Events(name, _odometry(segments, first), rates, measurements, first)


class EventReader(FilterRun):
    """Takes recorded messages as a filter does, with the same conversions, and keeps them instead."""

    def __init__(self, config: EkfNodeConfig, topics: dict[str, str]) -> None:
        """Start empty; arguments as of the base class."""
        super().__init__(config, topics)
        self._collector = Collector(config.localization.sources.pose_sources)
        self.localization: Any = self._collector

    def _answer(self, odometry: OdometryStep) -> Answer | None:  # type: ignore[override]
        self._collector.on_odometry(odometry)
        return None

    def events(self, name: str, until: float = math.inf) -> Events:
        """Return what was collected in the first ``until`` [s]; see :meth:`Collector.events`."""
        return self._collector.events(name, until, _reasons(self.dropped))


def _reasons(dropped: Counter[tuple[str, str]]) -> str:
    text = "; ".join(f"{topic}: {kind} ({count})" for (topic, kind), count in dropped.most_common(3))
    return f" ({text})" if text else ""


def _odometry(segments: list[tuple[int, OdometryStep]], zero: int) -> Odometry:
    return Odometry(
        np.array([(start - zero) * S_PER_NS for start, _ in segments]),
        np.array([(one.stamp - zero) * S_PER_NS for _, one in segments]),
        np.array([one.twist for _, one in segments], dtype=np.float64),
        np.array([one.covariance for _, one in segments], dtype=np.float64),
    )


def _rates(samples: list[GyroSample], zero: int) -> Rates:
    """Sum up samples, of which those with equal stamps but the last are ignored."""
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


def _measurements(resets: list[PoseFix], measured: list[Usable], zero: int, sensors: tuple[str, ...]) -> Measurements:
    rows = [(one.stamp, 0, RESET, one) for one in resets] + [(one.stamp, 1, _kind(one), one) for one in measured]
    rows.sort(key=lambda row: row[:2])  # stable: measurements stay in their order
    count = len(rows)
    values, R, place = np.zeros((count, 3)), np.zeros((count, 3, 3)), np.zeros((count, 2))
    sources: dict[Any, int] = {}
    sensor, source, gap = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64), np.full(count, np.inf)
    time = np.array([(stamp - zero) * S_PER_NS for stamp, *_ in rows])
    newest: dict[int, float] = {}
    for index, (*_, one) in enumerate(rows):
        numbers, covariance = _numbers(one)
        size = len(numbers)
        values[index, :size], R[index, :size, :size] = numbers, covariance
        if isinstance(one, LandmarkMeasurement):
            place[index] = one.landmark
        sensor[index] = sensors.index(one.source.sensor) if one.source != _NO_SOURCE else -1
        source[index] = own = sources.setdefault(one.source, len(sources))
        gap[index] = time[index] - newest.get(own, -math.inf)
        newest[own] = time[index]
    kinds = np.array([row[2] for row in rows], dtype=np.int64)
    return Measurements(time, kinds, sensor, source, values, R, place, gap, np.full(count, -1))


def with_error_states(events: Events, sensors: set[int]) -> Events:
    """Let the errors of these sensors be states of the filter; of landmarks, those of the last seen.

    Of a landmark whose range or bearing is missing now and then, those are two sources.
    """
    measured = events.measurements
    slot, gap = np.full_like(measured.slot, -1), measured.gap.copy()
    indices = np.flatnonzero(np.isin(measured.sensor, list(sensors))).tolist()
    # The others first: they stay. A landmark takes the states of the one that was not seen for the longest time.
    indices.sort(key=lambda index: measured.kind[index] == LANDMARK)
    slots: tuple[dict[Any, int], dict[Any, int]] = {}, {}
    newest: dict[Any, float] = {}
    size = 0
    for index in indices:
        kind = int(measured.kind[index])
        known = np.isfinite(measured.R[index].diagonal()).tobytes() if kind == LANDMARK else b""
        source, of = (int(measured.source[index]), known), slots[kind == LANDMARK]
        width = {HEADING: 1, LANDMARK: 2}.get(kind, POSE)
        if source in of:
            of[source] = of.pop(source)
        elif size + width <= _STATES[-1]:
            of[source] = GYRO + size
            size += width
        else:
            oldest = next(iter(of))
            of[source] = of.pop(oldest)
            del newest[oldest]
        slot[index] = of[source]
        gap[index] = measured.time[index] - newest.get(source, -math.inf)
        newest[source] = float(measured.time[index])
    size = next(one for one in _STATES if one >= size)
    return events._replace(measurements=measured._replace(slot=slot, gap=gap), errors=size)


_KINDS = {PoseFix: FIX, PositionFix: FIX, Heading: HEADING, LandmarkMeasurement: LANDMARK}


def _kind(measurement: Usable) -> int:
    return _KINDS[type(measurement)]


def _numbers(measurement: Usable) -> tuple[Any, Array]:
    """Return the numbers of a row and their covariance; the kernel marks a missing number of a landmark by its R."""
    if isinstance(measurement, LandmarkMeasurement):
        return (measurement.range, measurement.bearing), measurement.R
    if isinstance(measurement, PositionFix):
        pose, P = measurement.restart(_ORIGIN)
        P[2, 2] = math.inf
        return pose, P
    return measurement.z, measurement.R


def averaged(events: Events, period: float) -> Events:
    """Join odometry messages into means over at most ``period`` [s]: fewer steps, nearly the same likelihood.

    A message longer than that stays as it is. The covariance becomes that of the mean of independent errors.
    """
    start, end, twist, covariance = events.odometry
    # A new group begins with the message that would make the present one too long, or that follows a gap.
    first = [0]
    for index in range(1, len(start)):
        if end[index] - start[first[-1]] > period * 1.001 or start[index] > end[index - 1] + 1e-9:
            first.append(index)
    at = np.array(first)
    last = np.append(at[1:], len(start)) - 1
    dt = (end - start)[:, None]
    whole = (end[last] - start[at])[:, None]
    mean = np.add.reduceat(twist * dt, at) / whole
    joint = np.add.reduceat(covariance * dt * dt, at) / (whole * whole)
    return events._replace(odometry=Odometry(start[at], end[last], mean, joint))
