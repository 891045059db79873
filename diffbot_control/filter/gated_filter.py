"""The filter with its gate, its relocation and its adaptation, on filterpy's EKF.

Its memory is one immutable value, :attr:`GatedFilter.memory`: assigning an older one restores that state.
"""

from __future__ import annotations

import math

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
from diffbot_control.filter.belief import Belief, ErrorEstimate, inflate, pose_of, with_errors, with_pose
from diffbot_control.filter.colour import STANDING, Colour, Variances, growth, shifted, travel, unpaired, with_fix
from diffbot_control.filter.correlation import NO_STAMPS, inflation_of, with_stamp
from diffbot_control.filter.ekf import PLAIN, PoseEkf, Robust
from diffbot_control.filter.gate import (
    ACCEPTED,
    FIX,
    HEADING,
    LANDMARK,
    RELOCATED,
    RESET_VAR_THETA,
    RESET_VAR_XY,
    WEIGHED,
    age,
    decide,
    decide_weight,
    is_expected,
    new_gate,
)
from diffbot_control.filter.innovation_monitor import Innovation
from diffbot_control.filter.landmark_calibration import NO_ERRORS
from diffbot_control.filter.measurements import Array, Heading, LandmarkMeasurement, Measurement, PoseFix
from diffbot_control.filter.memory import Memory
from diffbot_control.filter.models import Motion
from diffbot_control.filter.options import FilterOptions
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import scale_twist_covariance

_RESET_P = np.diag((RESET_VAR_XY, RESET_VAR_XY, RESET_VAR_THETA))


class GatedFilter:
    """One of the filters of FILTERS; make it, call :meth:`reset_to`, then :meth:`predict` and :meth:`take`."""

    def __init__(self, options: FilterOptions, wheel_separation: float) -> None:
        """Choose the filter; ``wheel_separation`` is L [m]."""
        self.calibrating = options.radius_variance > 0.0
        wheels = 0 if not self.calibrating else 3 if options.separation_variance > 0.0 else 2
        self._ekf = PoseEkf(wheels, landmark_states=options.landmark_sigmas is not None)
        self.configure(options, wheel_separation)
        self.reset()

    def configure(self, options: FilterOptions, wheel_separation: float) -> None:
        """Apply changed options; the number of states stays."""
        self.options = options
        self._correlated = any(options.correlation_times)
        self._ekf.wheel_separation = wheel_separation
        self._ekf.random_walk = options.radius_random_walk
        self._ekf.landmark_errors = options.landmark_errors if any(options.landmark_errors) else NO_ERRORS

    def reset(self) -> None:
        """Reset pose, estimated errors and adaptation to unknown; :meth:`reset_to` has to be called next."""
        ekf, options = self._ekf, self.options
        x, P = np.zeros(ekf.x.size), np.zeros(ekf.P.shape)
        P[ekf.wheel_part, ekf.wheel_part] = prior = self._wheel_prior()
        x[ekf.wheel_part] = options.wheel_errors[: len(prior)]
        if options.landmark_sigmas is not None:
            x[ekf.landmark_part] = options.landmark_errors
            P[ekf.landmark_part, ekf.landmark_part] = np.diag(np.square(options.landmark_sigmas))
        self.memory = Memory(Belief(x, P), None, new_gate(), new_adaptation())
        self.nis = math.nan
        """normalised innovation squared of the newest measurement"""
        self.innovation: Innovation | None = None
        """of the newest measurement, if it could be computed"""

    def _wheel_prior(self) -> Array:
        """Return the covariance (m, m) of the m wheel errors at the start; m is 0, 2 or 3."""
        left_right = self.options.radius_variance
        variances = (left_right, left_right, self.options.separation_variance)
        part = self._ekf.wheel_part
        return np.diag(variances[: part.stop - part.start])

    def start_from(self, fix: PoseFix) -> None:
        """Put the filter at a fix, as :meth:`reset_to`; the errors of later fixes may be correlated with its."""
        self.reset_to(fix.pose, fix.R)
        self.memory = self.memory._replace(stamps=with_stamp(NO_STAMPS, fix, self.options.correlation_times))

    def reset_to(self, pose: Pose, P: Array) -> None:
        """Put the filter at a pose with covariance ``P`` (3, 3); estimated errors and adaptation stay."""
        belief = with_pose(self.memory.belief, pose, P)
        old = self.memory
        self.memory = Memory(belief, None, new_gate(), old.adaptation, NO_STAMPS, unpaired(old.colour))

    def wheels(self) -> ErrorEstimate | None:
        """Return the estimated errors of the wheels; None if they are not states."""
        return self._errors(self._ekf.wheel_part)

    def landmark_errors(self) -> ErrorEstimate | None:
        """Return the estimated errors of landmarks, see :class:`LandmarkErrors`; None if they are not states."""
        return self._errors(self._ekf.landmark_part)

    def set_wheels(self, wheels: ErrorEstimate) -> None:
        """Set the errors of the wheels, uncorrelated with all else: the radii, and the separation if both have it."""
        part = self._ekf.wheel_part
        common = min(part.stop - part.start, len(wheels.errors))
        known = ErrorEstimate(wheels.errors[:common], wheels.P[:common, :common])
        self._set_errors(slice(part.start, part.start + common), known)

    def set_landmark_errors(self, errors: ErrorEstimate) -> None:
        """Set the errors of landmarks, uncorrelated with all else; does nothing if they are not states."""
        self._set_errors(self._ekf.landmark_part, errors)

    def fix_correlation(self) -> float | None:
        """Return the correlation found between the errors of neighbouring fixes; None if it is not looked for."""
        factor = self.memory.colour.inflation
        return (factor - 1.0) / (factor + 1.0) if self.options.detects_colour else None

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
        belief, candidate, gate, adaptation, stamps, colour, travelled = self.memory
        if self.options.adaptive:
            twist, dt, covariance = motion
            q = q_scale(adaptation)
            motion, var_lateral = Motion(twist, dt, scale_twist_covariance(covariance, q)), q * var_lateral
        self._ekf.var_lateral = var_lateral
        belief = self._moved(belief, motion)
        if candidate is not None:
            candidate = self._moved(candidate, motion)
        if self.options.detects_colour:
            travelled = travel(travelled, motion, var_lateral)
        self.memory = Memory(belief, candidate, age(gate, motion.dt), adaptation, stamps, colour, travelled)

    def take(self, measurement: Measurement) -> int:
        """Correct with a measurement as the gate decides.

        Returns:
            ACCEPTED, REJECTED, RELOCATED or IGNORED, see :class:`gate.Decision`.
        """
        if isinstance(measurement, PoseFix):
            return self._take_fix(measurement)
        return self._take_other(measurement)

    def _take_fix(self, fix: PoseFix) -> int:
        before, candidate, gate, old, stamps, colour, travelled = self.memory
        adaptation, options, adaptive = old, self.options, self.options.adaptive
        if adaptive:
            fix = fix._replace(R=_scaled_noise(fix.R, old))
        robust = self._robust(fix)
        belief, self.nis = self._corrected(before, fix, robust)
        self.innovation = self._newest_innovation()
        innovation = self._normalised_innovation() if adaptive else None
        other, candidate_nis = None, math.nan
        if candidate is not None and not is_expected(gate, self.nis, FIX, options):
            other, candidate_nis = self._corrected(candidate, fix, robust)
        gate, decision = decide(gate, self.nis, candidate_nis, FIX, options)
        if innovation is not None:
            adaptation = adapt(old, innovation, decision.outcome == ACCEPTED)
        if decision.outcome == ACCEPTED:
            candidate = None
        else:
            candidate = other if decision.agrees else with_pose(before, fix.pose, fix.R)
            belief = before
            if decision.outcome == RELOCATED and candidate is not None:
                belief, candidate = candidate, None
        if adaptive:
            factor = inflation(old, adaptation)
            belief = inflate(belief, factor)
            candidate = None if candidate is None else inflate(candidate, factor)
        if options.detects_colour:
            belief, colour = self._coloured(fix, belief, decision.outcome)
        if self._correlated:
            stamps = with_stamp(stamps, fix, options.correlation_times)
        self.memory = Memory(belief, candidate, gate, adaptation, stamps, colour, travelled if fix.source else STANDING)
        return decision.outcome

    def _coloured(self, fix: PoseFix, after: Belief, outcome: int) -> tuple[Belief, Colour]:
        """Return the belief after a fix and what it says about the correlation of the errors of global_pose."""
        memory = self.memory
        if outcome == RELOCATED or (outcome != ACCEPTED and not fix.source):
            return after, unpaired(memory.colour)
        poses = pose_of(memory.belief), pose_of(after)
        if fix.source:
            return after, shifted(memory.colour, *poses)
        variances = Variances(fix.R.item(0), fix.R.item(4), fix.R.item(8))
        colour = with_fix(memory.colour, memory.travelled, fix.pose, variances, *poses, after.P.item(2, 2))
        return inflate(after, growth(memory.colour, colour)), colour

    def _newest_innovation(self) -> Innovation | None:
        return Innovation(self._ekf.y, self._ekf.S) if math.isfinite(self.nis) else None

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
        before, candidate, gate, adaptation, stamps, colour, travelled = self.memory
        # The gate's bound is that of the numbers measured.
        kind = LANDMARK if isinstance(measurement, LandmarkMeasurement) and measurement.numbers == 2 else HEADING
        robust = self._robust(measurement, kind)
        belief, self.nis = self._corrected(before, measurement, robust)
        self.innovation = self._newest_innovation()
        if self.options.weigh_landmarks and isinstance(measurement, LandmarkMeasurement):
            gate, decision = decide_weight(gate, self.nis, kind, self.options)
        else:
            gate, decision = decide(gate, self.nis, math.nan, kind, self.options)
        if decision.outcome == RELOCATED:
            x, y, theta = before.x.tolist()[:3]
            belief, _ = self._corrected(with_pose(before, Pose(x, y, theta), _RESET_P), measurement, robust)
        elif decision.outcome not in (ACCEPTED, WEIGHED):
            belief = before
        if self._correlated:
            stamps = with_stamp(stamps, measurement, self.options.correlation_times)
        self.memory = Memory(belief, candidate, gate, adaptation, stamps, colour, travelled)
        return decision.outcome

    def _robust(self, measurement: Measurement, kind: int = FIX) -> Robust:
        """Return how much weaker the correction with a measurement is than its R says."""
        options = self.options
        if options.detects_colour and isinstance(measurement, PoseFix) and not measurement.source:
            inflation = self.memory.colour.inflation
            return PLAIN if inflation == 1.0 else Robust(inflation)
        weighed = options.weigh_landmarks and isinstance(measurement, LandmarkMeasurement)
        if not weighed and not self._correlated:
            return PLAIN
        inflation = inflation_of(self.memory.stamps, measurement, options.correlation_times)
        return Robust(inflation, options.gates[kind] if weighed else math.inf)

    def _moved(self, belief: Belief, motion: Motion) -> Belief:
        ekf = self._ekf
        ekf.x, ekf.P = belief
        ekf.predict(motion)
        return Belief(ekf.x, ekf.P)

    def _corrected(self, belief: Belief, measurement: Measurement, robust: Robust) -> tuple[Belief, float]:
        """Return the belief after the measurement, and its NIS; nan if it cannot be computed."""
        ekf = self._ekf
        ekf.x, ekf.P = belief
        try:
            if isinstance(measurement, PoseFix):
                nis = ekf.update_pose(measurement.pose, measurement.R, robust)
            elif isinstance(measurement, Heading):
                nis = ekf.update_heading(measurement.theta, measurement.R, robust)
            else:
                _, distance, bearing, R, landmark = measurement
                nis = ekf.update_landmark(distance, bearing, R, landmark, robust)
        except np.linalg.LinAlgError:
            return belief, math.nan  # S is singular to working precision
        if math.isnan(nis):
            return belief, math.nan
        return self._with_possible_radii(Belief(ekf.x, ekf.P)), nis

    def _with_possible_radii(self, belief: Belief) -> Belief:
        """Reset the errors of the wheels if one is beyond its bound."""
        if not self.calibrating:
            return belief
        options, part = self.options, self._ekf.wheel_part
        errors = belief.x.tolist()[part]
        start = options.wheel_errors
        radii = max(abs(errors[0] - start[0]), abs(errors[1] - start[1]))
        separation = abs(errors[2] - start[2]) if len(errors) == 3 else 0.0
        if radii <= options.max_radius_error and separation <= options.max_separation_error:
            return belief
        prior = self._wheel_prior()
        return with_errors(belief, part, np.array(start[: len(prior)]), prior)


def _scaled_noise(R: Array, adaptation: Adaptation) -> Array:
    position, heading = r_scales(adaptation)
    factors = np.array((math.sqrt(position), math.sqrt(position), math.sqrt(heading)))
    scaled: Array = R * np.outer(factors, factors)
    return scaled
