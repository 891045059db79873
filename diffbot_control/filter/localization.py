"""Localization of a robot: fuses odometry, fixes, headings, landmarks and turn rates in the order of their stamps.

The time of the filter is the stamp of the newest odometry. A measurement with a later stamp waits until the odometry
reaches its stamp. A measurement with an earlier stamp is inserted into the :mod:`history`, and the steps from its stamp
on are computed again, once for all late measurements of a message.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from diffbot_control.filter import contradiction, ekf, state
from diffbot_control.filter.config import LocalizationConfig, options_of, sources_of
from diffbot_control.filter.consistency import SourceConsistency, consistency_of
from diffbot_control.filter.history import History, HistoryStep
from diffbot_control.filter.measurement import FIXES, LANDMARKS, GyroSample, Measurement
from diffbot_control.filter.models import (
    NO_RATE,
    POSE_FIX,
    UNKNOWN_HEADING,
    Array,
    Motion,
    Reading,
    TurnRate,
    corrected_twist,
    covariance_with_rate,
    gyro_share,
    is_fix,
    slip_covariance,
)
from diffbot_control.filter.odometry import DelayLine, EarlyOdometry, OdometryStep, step_noise, unknown_motion
from diffbot_control.filter.odometry_check import MIN_RATE, MIN_SPEED, Agreement, with_rates
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import Twist, TwistCovariance, WheelGeometry, add_twist_covariance, scale_twist_covariance
from diffbot_core.stamps import NS_PER_S, S_PER_NS

_MAX_GAP = 1000 * NS_PER_S
"""[ns] Longest gap between two odometry messages; after a longer gap the filter is reset."""
_SET_BACK_COUNT, _SET_BACK_SPAN = 2, NS_PER_S // 10
"""If at least this many successive odometry messages are older than the newest message, and span at least this time
[ns], the clock of the odometry was set back. A single older message is out of order."""
_NO_SLIP = TwistCovariance(0.0, 0.0, 0.0)


class FilterEstimate(NamedTuple):
    """Estimate at one time, averaged over the hypotheses of :func:`ekf.average`."""

    stamp: int
    """[ns]"""
    pose: Pose
    P: Array
    """(3, 3) covariance of x, y, theta [m, m, rad]"""
    odometry: OdometryStep | None
    """newest odometry step; None before the first one"""
    x: Array
    """(n,) state, see :mod:`models`"""


class Localization:
    """Filter that fuses measurements in the order of their stamps, from the first fix or :meth:`initialise` on."""

    def __init__(
        self,
        config: LocalizationConfig,
        wheel_separation: float = WheelGeometry().wheel_separation,
        max_extrapolation: float = math.inf,
        *,
        landmarks: Sequence[Point] = (),
    ) -> None:
        """Create a filter with an unknown pose.

        Args:
            config: parameters of the fusion.
            wheel_separation: wheel separation L [m].
            max_extrapolation: longest time [s] before its stamp for which the twist of an odometry message describes
                the motion; see :meth:`on_odometry`.
            landmarks: positions of the landmarks on the map [m]; measurements of other landmarks are dropped.
        """
        self.config = config
        self.max_extrapolation = max_extrapolation
        self._sources = {name: row for row, name in enumerate(sources_of(config))}
        self._places = {point: len(self._sources) + index for index, point in enumerate(landmarks)}
        self.configure(config, wheel_separation)
        self.filter = state.new_filter(self.options, len(self._places))
        self.slips = 0
        """number of odometry steps whose turn rate the gyro contradicted"""
        self.dropped_before_odometry = 0
        """number of measurements that were dropped because their stamps are before the first odometry"""
        self.clock_set_back = 0
        """number of times that the clock of the odometry was set back"""
        self.time_restarts = True
        """True: a jump of time is the start of another simulation or bag, and resets the filter. False: a jump means
        that the clock was set, and the filter continues."""
        self.outcomes: dict[str, Counter[int]] = {FIXES: Counter()}
        """number of measurements of each source by their outcome, see :mod:`ekf`"""
        self._checked_fixes = 0
        self.reset()

    def configure(self, config: LocalizationConfig, wheel_separation: float) -> None:
        """Apply changed parameters from the next message on; the variant of the filter and the sources stay."""
        variant = self.config.filter.filter
        self.config = config._replace(filter=config.filter._replace(filter=variant))
        self.options = options_of(self.config, wheel_separation, tuple(self._places))
        self._history_length = round(config.history_length / S_PER_NS)

    def reset(self) -> None:
        """Reset the pose, all estimated errors and the history; the next fix initialises the filter."""
        state.reset(self.filter, self.options)
        self.initialised = False
        self.contradiction = contradiction.NONE
        """signs that the fixes contradict the odometry"""
        self.slipping = 0.0
        """[s] time for which the turn rates of wheels and gyro have disagreed without interruption"""
        self.turns = Agreement()
        """agreement of the turn rates of wheels and gyro"""
        self._early = EarlyOdometry()
        self._behind: list[OdometryStep] = []
        """successive odometry messages with stamps before the newest odometry"""
        self._stamp: int | None = None
        self._odometry: OdometryStep | None = None
        self._history = History()
        self._delayed = DelayLine()
        self._newest_motion: Motion | None = None

    def initialise(self, pose: Pose, P: Array, stamp: int | None = None) -> None:
        """Set the pose with covariance ``P`` (3, 3), and keep the estimated errors and the time of the filter.

        If the filter has no time yet, ``stamp`` [ns] becomes its time; without a stamp, the first odometry sets the
        time. A stamp that differs from the newest odometry by more than the history comes from another clock, so the
        stamp of the newest odometry replaces it.
        """
        newest = self._early.newest
        if stamp is not None and newest is not None and abs(stamp - newest) > self._history_length:
            stamp = newest
        state.start(self.filter, pose, P)
        self.contradiction = contradiction.NONE
        self._history.clear()
        self._stamp = stamp if self._stamp is None else self._stamp
        self.initialised = True

    def estimate(self) -> FilterEstimate:
        """Return the estimate at the time of the filter.

        Raises:
            BadMessageError: before the first fix or odometry.
        """
        if not self.initialised or self._stamp is None:
            raise BadMessageError("no fix yet")
        x, P = ekf.average(self.filter, self.options)
        return FilterEstimate(self._stamp, Pose(*x[:3].tolist()), P[:3, :3], self._odometry, x)

    def twist_of(self, estimate: FilterEstimate, odometry: OdometryStep) -> tuple[Twist, TwistCovariance]:
        """Return the twist of an estimate: the odometry, corrected by the gyro and by the estimated wheel errors.

        Args:
            estimate: newest estimate.
            odometry: odometry to use if the estimate has none.

        Returns:
            The twist and its covariance; an all-zero (unknown) covariance does not change.
        """
        _, twist, covariance = estimate.odometry or odometry
        motion, newest = Motion(twist, 0.0, covariance), self._newest_motion
        if newest is not None and newest.rate is not NO_RATE:
            motion = motion._replace(covariance=newest.covariance, rate=newest.rate)
            covariance = covariance_with_rate(covariance, gyro_share(newest.covariance, newest.rate))
        return corrected_twist(estimate.x, motion, self.options.separation), covariance

    def consistency(self) -> dict[str, SourceConsistency]:
        """Return the statistics of the accepted innovations of each source that has any."""
        noise, times = self.filter.noise, self.options.times
        statistics = {name: consistency_of(noise[row], times[row]) for name, row in self._sources.items()}
        return {name: one for name, one in statistics.items() if one is not None}

    def check_innovations(self) -> None:
        """Detect fixes that contradict the odometry without relocating the filter; call this periodically."""
        # Without a new fix, as at rest, old innovations are not a new sign.
        before, self._checked_fixes = self._checked_fixes, self.outcomes[FIXES].total()
        fixes = self.consistency().get(FIXES) if self._checked_fixes != before else None
        if fixes is not None and fixes.autocorrelation is not None and self._stamp is not None:
            signs = self._stamp, fixes.nis / fixes.alarm, fixes.autocorrelation
            self.contradiction = contradiction.with_innovations(self.contradiction, *signs)

    def on_odometry(self, odometry: OdometryStep, valid_for: float = math.inf) -> FilterEstimate:
        """Predict the estimate at the stamp of ``odometry``, and fuse the measurements that waited for it.

        A message with the stamp of the previous message is a repetition and does not move the estimate. After a gap
        longer than ``max_extrapolation``, the twist moves the estimate only for the last ``max_extrapolation`` seconds.
        For the rest of the gap the estimate does not move. Its deviation grows by the distance that the faster of the
        twists before and after the gap would cover.

        If several successive messages are older than the newest odometry, the clock of the odometry was set back, and
        the filter continues with the new time. If the clock was set forward, the estimate becomes as uncertain as
        after a gap of at most ``max_extrapolation``.

        Args:
            odometry: mean twist since the previous odometry.
            valid_for: longest time [s] before its stamp for which the twist is valid. It is finite only if the clock of
                the odometry was set forward.

        Raises:
            BadMessageError: before the first fix; if the message is out of order; or if time jumped back by more than
                the history or ahead by more than 1000 s, which resets the filter.
        """
        if not self.initialised:
            self._early.add(odometry, self._history_length)
            raise BadMessageError("no fix yet")
        if self._stamp is None:
            self._stamp = odometry.stamp
            self.dropped_before_odometry += self._history.drop_waiting_before(odometry.stamp)
        late = self._stamp - odometry.stamp
        is_set_forward = valid_for < math.inf and not self.time_restarts
        if late >= 0 or (late < -_MAX_GAP and self._odometry is not None and not is_set_forward):
            self._check_time(late, odometry)
            return self.estimate()
        self._behind.clear()
        if is_set_forward and math.isfinite(longest := valid_for + self.max_extrapolation):
            # The true time since the previous odometry is at most about ``longest``.
            self._begin_clock(max(self._stamp, odometry.stamp - round(longest / S_PER_NS)))
        start = self._cross_gap(self._stamp, odometry, min(valid_for, self.max_extrapolation))
        for part, whole in self._delayed.parts(start, odometry, round(self.config.odometry.odometry_delay / S_PER_NS)):
            start = self._step(start, part, whole)
        self._history.trim(self._history_length)
        return self.estimate()

    def _cross_gap(self, start: int, after: OdometryStep, valid_for: float) -> int:
        """Predict from ``start`` [ns] to the end of the unknown motion before ``after``, and return this end [ns].

        The twist of ``after`` is valid for the last ``valid_for`` seconds before its stamp.
        """
        if after.stamp - start <= valid_for / S_PER_NS + 0.5:  # whole nanoseconds
            return start
        end = after.stamp - round(valid_for / S_PER_NS)
        before = self._odometry.twist if self._odometry is not None else after.twist
        self._delayed.clear()
        return self._step(start, unknown_motion(start, end, before, after.twist), end - start, is_gap=True)

    def _step(self, start: int, odometry: OdometryStep, whole: int, *, is_gap: bool = False) -> int:
        """Compute a new :class:`HistoryStep` with these fields, and return the stamp of its end [ns]."""
        step = HistoryStep(start, odometry, whole, is_gap, self.filter.memory.copy())
        self._history.append(step)
        self._compute(step)
        distance = abs(odometry.twist.v) * (odometry.stamp - start) * S_PER_NS
        before = self.contradiction.cause
        self.contradiction = contradiction.with_motion(self.contradiction, odometry.stamp, distance)
        if before and not self.contradiction.cause:
            state.unpair(self.filter)  # a new contradiction needs new innovations
        self._stamp, self._odometry = odometry.stamp, odometry
        return odometry.stamp

    def _check_time(self, late: int, odometry: OdometryStep) -> None:
        """Handle an odometry message that is repeated, out of order, or after a jump of time.

        ``late`` is the time [ns] from its stamp to the newest odometry; it is negative if the message is ahead.
        """
        if (late > self._history_length and (self.time_restarts or self._odometry is None)) or late < -_MAX_GAP:
            by, is_first = f"by {abs(late) * S_PER_NS:.3f} s", self._odometry is None
            self.reset()
            self._early.add(odometry, self._history_length)
            if is_first:
                raise BadMessageError("behind the first fix", f"{by}: synchronise the clocks that stamp both (chrony)")
            raise BadMessageError("time jumped back" if late > 0 else "time jumped ahead", f"{by}; filter reset")
        if late > 0 or self._behind:
            if self._behind and odometry.stamp <= self._behind[-1].stamp:
                self._behind.clear()
            self._behind.append(odometry)
            span = odometry.stamp - self._behind[0].stamp
            # Before the first step, the newest stamp is the stamp of the fix, and the odometry may still be behind it.
            if self._odometry is not None and len(self._behind) >= _SET_BACK_COUNT and span >= _SET_BACK_SPAN:
                self._follow_clock_back(self._behind)
            elif late > 0:
                raise BadMessageError("out of order", f"{late * S_PER_NS:.3f} s behind the newest message")

    def _begin_clock(self, stamp: int) -> None:
        """Set the time of the filter to ``stamp`` [ns] after the clock was set.

        Measurements with stamps of the old clock are dropped, since they have no order relative to the new clock.
        """
        self._history.clear()
        self._history.clear_gyro()
        self._delayed.clear()
        state.unpair(self.filter)
        self.contradiction = self.contradiction._replace(relocations=(), since=stamp)
        self._stamp = stamp

    def _follow_clock_back(self, messages: list[OdometryStep]) -> None:
        """Continue with ``messages``, the first odometry messages after the clock was set back."""
        period = (messages[-1].stamp - messages[0].stamp) // (len(messages) - 1)
        self._begin_clock(messages[0].stamp - period)
        self._behind = []
        self.clock_set_back += 1
        for odometry in messages:
            self.on_odometry(odometry)

    def on_measurement(self, measurement: Measurement) -> None:
        """Fuse one measurement, see :meth:`on_measurements`.

        Raises:
            BadMessageError: if the measurement is dropped.
        """
        for error in self.on_measurements((measurement,)):
            raise error

    def on_measurements(self, measurements: Iterable[Measurement]) -> list[BadMessageError]:
        """Fuse the measurements of a message, each at its own stamp; return an error for each dropped measurement.

        A measurement is dropped if it is a duplicate (same stamp, source and numbers), if it is not finite, if its
        source or landmark is unknown, if it is older than the history, if too many measurements already wait for their
        odometry, or if the filter is not initialised and the measurement cannot initialise it.
        """
        errors, late = list[BadMessageError](), dict[Measurement, int]()
        for measurement in measurements:
            try:
                if (index := self._insert(measurement)) is not None:
                    late[measurement] = index
            except BadMessageError as error:
                errors.append(error)
        if late:
            self._compute_from(min(late.values()), late)
        return errors

    def _insert(self, measurement: Measurement) -> int | None:
        """Fuse a measurement, or store it until its odometry arrives.

        Returns:
            The index of the first step that the caller has to compute again; None if no step changes.

        Raises:
            BadMessageError: if the measurement is dropped.
        """
        self._history.check_new(measurement)
        if not math.isfinite(sum(measurement.key[3])):
            raise BadMessageError("measurement not finite")
        if measurement.source not in self._sources:
            raise BadMessageError("unknown source", measurement.source)
        if measurement.source == LANDMARKS and measurement.at not in self._places:
            raise BadMessageError("landmark not on the map", f"at {tuple(measurement.at)}")
        index = None
        if not self.initialised:
            self._start_from(measurement)
        elif self._stamp is None or measurement.stamp > self._stamp:
            self._history.wait(measurement)
        elif measurement.stamp == self._stamp and not self._history.steps:
            self._take(measurement, is_new=True)
        else:
            # A measurement with the present stamp is also inserted, since the order of fusion is by source and numbers.
            index = self._history.insert(measurement, self._stamp)
        self._history.remember(measurement)
        return index

    def _start_from(self, measurement: Measurement) -> None:
        """Initialise the filter with the first fix; an unknown heading is set to 0."""
        if not is_fix(measurement.kind):
            raise BadMessageError("no fix yet")
        stamp, P_moved = self._early.start(measurement.stamp, self._history_length)
        P, m = np.diag((0.0, 0.0, UNKNOWN_HEADING)), len(measurement.z)
        P[:m, :m] = measurement.R
        x, y, *theta = measurement.z.tolist()
        self.initialise(Pose(x, y, theta[0] if measurement.kind == POSE_FIX else 0.0), P + P_moved, stamp)

    def on_gyro(self, sample: GyroSample) -> None:
        """Fuse a turn rate in the odometry step that covers its stamp, or store it until its odometry arrives.

        Raises:
            BadMessageError: before the first odometry; without use_gyro; if the sample is a duplicate, not finite or
                older than the history; or if too many samples already wait for their odometry.
        """
        if self._stamp is None or not self.initialised:
            raise BadMessageError("no odometry yet")
        if not self.config.filter.use_gyro:
            raise BadMessageError("not used", "use_gyro is false")
        if not math.isfinite(sample.rate + sample.variance):
            raise BadMessageError("measurement not finite")
        index = self._history.insert_gyro(sample, self._stamp)
        if index is not None:
            self._compute_from(index)

    def _compute_from(self, index: int, late: Collection[Measurement] = ()) -> None:
        """Compute the steps from ``index`` on again; only the ``late`` measurements are new and counted."""
        steps = self._history.steps
        self.filter.memory[:] = steps[index].memory
        for i in range(index, len(steps)):
            steps[i].memory = self.filter.memory.copy()
            self._compute(steps[i], late, is_new=False)

    def _compute(self, step: HistoryStep, late: Collection[Measurement] = (), *, is_new: bool = True) -> None:
        """Predict over a step and fuse its measurements; in an old step, only the ``late`` measurements are counted."""
        now, rate, slip = step.start, step.rate(), _NO_SLIP
        if rate is not NO_RATE:
            # In a gap the turn rate of the wheels is unknown.
            is_new_rate, step.is_compared = not (step.is_compared or step.is_gap), True
            slip = self._take_rate(self._motion(step, step.duration, rate, _NO_SLIP), is_new=is_new_rate)
        for measurement in step.measurements:
            if measurement.stamp > now:
                self._predict(step, (measurement.stamp - now) * S_PER_NS, rate, slip)
                now = measurement.stamp
            self._take(measurement, is_new=is_new or measurement in late)
        if step.odometry.stamp > now:
            self._predict(step, (step.odometry.stamp - now) * S_PER_NS, rate, slip)
        self._newest_motion = self._motion(step, step.duration, rate, slip)

    def _take_rate(self, motion: Motion, *, is_new: bool) -> TwistCovariance:
        """Correct with the turn rate of a step; return the covariance that slip adds to the twist."""
        difference = ekf.take_rate(self.filter, self.options, motion)
        if is_new:
            wheels, gyro = motion.twist.omega, motion.rate.value
            self.turns = with_rates(self.turns, motion.dt, wheels, gyro, MIN_RATE)
            if difference:
                self.slipping += motion.dt
            elif abs(motion.twist.v) >= MIN_SPEED or max(abs(wheels), abs(gyro)) >= MIN_RATE:
                # At rest both turn rates are 0, so a contradiction does not end there.
                self.slipping = 0.0
            self.slips += difference != 0.0
        return slip_covariance(difference, self.options.separation)

    def _predict(self, step: HistoryStep, dt: float, rate: TurnRate, slip: TwistCovariance) -> None:
        """Predict over ``dt`` [s] of a step; ``rate`` and ``slip`` are means over the whole step."""
        share = step.duration / dt
        part = TurnRate(rate.value, rate.variance * share)
        ekf.predict(self.filter, self.options, self._motion(step, dt, part, scale_twist_covariance(slip, share)))

    def _motion(self, step: HistoryStep, dt: float, rate: TurnRate, slip: TwistCovariance) -> Motion:
        """Return the motion over ``dt`` [s] of a step; ``slip`` is added to the covariance of its twist."""
        share = step.whole * S_PER_NS / dt
        covariance, lateral = step_noise(step.odometry, dt, share, self.config.odometry, is_gap=step.is_gap)
        return Motion(step.odometry.twist, dt, add_twist_covariance(covariance, slip), rate, lateral)

    def reading_of(self, measurement: Measurement) -> Reading:
        """Convert a measurement to a Reading for the functions of :mod:`ekf`."""
        source = self._sources[measurement.source]
        place = self._places[measurement.at] if measurement.source == LANDMARKS else source
        time, at = measurement.stamp * S_PER_NS, measurement.at
        return Reading(measurement.kind, source, place, time, measurement.z, measurement.R, at)

    def _take(self, measurement: Measurement, *, is_new: bool) -> int:
        """Correct with a measurement, and return the outcome; if it is new, count it and check for a contradiction."""
        outcome, stamp = ekf.take(self.filter, self.options, self.reading_of(measurement)), measurement.stamp
        if is_new:
            self.outcomes.setdefault(measurement.source, Counter())[outcome] += 1
            if outcome == ekf.RELOCATED:
                self.contradiction = contradiction.with_relocation(self.contradiction, stamp)
            if measurement.source == FIXES:
                self.contradiction = contradiction.with_fix(self.contradiction, stamp, measurement.key[3])
        return outcome
