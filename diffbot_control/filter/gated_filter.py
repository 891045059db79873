"""The filter with its gate, its way back and its adaptation, on filterpy's EKF.

Its memory is one value, :attr:`GatedFilter.memory`, that never changes: whoever keeps an old one can go back to it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from diffbot_control.filter.adaptation import Adaptation, adapted, new_adaptation, q_scale, r_scales, rescaled
from diffbot_control.filter.ekf import Array, CalibratingEkf, Motion, PoseEkf
from diffbot_control.filter.gate import (
    ACCEPTED,
    IGNORED,
    REJECTED,
    RELOCATED,
    Doubt,
    FixGate,
    despaired,
    doubted,
    doubting,
    judged,
    passed,
)
from diffbot_control.filter.measurements import Measurement
from diffbot_control.filter.options import LOST_THETA, LOST_XY, FilterOptions
from diffbot_core.geometry import Pose, wrap_angle

_NO_REJECTION = FixGate()
_LOST_P = np.diag((LOST_XY, LOST_XY, LOST_THETA))


class Belief(NamedTuple):
    """Mean (n,) and covariance (n, n) of x, y, theta [m, m, rad] and, where they are states, the wheels' errors."""

    x: Array
    P: Array


class Memory(NamedTuple):
    """All that the filter remembers."""

    belief: Belief
    candidate: Belief | None
    """of the rejected fixes in ``gate``"""
    gate: FixGate
    doubt: Doubt
    adaptation: Adaptation


class GatedFilter:
    """One of the filters of FILTERS; make it, call :meth:`start`, then :meth:`predict` and :meth:`take`."""

    def __init__(self, options: FilterOptions, wheel_separation: float) -> None:
        """Choose the filter; ``wheel_separation`` is L [m]."""
        self.calibrating = options.radius_variance > 0.0
        self._filter: PoseEkf = CalibratingEkf() if self.calibrating else PoseEkf()
        self.configure(options, wheel_separation)
        self.forget()

    def configure(self, options: FilterOptions, wheel_separation: float) -> None:
        """Take over changed options; the number of states stays."""
        self.options = options
        if isinstance(self._filter, CalibratingEkf):
            self._filter.wheel_separation = wheel_separation
            self._filter.walk = options.radius_walk

    def forget(self) -> None:
        """Know nothing, also of the wheels; :meth:`start` has to be called next."""
        states = 5 if self.calibrating else 3
        P = np.zeros((states, states))
        P[3:, 3:] = self.options.radius_variance * np.eye(states - 3)
        self.memory = Memory(Belief(np.zeros(states), P), None, FixGate(), Doubt(), new_adaptation())
        self.nis = math.nan
        """normalised innovation squared of the newest measurement"""

    def start(self, pose: Pose, P: Array) -> None:
        """Begin at a pose of covariance ``P`` (3, 3); what is known of wheels and noise stays."""
        belief = self._started(np.array(pose), P)
        self.memory = self.memory._replace(belief=belief, candidate=None, gate=FixGate(), doubt=Doubt())

    def wheels(self) -> tuple[Array, Array] | None:
        """Return the relative radius errors (2,), left first, and their covariance; None if they are no states."""
        if not self.calibrating:
            return None
        x, P = self.memory.belief
        return x[3:], P[3:, 3:]

    def set_wheels(self, errors: Array, P: Array) -> None:
        """Set what is known of the wheels: relative radius errors (2,) and their covariance (2, 2)."""
        if self.calibrating:
            x, whole = self.memory.belief.x.copy(), self.memory.belief.P.copy()
            x[3:], whole[3:, 3:] = errors, P
            whole[3:, :3] = whole[:3, 3:] = 0.0
            self.memory = self.memory._replace(belief=Belief(x, whole))

    def predict(self, motion: Motion) -> None:
        """Move on."""
        memory = self.memory
        if self.options.adaptive:
            v, omega, dt, var_v, cov, var_omega = motion
            q = q_scale(memory.adaptation)
            motion = Motion(v, omega, dt, q * var_v, q * cov, q * var_omega)
        belief = self._moved(memory.belief, motion)
        if memory.candidate is None and not memory.doubt.rejected:
            self.memory = Memory(belief, None, memory.gate, memory.doubt, memory.adaptation)
            return
        candidate = None if memory.candidate is None else self._moved(memory.candidate, motion)
        gate, doubt = passed(memory.gate, motion.dt), doubted(memory.doubt, motion.dt)
        self.memory = Memory(belief, candidate, gate, doubt, memory.adaptation)

    def take(self, measurement: Measurement) -> int:
        """Fuse a measurement, or do not.

        Returns:
            ACCEPTED, REJECTED or RELOCATED, see :mod:`gating`; IGNORED of a landmark at which the robot stands.
        """
        return self._take_fix(measurement) if measurement.z.size == 3 else self._take_other(measurement)

    def _take_fix(self, fix: Measurement) -> int:
        memory, options, R = self.memory, self.options, fix.R
        if options.adaptive:
            R = _scaled_noise(R, memory.adaptation)
        bound = options.gates[2] if memory.gate.slack == 0.0 else math.exp(memory.gate.slack) * options.gates[2]
        belief, self.nis = self._corrected(memory.belief, fix, R)
        expected = 0.0 <= self.nis <= bound
        adaptation = memory.adaptation
        if expected and not options.adaptive and memory.gate == _NO_REJECTION and not memory.doubt.rejected:
            # Nearly all fixes: nothing to remember but the belief.
            self.memory = Memory(belief, None, memory.gate, memory.doubt, adaptation)
            return ACCEPTED
        if options.adaptive and not math.isnan(self.nis):
            # Of the whole vector's S only the diagonal: each number by its own deviation.
            y, S = self._filter.y.tolist(), self._filter.S.diagonal().tolist()
            if min(S) > 0.0:
                shares = [one / math.sqrt(variance) for one, variance in zip(y, S, strict=True)]
                adaptation = adapted(adaptation, shares[0], shares[1], shares[2], expected)
        candidate, agrees = memory.candidate, False
        if not expected:
            renewed = self._started(fix.z, R)
            if candidate is not None:
                other, nis = self._corrected(candidate, fix, R)
                agrees = 0.0 <= nis <= bound
                candidate = other if agrees else renewed
            else:
                candidate = renewed
        gate, verdict = judged(memory.gate, expected, agrees, options)
        if verdict == REJECTED:
            belief = memory.belief
        elif verdict == RELOCATED and candidate is not None:
            belief = candidate
        if verdict != REJECTED:
            candidate = None
        if options.adaptive:
            factor = rescaled(memory.adaptation, adaptation)
            belief = _scaled(belief, factor)
            candidate = None if candidate is None else _scaled(candidate, factor)
        doubt = memory.doubt if verdict == REJECTED or not memory.doubt.rejected else Doubt()
        self.memory = Memory(belief, candidate, gate, doubt, adaptation)
        return verdict

    def _take_other(self, measurement: Measurement) -> int:
        memory = self.memory
        belief, self.nis = self._corrected(memory.belief, measurement, measurement.R)
        if self.nis == math.inf:
            return IGNORED
        if 0.0 <= self.nis <= self.options.gates[measurement.z.size - 1]:
            self.memory = memory._replace(belief=belief, doubt=Doubt())
            return ACCEPTED
        doubt = doubting(memory.doubt)
        if not despaired(doubt, self.options):
            self.memory = memory._replace(doubt=doubt)
            return REJECTED
        x, P = memory.belief
        P = P.copy()
        P[:3, :] = P[:, :3] = 0.0
        P[:3, :3] = _LOST_P
        belief, _ = self._corrected(Belief(x, P), measurement, measurement.R)
        self.memory = memory._replace(belief=belief, doubt=Doubt())
        return RELOCATED

    def _moved(self, belief: Belief, motion: Motion) -> Belief:
        ekf = self._filter
        ekf.x, ekf.P = belief
        ekf.predict(motion)
        return Belief(ekf.x, ekf.P)

    def _corrected(self, belief: Belief, measurement: Measurement, R: Array) -> tuple[Belief, float]:
        """Return the belief as if the measurement was accepted, and the NIS."""
        ekf, z = self._filter, measurement.z
        ekf.x, ekf.P = belief
        try:
            if measurement.landmark is not None:
                nis = ekf.update_landmark(z, R, measurement.landmark)
            elif z.size == 3:
                nis = ekf.update_pose(z, R)
            else:
                nis = ekf.update_heading(z, R)
        except (np.linalg.LinAlgError, ValueError):
            return belief, math.nan  # S is singular to working precision or not finite: not to be believed
        return self._checked(Belief(ekf.x, ekf.P)), nis

    def _checked(self, belief: Belief) -> Belief:
        """Forget what is known of the wheels if it is not possible."""
        if not self.calibrating:
            return belief
        most = self.options.radius_most
        if abs(belief.x.item(3)) <= most and abs(belief.x.item(4)) <= most:
            return belief
        x, P = belief.x.copy(), belief.P.copy()
        x[3:] = 0.0
        P[3:, :] = P[:, 3:] = 0.0
        P[3, 3] = P[4, 4] = self.options.radius_variance
        return Belief(x, P)

    def _started(self, z: Array, R: Array) -> Belief:
        """Return the belief of one who knows the wheels and nothing else but a fix."""
        x, P = self.memory.belief.x.copy(), self.memory.belief.P.copy()
        x[:3] = z[0], z[1], wrap_angle(z.item(2))
        P[:3, :] = P[:, :3] = 0.0
        P[:3, :3] = R
        return Belief(x, P)


def _scaled(belief: Belief, factor: float) -> Belief:
    """Multiply the pose's part of P; what is known of the wheels stays."""
    if factor == 1.0:
        return belief
    P = belief.P.copy()
    P[:3, :] *= math.sqrt(factor)
    P[:, :3] *= math.sqrt(factor)
    return Belief(belief.x, P)


def _scaled_noise(R: Array, adaptation: Adaptation) -> Array:
    position, heading = r_scales(adaptation)
    factors = np.array((math.sqrt(position), math.sqrt(position), math.sqrt(heading)))
    scaled: Array = R * np.outer(factors, factors)
    return scaled
