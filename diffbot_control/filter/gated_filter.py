"""The filter with its gate, its relocation and its adaptation, on filterpy's EKF.

Its memory is one immutable value, :attr:`GatedFilter.memory`: assigning an older one restores that state.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

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
from diffbot_control.filter.averaging import average
from diffbot_control.filter.belief import (
    Belief,
    ErrorEstimate,
    inflate,
    pose_of,
    with_errors,
    with_pose,
    with_wider_radii,
)
from diffbot_control.filter.correlation import NO_STAMPS, Times, correlation_over, inflation_of, with_stamp
from diffbot_control.filter.ekf import PLAIN, PoseEkf, Robust
from diffbot_control.filter.fix_correlation import (
    STANDING,
    FixCorrelation,
    Variances,
    growth,
    shifted,
    travel,
    unpaired,
    with_fix,
)
from diffbot_control.filter.gate import (
    ACCEPTED,
    RELOCATED,
    RESET_VAR_THETA,
    RESET_VAR_XY,
    WEIGHED,
    age,
    decide_fix,
    decide_other,
    decide_weight,
    fix_bound,
    is_expected,
    new_gate,
)
from diffbot_control.filter.landmark_correlation import (
    LandmarkCorrelation,
    Seen,
    growth_of_landmarks,
    inflation_by,
    unseen,
    with_landmark,
    with_shift,
)
from diffbot_control.filter.measurements import FIXES, LANDMARKS, Array, Innovation, Measurement, States
from diffbot_control.filter.measurements.gyro import GyroRate
from diffbot_control.filter.memory import Memory
from diffbot_control.filter.models import Motion
from diffbot_control.filter.options import FilterOptions
from diffbot_control.filter.slip import add_innovation
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, scale_twist_covariance
from diffbot_core.units import S_PER_NS

_RESET_P = np.diag((RESET_VAR_XY, RESET_VAR_XY, RESET_VAR_THETA))


class GatedFilter:
    """One of the filters of FILTERS; make it, call :meth:`reset_to`, then :meth:`predict` and :meth:`take`."""

    def __init__(self, options: FilterOptions, wheel_separation: float, times: Times | None = None) -> None:
        """Choose the filter.

        Args:
            options: of the filter.
            wheel_separation: L [m].
            times: how long the errors of the sensors last; None: all are independent.
        """
        self.calibrating = options.radius_variance > 0.0
        wheels = 0 if not self.calibrating else 3 if options.separation_variance > 0.0 else 2
        gyro = options.gyro_bias_variance > 0.0
        self._ekf = PoseEkf(wheels, landmark_states=any(options.landmark_sigmas), gyro=gyro)
        self.configure(options, wheel_separation, times)
        self.reset()

    def configure(self, options: FilterOptions, wheel_separation: float, times: Times | None = None) -> None:
        """Apply changed options; the number of states stays."""
        self.options = options
        self._times: Times = times or {}
        self.wheel_separation = self._ekf.wheel_separation = wheel_separation
        self._ekf.random_walk = options.radius_random_walk
        self._ekf.bias_random_walk = options.gyro_bias_random_walk
        self._ekf.states = self._ekf.states._replace(landmark_errors=options.landmark_errors)

    def reset(self) -> None:
        """Reset pose, estimated errors and adaptation to unknown; :meth:`reset_to` has to be called next."""
        ekf, options = self._ekf, self.options
        x, P = np.zeros(ekf.x.size), np.zeros(ekf.P.shape)
        P[ekf.states.wheels, ekf.states.wheels] = prior = self._wheel_prior()
        x[ekf.states.wheels] = options.wheel_errors[: len(prior)]
        if any(options.landmark_sigmas):
            x[ekf.states.landmarks] = options.landmark_errors
            P[ekf.states.landmarks, ekf.states.landmarks] = np.diag(np.square(options.landmark_sigmas))
        P[ekf.states.gyro, ekf.states.gyro] = options.gyro_bias_variance
        self.memory = Memory(Belief(x, P), None, new_gate(), new_adaptation())
        self.nis = math.nan
        """normalised innovation squared of the newest measurement"""
        self.innovation: Innovation | None = None
        """of the newest measurement, if it could be computed"""

    def _wheel_prior(self) -> Array:
        """Return the covariance (m, m) of the m wheel errors at the start; m is 0, 2 or 3."""
        left_right = self.options.radius_variance
        variances = (left_right, left_right, self.options.separation_variance)
        part = self._ekf.states.wheels
        return np.diag(variances[: part.stop - part.start])

    def start_from(self, fix: Measurement) -> None:
        """Remember a fix that the filter was put at: the errors of later ones may be correlated with its."""
        self.memory = self.memory._replace(stamps=with_stamp(NO_STAMPS, fix, self._times))

    def reset_to(self, pose: Pose, P: Array) -> None:
        """Put the filter at a pose with covariance ``P`` (3, 3); estimated errors and adaptation stay."""
        belief = with_pose(self.memory.belief, pose, P)
        old = self.memory
        correlations = unpaired(old.fix_correlation), STANDING, unseen(old.landmarks)
        self.memory = Memory(belief, None, new_gate(), old.adaptation, NO_STAMPS, *correlations)

    def average(self) -> Belief:
        """Return the belief over both hypotheses on the estimated errors, see :mod:`averaging`."""
        x, P = self.memory.belief
        states = self._ekf.states
        return Belief(*average(x, P, states.wheels.start, states.landmarks.start, self.options))

    def wheels(self) -> ErrorEstimate | None:
        """Return the estimated errors of the wheels; None if they are not states."""
        return self._errors(self._ekf.states.wheels)

    @property
    def states(self) -> States:
        """Where the states stand."""
        return self._ekf.states

    def corrected_twist(self, measured: Twist, x: Array) -> Twist:
        """Return a twist corrected by the errors of the wheels in the state ``x`` (n,), if there are any."""
        return self._ekf.corrected_twist(measured, x)

    def landmark_errors(self) -> ErrorEstimate | None:
        """Return the estimated errors of landmarks, see :class:`LandmarkErrors`; None if they are not states."""
        return self._errors(self._ekf.states.landmarks)

    def gyro_bias(self) -> ErrorEstimate | None:
        """Return the estimated bias of the gyro (1,) [rad/s]; None if it is no state."""
        return self._errors(self._ekf.states.gyro)

    def set_wheels(self, wheels: ErrorEstimate) -> None:
        """Set the errors of the wheels, uncorrelated with all else: the radii, and the separation if both have it."""
        part = self._ekf.states.wheels
        common = min(part.stop - part.start, len(wheels.errors))
        known = ErrorEstimate(wheels.errors[:common], wheels.P[:common, :common])
        self._set_errors(slice(part.start, part.start + common), known)

    def set_landmark_errors(self, errors: ErrorEstimate) -> None:
        """Set the errors of landmarks, uncorrelated with all else; does nothing if they are not states."""
        self._set_errors(self._ekf.states.landmarks, errors)

    def fix_correlation(self) -> float | None:
        """Return the correlation found between the errors of neighbouring fixes; None if it is not looked for."""
        factor = self.memory.fix_correlation.inflation
        return (factor - 1.0) / (factor + 1.0) if self.options.detects_fix_correlation else None

    def landmark_correlation_time(self) -> float | None:
        """Return how long the errors of each landmark were found to last [s]; None if it is not looked for."""
        return self.memory.landmarks.means.time if self.options.detects_landmark_correlation else None

    def assumed_correlation(self, sensor: str, periods: Sequence[float]) -> float:
        """Return the mean correlation that the filter assumes of a sensor's errors that are ``periods`` [s] apart."""
        if sensor == FIXES and (c := self.fix_correlation()) is not None:
            return c
        time = self.landmark_correlation_time() if sensor == LANDMARKS else None
        return correlation_over(periods, self._times.get(sensor, 0.0) if time is None else time)

    def _errors(self, part: slice) -> ErrorEstimate | None:
        if part.start == part.stop:
            return None
        x, P = self.memory.belief
        return ErrorEstimate(x[part], P[part, part])

    def _set_errors(self, part: slice, estimate: ErrorEstimate) -> None:
        if part.start < part.stop == part.start + len(estimate.errors):
            belief = self.memory.belief
            self.memory = self.memory._replace(belief=with_errors(belief, part, estimate.errors, estimate.P))

    def predict(self, motion: Motion, var_lateral: float = 0.0) -> None:
        """Move estimate and candidate; ``var_lateral`` is the variance of the motion across the robot [m^2]."""
        belief, candidate, gate, adaptation, stamps, fix_correlation, travelled, landmarks, slip = self.memory
        if self.options.adaptive:
            q = q_scale(adaptation)
            covariance = scale_twist_covariance(motion.covariance, q)
            motion, var_lateral = motion._replace(covariance=covariance), q * var_lateral
        self._ekf.var_lateral = var_lateral
        belief = self._moved(belief, motion)
        if candidate is not None:
            candidate = self._moved(candidate, motion)
        if self.options.detects_fix_correlation:
            travelled = travel(travelled, motion, var_lateral)
        if landmarks.seen:
            landmarks = landmarks._replace(travelled=travel(landmarks.travelled, motion, var_lateral))
        gate = age(gate, motion.dt)
        self.memory = Memory(belief, candidate, gate, adaptation, stamps, fix_correlation, travelled, landmarks, slip)

    def take_rate(self, measured: GyroRate, dt: float) -> float | None:
        """Correct the bias of the gyro and the errors of the wheels with the turn rate of a step of ``dt`` [s].

        Returns:
            The difference [rad/s] between gyro and wheels if it is beyond the gate, where it corrects by a part only;
            None if it is expected.
        """
        memory, bound = self.memory, self.options.gates[0]
        belief, nis, innovation = self._corrected(memory.belief, measured, Robust(1.0, bound))
        if innovation is None:
            return None
        y, mean = innovation.y.item(0), memory.disagreement
        if self.calibrating and nis <= bound:
            by = measured.jacobian(memory.belief.x, self._ekf.states)[0, self._ekf.states.wheels].tolist()
            mean, variance = add_innovation(mean, y, innovation.S.item(0), dt, (by[0], by[1]))
            if variance > 0.0:
                belief = with_wider_radii(belief, variance)
        landmarks = with_shift(memory.landmarks, memory.belief.x, belief.x)
        self.memory = memory._replace(belief=belief, landmarks=landmarks, disagreement=mean)
        return y if nis > bound else None

    def take(self, measurement: Measurement) -> int:
        """Correct with a measurement as the gate decides.

        Returns:
            ACCEPTED, REJECTED, RELOCATED, IGNORED or WEIGHED, see :class:`gate.Decision`.
        """
        memory = self.memory
        bound = self.options.gates[measurement.z.size - 1]
        pose = pose_of(memory.belief)
        if (start := measurement.restart(pose)) is not None:
            if self.options.adaptive:
                measurement = _scaled(measurement, memory.adaptation)
                start = measurement.restart(pose) or start
            return self._take_fix(measurement, start, bound)
        robust = self._robust(measurement, bound)
        belief, self.nis, self.innovation = self._corrected(memory.belief, measurement, robust)
        if self._is_weighed(measurement):
            gate, decision = decide_weight(memory.gate, self.nis, bound)
        else:
            gate, decision = decide_other(memory.gate, self.nis, bound, self.options)
        if decision.outcome == RELOCATED:
            unknown = with_pose(memory.belief, pose, _RESET_P)
            belief, _, _ = self._corrected(unknown, measurement, robust)
        elif decision.outcome not in (ACCEPTED, WEIGHED):
            belief = memory.belief
        stamps = with_stamp(memory.stamps, measurement, self._times)
        belief, landmarks = self._with_landmark_correlation(measurement, belief, decision.outcome)
        self.memory = memory._replace(belief=belief, gate=gate, stamps=stamps, landmarks=landmarks)
        return decision.outcome

    def _take_fix(self, fix: Measurement, start: tuple[Pose, Array], bound: float) -> int:
        """Correct with a measurement by which the filter may restart at pose and covariance ``start``."""
        memory, adaptive = self.memory, self.options.adaptive
        adaptation = memory.adaptation
        robust = self._robust(fix, bound)
        belief, self.nis, self.innovation = self._corrected(memory.belief, fix, robust)
        other, candidate_nis = None, math.nan
        if memory.candidate is not None and not is_expected(self.nis, fix_bound(memory.gate, bound)):
            other, candidate_nis, _ = self._corrected(memory.candidate, fix, robust)
        gate, decision = decide_fix(memory.gate, self.nis, candidate_nis, bound, self.options)
        candidate = None
        if decision.outcome != ACCEPTED:
            candidate = other if decision.agrees else with_pose(memory.belief, *start)
            belief = memory.belief
            if decision.outcome == RELOCATED and candidate is not None:
                belief, candidate = candidate, None
        if adaptive and self.innovation is not None:
            adaptation = self._adapted(self.innovation, decision.outcome == ACCEPTED)
            factor = inflation(memory.adaptation, adaptation)
            belief = inflate(belief, factor)
            candidate = None if candidate is None else inflate(candidate, factor)
        fix_correlation, is_first = memory.fix_correlation, fix.source.sensor == FIXES
        if self.options.detects_fix_correlation:
            belief, fix_correlation = self._with_fix_correlation(fix, start[0], belief, decision.outcome)
        self.memory = Memory(
            belief,
            candidate,
            gate,
            adaptation,
            with_stamp(memory.stamps, fix, self._times),
            fix_correlation,
            STANDING if is_first else memory.travelled,
            self._shifted_landmarks(belief, decision.outcome),
            memory.disagreement,
        )
        return decision.outcome

    def _with_fix_correlation(
        self, fix: Measurement, pose: Pose, after: Belief, outcome: int
    ) -> tuple[Belief, FixCorrelation]:
        """Return the belief after a fix and what it says about the correlation of the errors of global_pose."""
        memory, is_first = self.memory, fix.source.sensor == FIXES
        if outcome == RELOCATED or (outcome != ACCEPTED and is_first):
            return after, unpaired(memory.fix_correlation)
        poses = pose_of(memory.belief), pose_of(after)
        if not is_first:
            return after, shifted(memory.fix_correlation, *poses)
        x, y, *theta = fix.noise(*memory.belief, self._ekf.states).diagonal().tolist()
        variances = Variances(x, y, theta[0] if theta else math.inf)
        fix_correlation = with_fix(
            memory.fix_correlation, memory.travelled, pose, variances, *poses, after.P.item(2, 2)
        )
        return inflate(after, growth(memory.fix_correlation, fix_correlation)), fix_correlation

    def _with_landmark_correlation(
        self, measurement: Measurement, after: Belief, outcome: int
    ) -> tuple[Belief, LandmarkCorrelation]:
        """Return the belief after a measurement and what it says about the correlation of the errors of landmarks."""
        x, P = self.memory.belief
        landmarks, innovation, states = self.memory.landmarks, self.innovation, self._ekf.states
        if not self.options.detects_landmark_correlation or innovation is None:
            return after, landmarks
        found, is_landmark = landmarks, measurement.source.sensor == LANDMARKS
        if is_landmark and outcome == ACCEPTED:
            H, R = measurement.jacobian(x, states), measurement.noise(x, P, states)
            pose, shift = pose_of(self.memory.belief), np.zeros(x.size) + landmarks.shift
            now = Seen(measurement.stamp, innovation.y, pose, P.item(2, 2), shift, landmarks.travelled)
            found = with_landmark(landmarks, measurement.source, now, H, R)
        after = inflate(after, growth_of_landmarks(landmarks.means, found.means))
        return after, unseen(found) if outcome == RELOCATED else with_shift(found, x, after.x)

    def _shifted_landmarks(self, after: Belief, outcome: int) -> LandmarkCorrelation:
        """Return the memory of the landmarks after a fix."""
        landmarks = self.memory.landmarks
        return unseen(landmarks) if outcome == RELOCATED else with_shift(landmarks, self.memory.belief.x, after.x)

    def _adapted(self, innovation: Innovation, expected: bool) -> Adaptation:
        """Adapt to an innovation, of whose S only the diagonal counts: each number by its own deviation."""
        y, S = innovation.y.tolist(), innovation.S.diagonal().tolist()
        normalised = [one / math.sqrt(variance) for one, variance in zip(y, S, strict=True)]
        return adapt(self.memory.adaptation, Normalised(*normalised, *[math.nan] * (3 - len(y))), expected)

    def _robust(self, measurement: Measurement, bound: float) -> Robust:
        """Return how much weaker the correction with a measurement is than its R says."""
        if self.options.detects_fix_correlation and measurement.source.sensor == FIXES:
            inflation, gate = self.memory.fix_correlation.inflation, math.inf
        else:
            inflation = self._inflation(measurement)
            gate = bound if self._is_weighed(measurement) else math.inf
        return PLAIN if inflation == 1.0 and gate == math.inf else Robust(inflation, gate)

    def _inflation(self, measurement: Measurement) -> float:
        """Return the factor on R by what is known or found of the correlation of the errors."""
        if not self.options.detects_landmark_correlation or measurement.source.sensor != LANDMARKS:
            return inflation_of(self.memory.stamps, measurement, self._times)
        landmarks = self.memory.landmarks
        last = landmarks.seen.get(measurement.source)
        return 1.0 if last is None else inflation_by(landmarks.means, (measurement.stamp - last.stamp) * S_PER_NS)

    def _is_weighed(self, measurement: Measurement) -> bool:
        return self.options.weigh_landmarks and measurement.source.sensor == LANDMARKS

    def _moved(self, belief: Belief, motion: Motion) -> Belief:
        ekf = self._ekf
        ekf.x, ekf.P = belief
        ekf.predict(motion)
        return Belief(ekf.x, ekf.P)

    def _corrected(
        self, belief: Belief, measurement: Measurement, robust: Robust
    ) -> tuple[Belief, float, Innovation | None]:
        """Return the belief after the measurement, its NIS and innovation.

        The NIS is inf if nothing can be expected here, nan if it cannot be computed; the belief is the same then.
        """
        ekf = self._ekf
        ekf.x, ekf.P = belief
        if not measurement.is_defined(belief.x):
            return belief, math.inf, None
        try:
            nis = ekf.correct(measurement, robust)
        except np.linalg.LinAlgError:
            return belief, math.nan, None  # S is singular to working precision
        if math.isnan(nis):
            return belief, math.nan, None
        return self._with_possible_radii(Belief(ekf.x, ekf.P)), nis, ekf.newest

    def _with_possible_radii(self, belief: Belief) -> Belief:
        """Reset the errors of the wheels if one is beyond its bound."""
        if not self.calibrating:
            return belief
        options, part = self.options, self._ekf.states.wheels
        errors = belief.x.tolist()[part]
        start = options.wheel_errors
        radii = max(abs(errors[0] - start[0]), abs(errors[1] - start[1]))
        separation = abs(errors[2] - start[2]) if len(errors) == 3 else 0.0
        if radii <= options.max_radius_error and separation <= options.max_separation_error:
            return belief
        prior = self._wheel_prior()
        return with_errors(belief, part, np.array(start[: len(prior)]), prior)


def _scaled(fix: Any, adaptation: Adaptation) -> Any:
    """Return a fix with the R that was learnt: three numbers, or two of a position."""
    position, heading = r_scales(adaptation)
    factors = np.array((math.sqrt(position), math.sqrt(position), math.sqrt(heading)))[: len(fix.R)]
    return replace(fix, R=fix.R * np.outer(factors, factors))
