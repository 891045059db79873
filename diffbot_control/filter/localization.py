"""Fusing odometry, fixes, headings and landmarks in the order of their stamps, whenever they arrive.

The filter's time is the stamp of the newest odometry. A measurement with a later stamp waits for its odometry; one with
an earlier stamp is put where it belongs and what came after is computed again, from a bounded history.
"""

from __future__ import annotations

import math
from bisect import insort
from collections import OrderedDict, deque
from typing import Annotated, Any, NamedTuple

from diffbot_control.filter.ekf import Array, Motion
from diffbot_control.filter.gated_filter import Belief, GatedFilter, Memory
from diffbot_control.filter.innovation_monitor import Consistency
from diffbot_control.filter.measurements import Measurement, OdometryStep
from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import WheelGeometry
from diffbot_core.schema import Spec
from diffbot_core.units import S_PER_NS

_PENDING_MOST = 1000
"""Measurements that may wait for their odometry; more means that none comes."""
_LONGEST_GAP = 1000 * 10**9
"""[ns] between two odometries; no mean twist says what happened in more."""
_KNOWN_MOST = 10_000
"""Measurements remembered to refuse those that are sent again."""


class LocalizationConfig(NamedTuple):
    """Options of the fusion."""

    history_length: Annotated[float, Spec("how late a measurement may come", "s", minimum=0.0, maximum=60.0)] = 1.0
    filter: FilterConfig = FilterConfig()


class Estimate(NamedTuple):
    """What the filter knows at one time."""

    stamp: int
    """[ns]"""
    pose: Pose
    P: Array
    """(3, 3) covariance of x, y, theta [m, m, rad]"""
    odometry: OdometryStep | None
    """the newest input, None before the first"""
    belief: Belief
    """of all states, the wheels' errors included where they are some"""


class _Step:
    """One odometry step of the history with the filter's memory before it, so that it can be done again."""

    __slots__ = ("measurements", "memory", "odometry", "start")

    def __init__(self, start: int, odometry: OdometryStep, memory: Memory, measurements: list[Measurement]) -> None:
        self.start = start
        self.odometry = odometry
        self.memory = memory
        self.measurements = measurements


_RANKS = {3: 0, 1: 1, 2: 2}


def _order(measurement: Measurement) -> tuple[Any, ...]:
    # Equal stamps: fixes, headings, landmarks by their place, then by value: whatever the order of arrival.
    rank, place = _RANKS[measurement.z.size], measurement.landmark or ()
    return measurement.stamp, rank, place, *measurement.z.tolist()


def _identity(measurement: Measurement) -> tuple[float, ...]:
    return (measurement.stamp, *measurement.z.tolist(), *(measurement.landmark or ()))


def _split(measurements: list[Measurement], stamp: int) -> tuple[list[Measurement], list[Measurement]]:
    """Part ordered measurements into those up to ``stamp`` [ns] and those after it."""
    if not measurements or measurements[-1].stamp <= stamp:
        return measurements, []
    ready = [one for one in measurements if one.stamp <= stamp]
    return ready, measurements[len(ready) :]


class Localization:
    """A filter with a sense of time; it starts with the first fix, or by :meth:`initialise`."""

    def __init__(self, config: LocalizationConfig, wheel_separation: float = WheelGeometry().wheel_separation) -> None:
        """Start unknown: :attr:`initialised` is False until a pose comes; ``wheel_separation`` is L [m]."""
        self.config = config
        self._history = round(config.history_length / S_PER_NS)
        self.estimator = GatedFilter(options_of(config.filter), wheel_separation)
        self.consistency = Consistency()
        self.waited_in_vain = 0
        """measurements dropped because they came before the first odometry"""
        self.initialised = False
        self._stamp: int | None = None
        self._odometry: OdometryStep | None = None
        self._steps: deque[_Step] = deque()
        self._pending: list[Measurement] = []
        self._known: OrderedDict[tuple[float, ...], None] = OrderedDict()

    def configure(self, config: LocalizationConfig, wheel_separation: float) -> None:
        """Take over changed options from the next message on; the variant of the filter stays."""
        self._history = round(config.history_length / S_PER_NS)
        self.config = config._replace(filter=config.filter._replace(filter=self.config.filter.filter))
        self.estimator.configure(options_of(self.config.filter), wheel_separation)

    def reset(self) -> None:
        """Forget everything; the next fix starts anew."""
        self.estimator.forget()
        self.consistency.clear()
        self.initialised = False
        self._stamp = None
        self._odometry = None
        self._steps.clear()
        self._pending.clear()
        self._known.clear()

    def initialise(self, pose: Pose, P: Array, stamp: int | None = None) -> None:
        """Put the filter at ``pose`` with covariance ``P`` (3, 3).

        What is known of the wheels stays. It keeps its present time; if it has none yet, that is ``stamp`` [ns], or
        the first odometry's.
        """
        self.estimator.start(pose, P)
        self.consistency.clear()
        self._steps.clear()
        for waiting in self._pending:
            self._forget(waiting)
        self._pending.clear()
        if self._stamp is None:
            self._stamp = stamp
        self.initialised = True

    def estimate(self) -> Estimate:
        """Return the present state.

        Raises:
            BadMessageError: if nothing is known yet.
        """
        if not self.initialised or self._stamp is None:
            raise BadMessageError("no fix yet")
        belief = self.estimator.memory.belief
        pose = Pose(*belief.x.tolist()[:3])
        return Estimate(self._stamp, pose, belief.P[:3, :3], self._odometry, belief)

    def on_odometry(self, odometry: OdometryStep) -> Estimate:
        """Move on to the stamp of ``odometry`` and fuse what waited for it.

        An odometry with the stamp of the last one (sent again) is answered without moving.

        Raises:
            BadMessageError: before the first fix; out of order; or if time jumped back by more than the history, or
                ahead by more than 1000 s, which resets the filter.
        """
        if not self.initialised:
            raise BadMessageError("no fix yet")
        if self._stamp is None:
            self._stamp = odometry.stamp
            self._drop_what_waits_since_before(odometry.stamp)
        late = self._stamp - odometry.stamp
        if late > self._history:
            self.reset()
            raise BadMessageError("time jumped back", f"by {late * S_PER_NS:.3f} s; filter reset")
        if late < -_LONGEST_GAP:
            self.reset()
            raise BadMessageError("time jumped ahead", f"by {-late * S_PER_NS:.3f} s; filter reset")
        if late > 0:
            raise BadMessageError("out of order", f"{late * S_PER_NS:.3f} s behind the newest")
        if late < 0:
            ready, self._pending = _split(self._pending, odometry.stamp)
            step = _Step(self._stamp, odometry, self.estimator.memory, ready)
            self._steps.append(step)
            self._propagate(step, None)
            self._stamp = odometry.stamp
            self._odometry = odometry
            self._trim()
        return self.estimate()

    def _drop_what_waits_since_before(self, stamp: int) -> None:
        while self._pending and self._pending[0].stamp < stamp:
            self._forget(self._pending.pop(0))
            self.waited_in_vain += 1

    def on_measurement(self, measurement: Measurement) -> None:
        """Fuse a fix, a heading or a landmark at its own stamp.

        Raises:
            BadMessageError: if it came before (stamp and values the same), if it is not finite, if it is older than the
                history, if too many with earlier stamps wait for their odometry already, or if a heading or landmark
                comes before the first fix.
        """
        key = _identity(measurement)
        if key in self._known:
            raise BadMessageError("duplicate")
        if not math.isfinite(sum(key)):
            raise BadMessageError("measurement not finite")
        self._take(measurement)
        self._known[key] = None
        if len(self._known) > _KNOWN_MOST:
            self._known.popitem(last=False)

    def _take(self, measurement: Measurement) -> None:
        if not self.initialised:
            if measurement.z.size != 3:
                raise BadMessageError("no fix yet")
            x, y, theta = measurement.z.tolist()
            self.initialise(Pose(x, y, theta), measurement.R, measurement.stamp)
        elif self._stamp is None or measurement.stamp > self._stamp:
            self._wait(measurement)
        elif measurement.stamp == self._stamp and not self._steps:
            self._update(measurement)
        else:
            # Also one of the present stamp: there may be others of that stamp which belong behind it.
            self._insert_late(measurement)

    def _wait(self, measurement: Measurement) -> None:
        if len(self._pending) >= _PENDING_MOST:
            if measurement.stamp >= self._pending[-1].stamp:
                raise BadMessageError("no odometry for it", f"{_PENDING_MOST} measurements wait already")
            # The one furthest ahead gives way: a sender with a wrong clock must not shut the others out.
            self._forget(self._pending.pop())
        if self._pending:
            insort(self._pending, measurement, key=_order)
        else:
            self._pending.append(measurement)

    def _forget(self, dropped: Measurement) -> None:
        """Let a measurement that was never fused come again."""
        self._known.pop(_identity(dropped), None)

    def _insert_late(self, measurement: Measurement) -> None:
        for index in range(len(self._steps) - 1, -1, -1):
            step = self._steps[index]
            # What is stamped like the start of the history belongs to the state that it starts from.
            covered = step.start < measurement.stamp or (index == 0 and step.start == measurement.stamp)
            if covered and measurement.stamp <= step.odometry.stamp:
                insort(step.measurements, measurement, key=_order)
                self.estimator.memory = step.memory
                for again in range(index, len(self._steps)):
                    step = self._steps[again]
                    step.memory = self.estimator.memory
                    self._propagate(step, measurement)
                return
        raise BadMessageError("too old", "its stamp is before the history")

    def _propagate(self, step: _Step, late: Measurement | None) -> None:
        """Do a step; again if a ``late`` measurement came, and then only that one is new to the record."""
        whole = (step.odometry.stamp - step.start) * S_PER_NS
        now = step.start
        for measurement in step.measurements:
            if measurement.stamp > now:
                self._predict(step.odometry, (measurement.stamp - now) * S_PER_NS, whole)
                now = measurement.stamp
            self._update(measurement, late is None or measurement is late)
        if step.odometry.stamp > now:
            self._predict(step.odometry, (step.odometry.stamp - now) * S_PER_NS, whole)

    def _predict(self, odometry: OdometryStep, dt: float, whole: float) -> None:
        # The error of the twist belongs to the whole interval: in parts of it the variances have to add up to that.
        share = whole / dt
        _, (v, omega), var_v, cov, var_omega = odometry
        self.estimator.predict(Motion(v, omega, dt, var_v * share, cov * share, var_omega * share))

    def _update(self, measurement: Measurement, new: bool = True) -> None:
        verdict = self.estimator.take(measurement)
        if new:
            self.consistency.note(measurement.z.size, self.estimator.nis, verdict)

    def _trim(self) -> None:
        steps, known = self._steps, self._known
        oldest = steps[-1].odometry.stamp - self._history
        while steps[0].odometry.stamp < oldest:
            steps.popleft()
        # In the order of arrival; one that came late stays a little longer than it need, and one with a stamp far ahead
        # does not keep all that come after it.
        while known and (key := next(iter(known)))[0] < oldest:
            del known[key]
