"""The filter with its gate, its relocation and its adaptation, on filterpy's EKF.

Its memory is one immutable value, :attr:`GatedFilter.memory`: assigning an older one restores that state.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from diffbot_control.filter.adaptation import (
    Adaptation,
    Normalised,
    adapt,
    inflation,
    new_adaptation,
    q_scale,
    r_scales,
)
from diffbot_control.filter.ekf import CalibratingEkf, PoseEkf
from diffbot_control.filter.gate import (
    ACCEPTED,
    FIX,
    HEADING,
    LANDMARK,
    RELOCATED,
    RESET_VAR_THETA,
    RESET_VAR_XY,
    GateMemory,
    age,
    decide,
    is_expected,
    new_gate,
)
from diffbot_control.filter.measurements import Array, Heading, LandmarkMeasurement, Measurement, PoseFix
from diffbot_control.filter.models import Motion
from diffbot_control.filter.options import FilterOptions
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import scale_twist_covariance

_RESET_P = np.diag((RESET_VAR_XY, RESET_VAR_XY, RESET_VAR_THETA))


class Belief(NamedTuple):
    """Mean (n,) and covariance (n, n) of x, y, theta [m, m, rad] and, where they are states, of the radius errors."""

    x: Array
    P: Array


class Memory(NamedTuple):
    """State of the filter."""

    belief: Belief
    candidate: Belief | None
    """hypothesis of the rejected fixes; None if there are none"""
    gate: GateMemory
    adaptation: Adaptation


class WheelEstimate(NamedTuple):
    """Estimated relative radius errors."""

    errors: Array
    """(2,) left, right"""
    P: Array
    """(2, 2)"""


class GatedFilter:
    """One of the filters of FILTERS; make it, call :meth:`reset_to`, then :meth:`predict` and :meth:`take`."""

    def __init__(self, options: FilterOptions, wheel_separation: float) -> None:
        """Choose the filter; ``wheel_separation`` is L [m]."""
        self.calibrating = options.radius_variance > 0.0
        self._ekf: PoseEkf = CalibratingEkf() if self.calibrating else PoseEkf()
        self.configure(options, wheel_separation)
        self.reset()

    def configure(self, options: FilterOptions, wheel_separation: float) -> None:
        """Apply changed options; the number of states stays."""
        self.options = options
        if isinstance(self._ekf, CalibratingEkf):
            self._ekf.wheel_separation = wheel_separation
            self._ekf.random_walk = options.radius_random_walk

    def reset(self) -> None:
        """Reset pose, radius errors and adaptation to unknown; :meth:`reset_to` has to be called next."""
        states = 5 if self.calibrating else 3
        P = np.zeros((states, states))
        P[3:, 3:] = self.options.radius_variance * np.eye(states - 3)
        self.memory = Memory(Belief(np.zeros(states), P), None, new_gate(), new_adaptation())
        self.nis = math.nan
        """normalised innovation squared of the newest measurement"""
        self.innovation: tuple[Array, Array] = (np.zeros(0), np.zeros((0, 0)))
        """its innovation (m,) and the covariance S (m, m); valid if the NIS is finite"""

    def reset_to(self, pose: Pose, P: Array) -> None:
        """Put the filter at a pose with covariance ``P`` (3, 3); radius errors and adaptation stay."""
        belief = _with_pose(self.memory.belief, pose, P)
        self.memory = Memory(belief, None, new_gate(), self.memory.adaptation)

    def wheels(self) -> WheelEstimate | None:
        """Return the estimated radius errors; None if they are not states."""
        if not self.calibrating:
            return None
        x, P = self.memory.belief
        return WheelEstimate(x[3:], P[3:, 3:])

    def set_wheels(self, wheels: WheelEstimate) -> None:
        """Set the radius errors, uncorrelated with the pose; does nothing if they are not states."""
        if self.calibrating:
            x, P = self.memory.belief.x.copy(), self.memory.belief.P.copy()
            x[3:], P[3:, 3:] = wheels
            P[3:, :3] = P[:3, 3:] = 0.0
            self.memory = self.memory._replace(belief=Belief(x, P))

    def predict(self, motion: Motion) -> None:
        """Move estimate and candidate."""
        belief, candidate, gate, adaptation = self.memory
        if self.options.adaptive:
            twist, dt, covariance = motion
            motion = Motion(twist, dt, scale_twist_covariance(covariance, q_scale(adaptation)))
        belief = self._moved(belief, motion)
        if candidate is not None:
            candidate = self._moved(candidate, motion)
        self.memory = Memory(belief, candidate, age(gate, motion.dt), adaptation)

    def take(self, measurement: Measurement) -> int:
        """Correct with a measurement as the gate decides.

        Returns:
            ACCEPTED, REJECTED, RELOCATED or IGNORED, see :class:`gate.Decision`.
        """
        if isinstance(measurement, PoseFix):
            return self._take_fix(measurement)
        return self._take_other(measurement)

    def _take_fix(self, fix: PoseFix) -> int:
        before, candidate, gate, old = self.memory
        adaptation, options, adaptive = old, self.options, self.options.adaptive
        if adaptive:
            fix = PoseFix(fix.stamp, fix.pose, _scaled_noise(fix.R, old))
        belief, self.nis = self._corrected(before, fix)
        self.innovation = self._ekf.y, self._ekf.S
        innovation = self._normalised_innovation() if adaptive else None
        other, candidate_nis = None, math.nan
        if candidate is not None and not is_expected(gate, self.nis, FIX, options):
            other, candidate_nis = self._corrected(candidate, fix)
        gate, decision = decide(gate, self.nis, candidate_nis, FIX, options)
        if innovation is not None:
            adaptation = adapt(old, innovation, decision.outcome == ACCEPTED)
        if decision.outcome == ACCEPTED:
            candidate = None
        else:
            candidate = other if decision.agrees else _with_pose(before, fix.pose, fix.R)
            belief = before
            if decision.outcome == RELOCATED and candidate is not None:
                belief, candidate = candidate, None
        if adaptive:
            factor = inflation(old, adaptation)
            belief = _inflate(belief, factor)
            candidate = None if candidate is None else _inflate(candidate, factor)
        self.memory = Memory(belief, candidate, gate, adaptation)
        return decision.outcome

    def _normalised_innovation(self) -> Normalised | None:
        """Innovation of the newest fix; None if it could not be computed."""
        if math.isnan(self.nis):
            return None
        # Of S only the diagonal: each number by its own deviation.
        S = self._ekf.S.diagonal().tolist()
        if min(S) <= 0.0:
            return None
        x, y, theta = self._ekf.y.tolist()
        return Normalised(x / math.sqrt(S[0]), y / math.sqrt(S[1]), theta / math.sqrt(S[2]))

    def _take_other(self, measurement: Heading | LandmarkMeasurement) -> int:
        before, candidate, gate, adaptation = self.memory
        kind = HEADING if isinstance(measurement, Heading) else LANDMARK
        belief, self.nis = self._corrected(before, measurement)
        self.innovation = self._ekf.y, self._ekf.S
        gate, decision = decide(gate, self.nis, math.nan, kind, self.options)
        if decision.outcome == RELOCATED:
            x, y, theta = before.x.tolist()[:3]
            belief, _ = self._corrected(_with_pose(before, Pose(x, y, theta), _RESET_P), measurement)
        elif decision.outcome != ACCEPTED:
            belief = before
        self.memory = Memory(belief, candidate, gate, adaptation)
        return decision.outcome

    def _moved(self, belief: Belief, motion: Motion) -> Belief:
        ekf = self._ekf
        ekf.x, ekf.P = belief
        ekf.predict(motion)
        return Belief(ekf.x, ekf.P)

    def _corrected(self, belief: Belief, measurement: Measurement) -> tuple[Belief, float]:
        """Return the belief after the measurement, and its NIS; nan if it cannot be computed."""
        ekf = self._ekf
        ekf.x, ekf.P = belief
        try:
            if isinstance(measurement, PoseFix):
                nis = ekf.update_pose(measurement.pose, measurement.R)
            elif isinstance(measurement, Heading):
                nis = ekf.update_heading(measurement.theta, measurement.R)
            else:
                _, distance, bearing, R, landmark = measurement
                nis = ekf.update_landmark(distance, bearing, R, landmark)
        except np.linalg.LinAlgError:
            return belief, math.nan  # S is singular to working precision
        if math.isnan(nis):
            return belief, math.nan
        return self._with_possible_radii(Belief(ekf.x, ekf.P)), nis

    def _with_possible_radii(self, belief: Belief) -> Belief:
        """Reset the radius errors if one is beyond its bound."""
        if not self.calibrating:
            return belief
        bound = self.options.max_radius_error
        if abs(belief.x.item(3)) <= bound and abs(belief.x.item(4)) <= bound:
            return belief
        x, P = belief.x.copy(), belief.P.copy()
        x[3:] = 0.0
        P[3:, :] = P[:, 3:] = 0.0
        P[3, 3] = P[4, 4] = self.options.radius_variance
        return Belief(x, P)


def _with_pose(belief: Belief, pose: Pose, P: Array) -> Belief:
    """Replace the pose and its covariance (3, 3), uncorrelated with the radius errors, which stay."""
    x, whole = belief.x.copy(), belief.P.copy()
    x[:3] = pose.x, pose.y, wrap_angle(pose.theta)
    whole[:3, :] = whole[:, :3] = 0.0
    whole[:3, :3] = P
    return Belief(x, whole)


def _inflate(belief: Belief, factor: float) -> Belief:
    """Multiply the pose's part of P; the covariance of the radius errors stays."""
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
