"""The history of the newest odometry steps and their measurements, sorted by stamp.

A measurement with a stamp after the newest odometry waits until a step covers its stamp. An earlier measurement is
inserted into the step that covers its stamp, and the caller computes this step and all later steps again.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections import OrderedDict, deque
from dataclasses import dataclass, field
from operator import attrgetter

from diffbot_control.filter.measurement import GyroSample, Key, Measurement
from diffbot_control.filter.models import NO_RATE, Array, TurnRate
from diffbot_control.filter.odometry import OdometryStep
from diffbot_core.errors import BadMessageError
from diffbot_core.stamps import S_PER_NS

_MAX_WAITING = 1000
"""Largest number of measurements that wait for their odometry."""
_MAX_WAITING_GYRO = 10_000
_MAX_KEYS = 10_000
"""Largest number of keys that are stored to recognise duplicates."""
_key_of = attrgetter("key")
_stamp_of = attrgetter("stamp")


@dataclass(slots=True)
class HistoryStep:
    """One odometry step, with all inputs that are needed to compute it again."""

    start: int
    """[ns]"""
    odometry: OdometryStep
    """mean twist; its stamp is the end of the step"""
    whole: int
    """[ns] duration of the whole odometry message or gap; the step may be a part of it"""
    is_gap: bool
    """True if the odometry has a gap here, so that the motion is unknown"""
    memory: Array
    """memory of the filter at the start of the step"""
    measurements: list[Measurement] = field(default_factory=list)
    gyro: list[GyroSample] = field(default_factory=list)
    is_compared: bool = False
    """True if the turn rates of gyro and wheels have been compared"""

    @property
    def duration(self) -> float:
        """Duration of the step [s]."""
        return (self.odometry.stamp - self.start) * S_PER_NS

    def rate(self) -> TurnRate:
        """Return the mean of the gyro samples; NO_RATE if there are none."""
        if not self.gyro:
            return NO_RATE
        n = len(self.gyro)
        return TurnRate(sum(one.rate for one in self.gyro) / n, sum(one.variance for one in self.gyro) / (n * n))


class History:
    """The newest odometry steps with their measurements, and the measurements that wait for their odometry."""

    def __init__(self) -> None:
        """Start empty."""
        self.steps: deque[HistoryStep] = deque()
        """oldest first"""
        self._waiting: list[Measurement] = []
        self._waiting_gyro: list[GyroSample] = []
        self._keys: OrderedDict[Key, None] = OrderedDict()

    def check_new(self, measurement: Measurement) -> None:
        """Refuse a duplicate.

        Raises:
            BadMessageError: if the measurement was added before.
        """
        if measurement.key in self._keys:
            raise BadMessageError("duplicate")

    def remember(self, measurement: Measurement) -> None:
        """Store the key of a measurement, so that :meth:`check_new` refuses duplicates."""
        self._keys[measurement.key] = None
        if len(self._keys) > _MAX_KEYS:
            self._keys.popitem(last=False)

    def append(self, step: HistoryStep) -> None:
        """Append a step, and move all waiting measurements with stamps up to its end into it."""
        end = step.odometry.stamp
        if self._waiting:
            ready = bisect_right(self._waiting, end, key=_stamp_of)
            step.measurements, self._waiting = self._waiting[:ready], self._waiting[ready:]
        if self._waiting_gyro:
            ready = bisect_right(self._waiting_gyro, end, key=_stamp_of)
            step.gyro, self._waiting_gyro = self._waiting_gyro[:ready], self._waiting_gyro[ready:]
        self.steps.append(step)

    def wait(self, measurement: Measurement) -> None:
        """Store a measurement until :meth:`append` adds the step that covers its stamp.

        Raises:
            BadMessageError: if too many measurements with earlier stamps wait already.
        """
        if len(self._waiting) >= _MAX_WAITING:
            if measurement.stamp >= self._waiting[-1].stamp:
                raise BadMessageError("no odometry at its stamp", f"{_MAX_WAITING} measurements already wait")
            # Drop the measurement with the latest stamp: a sender with a wrong clock must not block other senders.
            self._forget_key(self._waiting.pop())
        insort(self._waiting, measurement, key=_key_of)

    def insert(self, measurement: Measurement, now: int) -> int:
        """Insert a measurement into the step that covers its stamp, and return the index of the step.

        Args:
            measurement: measurement with a stamp not after ``now``.
            now: end of the newest step [ns].

        Raises:
            BadMessageError: if the stamp is before the history.
        """
        index = self._covering_index(measurement.stamp, now)
        insort(self.steps[index].measurements, measurement, key=_key_of)
        return index

    def insert_gyro(self, sample: GyroSample, now: int) -> int | None:
        """Insert a turn rate into the step that covers its stamp, or store it until this step is appended.

        Args:
            sample: measured turn rate.
            now: end of the newest step [ns].

        Returns:
            The index of the step, or None if the sample waits.

        Raises:
            BadMessageError: if the sample is a duplicate, if it is before the history, or if too many samples wait.
        """
        index = None if sample.stamp > now else self._covering_index(sample.stamp, now)
        samples = self._waiting_gyro if index is None else self.steps[index].gyro
        position = bisect_left(samples, sample.stamp, key=_stamp_of)
        if position < len(samples) and samples[position].stamp == sample.stamp:
            raise BadMessageError("duplicate")
        if index is None and len(samples) >= _MAX_WAITING_GYRO:
            raise BadMessageError("no odometry at its stamp", f"{_MAX_WAITING_GYRO} samples already wait")
        samples.insert(position, sample)
        return index

    def _covering_index(self, stamp: int, now: int) -> int:
        for index in range(len(self.steps) - 1, -1, -1):
            start = self.steps[index].start
            # A stamp equal to the start of the history belongs to the state that the history starts from.
            if start < stamp or (index == 0 and start == stamp):
                return index
        raise BadMessageError(
            "too old", f"{(now - stamp) * S_PER_NS:.3f} s older than the odometry, before the history"
        )

    def trim(self, length: int) -> None:
        """Drop the steps that end more than ``length`` [ns] before the newest step, and keys of the same age."""
        oldest = self.steps[-1].odometry.stamp - length
        while self.steps[0].odometry.stamp < oldest:
            self.steps.popleft()
        # Keys are in order of arrival, so the keys of late measurements are kept a little longer than necessary. A key
        # with a stamp far in the future stops this loop until _MAX_KEYS newer keys have replaced it.
        while self._keys and next(iter(self._keys))[0] < oldest:
            self._keys.popitem(last=False)

    def drop_waiting_before(self, stamp: int) -> int:
        """Drop the waiting measurements with stamps before ``stamp`` [ns], and return their number."""
        count = bisect_left(self._waiting, stamp, key=_stamp_of)
        for dropped in self._waiting[:count]:
            self._forget_key(dropped)
        del self._waiting[:count]
        return count

    def clear(self) -> None:
        """Drop all steps and waiting measurements, but keep waiting turn rates."""
        self.steps.clear()
        for dropped in self._waiting:
            self._forget_key(dropped)
        self._waiting.clear()

    def clear_gyro(self) -> None:
        """Drop the waiting turn rates."""
        self._waiting_gyro.clear()

    def _forget_key(self, dropped: Measurement) -> None:
        """Remove the key of a measurement that was never fused, so that the measurement can be sent again."""
        self._keys.pop(dropped.key, None)
