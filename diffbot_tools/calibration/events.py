"""A recorded drive as arrays: what the likelihood of its innovations needs, in the order of the stamps."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.gyro import GyroSample
from diffbot_control.filter.measurements import (
    Heading,
    LandmarkMeasurement,
    Measurement,
    PoseFix,
    PositionFix,
)
from diffbot_control.filter.measurements.measurement import Key, key_of
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.geometry import Pose
from diffbot_core.units import S_PER_NS
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
_NO_HEADING = 1e6
"""[rad^2] variance that stands for a fix without a heading"""
_ORIGIN = Pose(0.0, 0.0, 0.0)
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


class Measurements(NamedTuple):
    """Measurements and resets of the pose, in the order in which the filter fuses them."""

    time: Array
    """(k,) [s]"""
    kind: NDArray[np.int64]
    """(k,) HEADING, LANDMARK, FIX or RESET"""
    source: NDArray[np.int64]
    """(k,) 0, 1, ...: sources whose errors may be correlated in time; each landmark is one"""
    values: Array
    """(k, 3) theta; range and bearing; x, y and theta"""
    R: Array
    """(k, 3, 3) covariance of the values; inf on the diagonal: not measured"""
    place: Array
    """(k, 2) of the landmark [m]"""


class Events(NamedTuple):
    """One drive; times count from its first event."""

    name: str
    odometry: Odometry
    measurements: Measurements
    zero: int
    """[ns] stamp of time 0"""
    starts_from_fix: bool
    """the first reset is a fix, whose error later fixes may repeat"""

    @property
    def duration(self) -> float:
        """Time [s] of the last odometry."""
        return float(self.odometry.end[-1])


class Collector:
    """Stands in the place of a localization and keeps its input; refuses what the filter would drop."""

    def __init__(self) -> None:
        """Start without a pose."""
        self.segments: list[tuple[int, OdometryStep]] = []
        self.measured: list[Usable] = []
        self.resets: list[PoseFix] = []
        self.starts_from_fix = False
        self._stamp: int | None = None
        self._keys: set[Key] = set()

    def initialise(self, pose: Pose, P: Any, stamp: int | None = None) -> None:
        """Put the filter at a pose with covariance ``P`` (3, 3)."""
        if self._stamp is None:
            self._stamp = stamp
        self.resets.append(PoseFix(-1 if self._stamp is None else self._stamp, pose, P))

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
        """Ignore a turn rate: the wheels are calibrated by what knows the pose."""

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
            self.initialise(*start, measurement.stamp)
            self.starts_from_fix = True
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
        odometry, measurements = _odometry(segments, first), _measurements(resets, measured, first)
        return Events(name, odometry, measurements, first, self.starts_from_fix)


class EventReader(FilterRun):
    """Takes recorded messages as a filter does, with the same conversions, and keeps them instead."""

    def __init__(self, config: EkfNodeConfig, topics: dict[str, str]) -> None:
        """Start empty; arguments as of the base class."""
        super().__init__(config, topics)
        self._collector = Collector()
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


def _measurements(resets: list[PoseFix], measured: list[Usable], zero: int) -> Measurements:
    rows = [(one.stamp, 0, RESET, one) for one in resets] + [(one.stamp, 1, _kind(one), one) for one in measured]
    rows.sort(key=lambda row: row[:2])  # stable: measurements stay in their order
    count = len(rows)
    values, R, place = np.zeros((count, 3)), np.zeros((count, 3, 3)), np.zeros((count, 2))
    sources: dict[Any, int] = {}
    source = np.zeros(count, dtype=np.int64)
    for index, (_, _, kind, one) in enumerate(rows):
        numbers, covariance = _numbers(one)
        size = len(numbers)
        values[index, :size], R[index, :size, :size] = numbers, covariance
        if isinstance(one, LandmarkMeasurement):
            place[index] = one.landmark
        key: Any = one.source if kind in (HEADING, LANDMARK) else FIX
        source[index] = sources.setdefault(key, len(sources))
    time = np.array([(stamp - zero) * S_PER_NS for stamp, *_ in rows])
    return Measurements(time, np.array([row[2] for row in rows], dtype=np.int64), source, values, R, place)


_KINDS = {PoseFix: FIX, PositionFix: FIX, Heading: HEADING, LandmarkMeasurement: LANDMARK}


def _kind(measurement: Usable) -> int:
    return _KINDS[type(measurement)]


def _numbers(measurement: Usable) -> tuple[Any, Array]:
    """Return the numbers of a row and their covariance; the kernel marks a missing number of a landmark by its R."""
    if isinstance(measurement, LandmarkMeasurement):
        return (measurement.range, measurement.bearing), measurement.R
    if isinstance(measurement, PositionFix):
        pose, P = measurement.restart(_ORIGIN)
        P[2, 2] = _NO_HEADING
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
