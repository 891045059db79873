"""Fusing odometry, fixes, headings and landmarks in the order of their stamps, whatever the order of arrival.

The filter's time is the stamp of the newest odometry. A measurement with a later stamp waits for its odometry. One with
an earlier stamp is inserted into a bounded history of odometry steps, and the steps after it are computed again.
"""

from __future__ import annotations

import math
from bisect import insort
from collections import OrderedDict, deque
from collections.abc import Collection, Iterable
from typing import NamedTuple

from diffbot_control.filter import contradiction
from diffbot_control.filter.belief import Belief, pose_of
from diffbot_control.filter.gate import RELOCATED
from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.gyro import GyroHistory, GyroSample
from diffbot_control.filter.innovation_monitor import InnovationMonitor
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements import FIXES, Array, Measurement
from diffbot_control.filter.measurements.gyro import GyroRate
from diffbot_control.filter.measurements.measurement import Key, key_of, split_at
from diffbot_control.filter.memory import Memory
from diffbot_control.filter.models import (
    NO_RATE,
    GyroShare,
    Motion,
    TurnRate,
    covariance_with_rate,
    gyro_share,
    slip_covariance,
    with_rate,
)
from diffbot_control.filter.odometry import DelayLine, OdometryStep
from diffbot_control.filter.odometry_noise import density_of, over_time
from diffbot_control.filter.options import FilterOptions, options_of
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance, WheelGeometry, add_twist_covariance, scale_twist_covariance
from diffbot_core.units import S_PER_NS

_MAX_PENDING = 1000
"""Measurements that may wait for their odometry; if there are more, no odometry comes."""
_MAX_GAP = 1000 * 10**9
"""[ns] between two odometry messages; a longer motion is not described by its mean twist."""
_MAX_KEYS = 10_000
"""Number of measurements whose keys are kept to recognise duplicates."""


_ORIGIN = Pose(0.0, 0.0, 0.0)
_NO_SLIP = TwistCovariance(0.0, 0.0, 0.0)
_NO_SHARE = GyroShare(0.0, 0.0)


class FilterEstimate(NamedTuple):
    """State of the filter at one time."""

    stamp: int
    """[ns]"""
    pose: Pose
    P: Array
    """(3, 3) covariance of x, y, theta [m, m, rad]"""
    odometry: OdometryStep | None
    """what moved the robot to this time; None at first"""
    average: Belief
    """all states, averaged over the hypotheses on the estimated errors, see :mod:`averaging`"""


class _Step:
    """One odometry step of the history with the filter's memory before it, so that it can be computed again."""

    __slots__ = ("is_gap", "measurements", "memory", "odometry", "start", "whole")

    def __init__(
        self,
        start: int,
        odometry: OdometryStep,
        whole: int,
        memory: Memory,
        measurements: list[Measurement],
        is_gap: bool,
    ) -> None:
        self.start = start
        self.is_gap = is_gap
        self.odometry = odometry
        self.whole = whole
        self.memory = memory
        self.measurements = measurements


class Localization:
    """A filter that fuses measurements by their stamps; it starts with the first fix, or by :meth:`initialise`."""

    def __init__(
        self,
        config: LocalizationConfig,
        wheel_separation: float = WheelGeometry().wheel_separation,
        max_extrapolation: float = math.inf,
        *,
        landmarks: bool = False,
    ) -> None:
        """Start unknown: :attr:`initialised` is False until a pose comes.

        Args:
            config: options of the fusion.
            wheel_separation: L [m].
            max_extrapolation: [s] before its stamp for which an odometry's twist is taken for the motion; see
                :meth:`on_odometry`.
            landmarks: there are some, so the errors of their sensor may be states.
        """
        self.config = config
        self.max_extrapolation = max_extrapolation
        self._history = round(config.history_length / S_PER_NS)
        self._landmarks = landmarks
        self.filter = GatedFilter(self._options(), wheel_separation, config.correlation_times())
        self.monitor = InnovationMonitor()
        self.dropped_before_odometry = 0
        """number of measurements dropped because their stamps are before the first odometry's"""
        self.slips = 0
        """number of odometry steps whose turn rate the gyro contradicted"""
        self.slipping = 0.0
        """[s] for which it has done so without a break"""
        self.initialised = False
        self.contradiction = contradiction.NONE
        """signs that the fixes contradict the odometry"""
        self._stamp: int | None = None
        self._odometry: OdometryStep | None = None
        self._steps: deque[_Step] = deque()
        self._delayed = DelayLine()
        self._pending: list[Measurement] = []
        self._keys: OrderedDict[Key, None] = OrderedDict()
        self._gyro = GyroHistory()
        self._rate, self._share = NO_RATE, _NO_SHARE

    def configure(self, config: LocalizationConfig, wheel_separation: float) -> None:
        """Apply changed options from the next message on; the variant of the filter stays."""
        self._history = round(config.history_length / S_PER_NS)
        self.config = config._replace(filter=config.filter._replace(filter=self.config.filter.filter))
        self.filter.configure(self._options(), wheel_separation, self.config.correlation_times())

    def _options(self) -> FilterOptions:
        return options_of(self.config.filter, landmarks=self._landmarks)

    def reset(self) -> None:
        """Reset everything to unknown; the next fix initialises the filter."""
        self.filter.reset()
        self.monitor.clear()
        self.initialised = False
        self.contradiction = contradiction.NONE
        self._stamp = None
        self._odometry = None
        self._steps.clear()
        self._delayed.clear()
        self._pending.clear()
        self._keys.clear()
        self._gyro.clear()
        self._rate, self._share = NO_RATE, _NO_SHARE
        self.slipping = 0.0

    def initialise(self, pose: Pose, P: Array, stamp: int | None = None) -> None:
        """Put the filter at ``pose`` with covariance ``P`` (3, 3).

        The radius errors stay, and so does the filter's time; if it has none yet, that is ``stamp`` [ns], or the first
        odometry's.
        """
        self.filter.reset_to(pose, P)
        self.monitor.clear()
        self.contradiction = contradiction.NONE
        self._steps.clear()
        for waiting in self._pending:
            self._forget_key(waiting)
        self._pending.clear()
        if self._stamp is None:
            self._stamp = stamp
        self.initialised = True

    def estimate(self) -> FilterEstimate:
        """Return the present state.

        Raises:
            BadMessageError: before the first fix or odometry.
        """
        if not self.initialised or self._stamp is None:
            raise BadMessageError("no fix yet")
        average = self.filter.average()
        return FilterEstimate(self._stamp, pose_of(average), average.P[:3, :3], self._odometry, average)

    def twist_of(self, estimate: FilterEstimate, odometry: OdometryStep) -> tuple[Twist, TwistCovariance]:
        """Return the twist of the newest odometry, corrected by the errors in an estimate and the gyro.

        Returns:
            The twist and its covariance; a covariance of zeros is unknown and stays so.
        """
        x, states = estimate.average.x, self.filter.states
        wheels = self.filter.corrected_twist(odometry.twist, x)
        bias = x[states.gyro]
        if not bias.size:
            return wheels, odometry.covariance
        difference = self._rate.value - bias.item() - wheels.omega
        return with_rate(wheels, difference, self._share), covariance_with_rate(odometry.covariance, self._share)

    def correlated(self) -> list[str]:
        """Return the sensors whose innovations are more correlated in time than the filter assumes their errors to be.

        The autocorrelation of the innovations is that of the errors if the filter follows none of them, and less
        otherwise.
        """
        assumed = self.filter.assumed_correlation
        return [
            name
            for name, one in self.monitor.whiteness().items()
            if one.correlation > assumed(name, one.periods) + one.alarm
        ]

    def check_innovations(self) -> None:
        """Look for fixes that contradict the odometry without relocating the filter; to be called now and then."""
        nis, found = self.monitor.nis(), self.monitor.whiteness().get(FIXES)
        if nis is not None and found is not None and self._stamp is not None:
            self.contradiction = contradiction.with_innovations(
                self.contradiction, self._stamp, nis.mean / nis.alarm, found.correlation
            )

    def on_odometry(self, odometry: OdometryStep) -> FilterEstimate:
        """Move to the stamp of ``odometry`` and fuse the measurements that waited for it.

        An odometry with the stamp of the last one (a repetition) is answered without moving. After a gap in the
        odometry its twist moves the estimate for the last ``max_extrapolation`` seconds only. Before, the estimate
        stays, and its deviation grows by the way that the faster of the two twists around the gap would have made.

        Raises:
            BadMessageError: before the first fix; out of order; or if time jumped back by more than the history, or
                ahead by more than 1000 s, which resets the filter.
        """
        if not self.initialised:
            raise BadMessageError("no fix yet")
        if self._stamp is None:
            self._stamp = odometry.stamp
            self._drop_pending_before(odometry.stamp)
        late = self._stamp - odometry.stamp
        if late >= 0 or late < -_MAX_GAP:
            self._check_time(late)
            return self.estimate()
        late += self._cross_gap(-late, odometry)
        delay = round(self.config.odometry.odometry_delay / S_PER_NS)
        for piece, whole in self._delayed.pieces(self._stamp, odometry, delay) if delay else ((odometry, -late),):
            self._step(self._stamp, piece, whole)
        self._trim()
        return self.estimate()

    def _cross_gap(self, whole: int, after: OdometryStep) -> int:
        """Pass the part of ``whole`` [ns] in which the motion before ``after`` is unknown; return its length [ns]."""
        start = self._stamp
        if start is None or whole * S_PER_NS <= self.max_extrapolation:
            return 0
        gap = whole - round(self.max_extrapolation / S_PER_NS)
        before = self._odometry.twist if self._odometry is not None else after.twist
        v = max(abs(before.v), abs(after.twist.v))
        # A deviation of pi says that nothing is known of the heading.
        omega = min(max(abs(before.omega), abs(after.twist.omega)), math.pi / (gap * S_PER_NS))
        unknown = OdometryStep(start + gap, Twist(0.0, 0.0), TwistCovariance(v * v, 0.0, omega * omega))
        self._delayed.clear()
        self._step(start, unknown, gap, is_gap=True)
        return gap

    def _step(self, start: int, odometry: OdometryStep, whole: int, is_gap: bool = False) -> None:
        """Move with a twist from ``start`` [ns] to its stamp; it is the mean twist of ``whole`` [ns]."""
        ready, self._pending = split_at(self._pending, odometry.stamp)
        step = _Step(start, odometry, whole, self.filter.memory, ready, is_gap)
        self._steps.append(step)
        self._propagate(step)
        distance = abs(odometry.twist.v) * (odometry.stamp - start) * S_PER_NS
        self.contradiction = contradiction.with_motion(self.contradiction, odometry.stamp, distance)
        self._stamp = odometry.stamp
        self._odometry = odometry

    def _check_time(self, late: int) -> None:
        """Refuse an odometry that is ``late`` [ns] behind the newest; negative: ahead of it; 0: a repetition."""
        if late > self._history:
            self.reset()
            raise BadMessageError("time jumped back", f"by {late * S_PER_NS:.3f} s; filter reset")
        if late < -_MAX_GAP:
            self.reset()
            raise BadMessageError("time jumped ahead", f"by {-late * S_PER_NS:.3f} s; filter reset")
        if late > 0:
            raise BadMessageError("out of order", f"{late * S_PER_NS:.3f} s behind the newest")

    def _drop_pending_before(self, stamp: int) -> None:
        while self._pending and self._pending[0].stamp < stamp:
            self._forget_key(self._pending.pop(0))
            self.dropped_before_odometry += 1

    def on_measurement(self, measurement: Measurement) -> None:
        """Fuse one measurement, see :meth:`on_measurements`.

        Raises:
            BadMessageError: if the measurement is dropped.
        """
        for error in self.on_measurements((measurement,)):
            raise error

    def on_measurements(self, measurements: Iterable[Measurement]) -> list[BadMessageError]:
        """Fuse the measurements of a message, each at its own stamp, and return an error for each that is dropped.

        The odometry steps after late measurements are computed again once, however many measurements are late.

        A measurement is dropped if it is a duplicate (stamp, source and numbers), if it is not finite, if it is older
        than the history, if too many with earlier stamps wait for their odometry already, or if the filter has not
        started and cannot start from it.
        """
        errors: list[BadMessageError] = []
        late: dict[Measurement, int] = {}
        for measurement in measurements:
            try:
                if (index := self._insert(measurement)) is not None:
                    late[measurement] = index
            except BadMessageError as error:
                errors.append(error)
        if late:
            self._repeat_from(min(late.values()), late)
        return errors

    def _insert(self, measurement: Measurement) -> int | None:
        """Fuse a measurement or store it until its odometry comes.

        Returns:
            The index of the step from which the caller has to compute the history again; None if nothing changes there.

        Raises:
            BadMessageError: if the measurement is dropped.
        """
        key = key_of(measurement)
        if key in self._keys:
            raise BadMessageError("duplicate")
        if not math.isfinite(sum(key[2])):
            raise BadMessageError("measurement not finite")
        late = None
        if not self.initialised:
            start = measurement.restart(_ORIGIN)
            if start is None:
                raise BadMessageError("no fix yet")
            self.initialise(*start, measurement.stamp)
            self.filter.start_from(measurement)
        elif self._stamp is None or measurement.stamp > self._stamp:
            self._wait(measurement)
        elif measurement.stamp == self._stamp and not self._steps:
            self._update(measurement)
        else:
            # Also one with the present stamp: it may belong before others with that stamp.
            late = self._insert_late(measurement)
        self._keys[key] = None
        if len(self._keys) > _MAX_KEYS:
            self._keys.popitem(last=False)
        return late

    def _wait(self, measurement: Measurement) -> None:
        if len(self._pending) >= _MAX_PENDING:
            if measurement.stamp >= self._pending[-1].stamp:
                raise BadMessageError("no odometry for it", f"{_MAX_PENDING} measurements wait already")
            # Drop the one furthest ahead: a sender with a wrong clock must not block the others.
            self._forget_key(self._pending.pop())
        if self._pending:
            insort(self._pending, measurement, key=key_of)
        else:
            self._pending.append(measurement)

    def _forget_key(self, dropped: Measurement) -> None:
        """Allow a measurement that was never fused to be sent again."""
        self._keys.pop(key_of(dropped), None)

    def _insert_late(self, measurement: Measurement) -> int:
        """Insert a measurement into the step of the history that it was made in, and return the step's index."""
        for index in range(len(self._steps) - 1, -1, -1):
            step = self._steps[index]
            # A stamp equal to the start of the history belongs to the state that the history starts from.
            covered = step.start < measurement.stamp or (index == 0 and step.start == measurement.stamp)
            if covered and measurement.stamp <= step.odometry.stamp:
                insort(step.measurements, measurement, key=key_of)
                return index
        raise BadMessageError("too old", "its stamp is before the history")

    def on_gyro(self, sample: GyroSample) -> None:
        """Take a turn rate into the odometry step that it was measured in, which may still have to come.

        Raises:
            BadMessageError: before the first odometry; without use_gyro; if it is a duplicate or not finite, if it is
                older than the history, or if too many wait for their odometry already.
        """
        if self._stamp is None or not self.initialised:
            raise BadMessageError("no odometry yet")
        if self.filter.gyro_bias() is None:
            raise BadMessageError("not used", "use_gyro is false")
        self._gyro.check(sample, self._stamp)
        if sample.stamp > self._stamp:
            self._gyro.add(sample)
            return
        for index in range(len(self._steps) - 1, -1, -1):
            if self._steps[index].start < sample.stamp <= self._steps[index].odometry.stamp:
                self._gyro.add(sample)
                self._repeat_from(index)
                return
        raise BadMessageError("too old", "its stamp is before the history")

    def _repeat_from(self, index: int, late: Collection[Measurement] = ()) -> None:
        """Compute the steps from ``index`` on again; only the ``late`` measurements are new to the monitor."""
        self.filter.memory = self._steps[index].memory
        for again in range(index, len(self._steps)):
            step = self._steps[again]
            step.memory = self.filter.memory
            self._propagate(step, late, is_new=False)

    def _propagate(self, step: _Step, late: Collection[Measurement] = (), *, is_new: bool = True) -> None:
        """Compute a step; if it is not new, only the ``late`` measurements are new to the monitor."""
        odometry, now = step.odometry, step.start
        rate, slip = self._take_rate(step, is_new=is_new)
        for measurement in step.measurements:
            if measurement.stamp > now:
                self._predict(step, (measurement.stamp - now) * S_PER_NS, rate, slip)
                now = measurement.stamp
            self._update(measurement, is_new or measurement in late)
        if odometry.stamp > now:
            self._predict(step, (odometry.stamp - now) * S_PER_NS, rate, slip)

    def _take_rate(self, step: _Step, *, is_new: bool) -> tuple[TurnRate, TwistCovariance]:
        """Return what the gyro measured in a step, and the covariance that its contradiction adds to the twist's.

        The difference from the wheels corrects the bias of the gyro and the errors of the wheels.
        """
        self._rate = rate = self._gyro.mean(step.start, step.odometry.stamp)
        if rate is NO_RATE:
            self._share = _NO_SHARE
            return rate, _NO_SLIP
        duration = (step.odometry.stamp - step.start) * S_PER_NS
        covariance, separation = self._noise(step, duration)[0], self.filter.wheel_separation
        measured = GyroRate(step.odometry.stamp, rate, step.odometry.twist, covariance, separation)
        difference = self.filter.take_rate(measured, duration)
        if is_new:
            self.slipping = 0.0 if difference is None else self.slipping + duration
            self.slips += difference is not None
        slip = _NO_SLIP if difference is None else slip_covariance(difference, separation)
        self._share = gyro_share(add_twist_covariance(covariance, slip), rate)
        return rate, slip

    def _predict(self, step: _Step, dt: float, rate: TurnRate, slip: TwistCovariance) -> None:
        """Move by ``dt`` [s] of a step, of whose duration ``rate`` and ``slip`` are."""
        covariance, lateral = self._noise(step, dt)
        share = (step.odometry.stamp - step.start) * S_PER_NS / dt
        if slip is not _NO_SLIP:
            covariance = add_twist_covariance(covariance, scale_twist_covariance(slip, share))
        rate = TurnRate(rate.value, rate.variance * share)
        self.filter.predict(Motion(step.odometry.twist, dt, covariance, rate), lateral)

    def _noise(self, step: _Step, dt: float) -> tuple[TwistCovariance, float]:
        """Return the covariance of a step's mean twist over ``dt`` [s] of it, and the variance across the robot."""
        (_, twist, covariance), whole = step.odometry, step.whole * S_PER_NS
        if step.is_gap:
            # A part of the gap has its share of the variance; it is as large across the robot as along it.
            covariance = scale_twist_covariance(covariance, whole / dt)
            return covariance, covariance.var_v * dt * dt
        density = density_of(twist, covariance, self.config.odometry)
        if density is not None:
            return over_time(density, twist.v, dt)
        # The twist's error is constant over the interval: the variances of its parts must add up to the whole.
        factor = self.config.odometry.odometry_covariance_scale * (whole / dt)
        return scale_twist_covariance(covariance, factor) if factor != 1.0 else covariance, 0.0

    def _update(self, measurement: Measurement, new: bool = True) -> None:
        outcome = self.filter.take(measurement)
        if new:
            stamp, source, numbers = key_of(measurement)
            self.monitor.record(source, self.filter.nis, outcome, self.filter.innovation, stamp)
            if outcome == RELOCATED:
                self.contradiction = contradiction.with_relocation(self.contradiction, stamp)
            if source.sensor == FIXES:
                self.contradiction = contradiction.with_fix(self.contradiction, stamp, numbers)

    def _trim(self) -> None:
        steps, keys = self._steps, self._keys
        oldest = steps[-1].odometry.stamp - self._history
        while steps[0].odometry.stamp < oldest:
            steps.popleft()
        self._gyro.forget_until(steps[0].start)
        # Keys are in order of arrival: a late one is kept a little longer than necessary. One far ahead blocks this
        # loop, and _MAX_KEYS bounds their number.
        while keys and next(iter(keys))[0] < oldest:
            keys.popitem(last=False)
