"""The compiled filter is filterpy's: the same numbers after any sequence of measurements, in all variants."""

import math

import numpy as np
import pytest
from filter_runs import SEPARATION, wrapped

from diffbot_control.filter.dock import FixNoise
from diffbot_control.filter.gate import ACCEPTED, REJECTED, RELOCATED
from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.landmark_calibration import NO_ERRORS
from diffbot_control.filter.measurements import Heading, LandmarkMeasurement, PoseFix
from diffbot_control.filter.models import Motion
from diffbot_control.filter.options import FILTERS, REJECT, WEIGH, FilterConfig, options_of
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import Twist, TwistCovariance
from diffbot_sim.compiled import gated_filter as twin
from diffbot_sim.compiled.late_fusion import WITH_SENSORS, WITH_WHEELS

LANDMARKS = ((3.0, 1.0), (-2.0, 4.0), (0.5, -3.0))


def twin_fix(pose, R):
    return twin.PoseFix(pose, FixNoise(R[0, 0], R[0, 1], R[1, 1], R[0, 2], R[1, 2], R[2, 2]))


def random_covariance(rng):
    """Variances of a pose with correlations of any strength."""
    factor = rng.normal(size=(3, 3))
    R = factor @ factor.T + 1e-2 * np.eye(3)
    sigmas = np.sqrt(rng.uniform(1e-3, 0.05, 3) / R.diagonal())
    return R * np.outer(sigmas, sigmas)


def flat(adaptation):
    """All its numbers but the rules."""
    return [
        *adaptation.innovation,
        *adaptation.drift,
        adaptation.fixes,
        adaptation.expected,
        *adaptation.position[1:],
        *adaptation.heading[1:],
    ]


def same_belief(belief, reference, wheels, tolerance):
    x, P = reference
    # The compiled filter always has the errors of the wheels, and those of landmarks behind them.
    places = [0, 1, 2, *range(3, 3 + wheels), *range(6, 6 + len(x) - 3 - wheels)]
    found = belief["x"][places]
    np.testing.assert_allclose(found[:2], x[:2], rtol=tolerance, atol=tolerance)
    assert wrapped(found[2] - x[2]) == pytest.approx(0.0, abs=tolerance)
    assert -math.pi < found[2] <= math.pi
    np.testing.assert_allclose(found[3:], x[3:], atol=tolerance)
    np.testing.assert_allclose(belief["P"][np.ix_(places, places)], P, rtol=tolerance, atol=tolerance)


def assert_same_colour(mine, theirs):
    """The means of what the fixes say about the correlation of their errors."""
    assert (mine.paired, mine.pairs) == (theirs.paired, theirs.pairs)
    numbers = [(*one.innovation, *one.residual, *one[4:]) for one in (mine, theirs)]
    assert numbers[0] == pytest.approx(numbers[1], rel=1e-6, abs=1e-7)


class Twins:
    """The filter and its compiled twin; both get the same."""

    def __init__(self, options, example, pose, R):
        self.options, self.reference, self.track = options, GatedFilter(options, SEPARATION), twin.new_track()
        self.arrays, self.seen = np.zeros(1, example.filter.dtype)[0], np.zeros(len(LANDMARKS), example.seen.dtype)
        twin.reset_arrays(self.arrays, options)
        self.reference.reset_to(pose, R)
        self.track = twin.take_fix(self.track, self.arrays, twin_fix(pose, R), options)
        assert_same(self.reference, self.track, self.arrays, 1e-9)

    def predict(self, motion):
        self.reference.predict(motion)
        self.track = twin.advance(self.track, self.arrays, motion, SEPARATION, self.options)

    def take_landmark(self, number, z, time):
        point = Point(*LANDMARKS[number])
        self.reference.take(LandmarkMeasurement(round(1e9 * time), *z, np.diag([0.01, 0.004]), point))
        measured, seen = twin.LandmarkMeasurement(*z, point, 0.01, 0.004), self.seen[number]
        self.track = twin.take_landmark(self.track, self.arrays, seen, measured, time, self.options)


def assert_same(reference, track, arrays, tolerance):
    estimated = reference.wheels()
    wheels = 0 if estimated is None else len(estimated.errors)
    same_belief(arrays["belief"], reference.memory.belief, wheels, tolerance)
    average, reported = reference.average(), twin.reported_belief(arrays, reference.options)
    np.testing.assert_allclose(reported["x"][:2], average.x[:2], rtol=tolerance, atol=tolerance)
    assert wrapped(reported["x"][2] - average.x[2]) == pytest.approx(0.0, abs=tolerance)
    np.testing.assert_allclose(reported["P"][:3, :3], average.P[:3, :3], rtol=tolerance, atol=tolerance)
    # The same functions of nearly the same numbers: counts and times have no tolerance.
    assert track.gate == reference.memory.gate
    assert (reference.memory.candidate is None) == (track.gate.fixes.rejected == 0)
    if reference.memory.candidate is not None:
        same_belief(arrays["candidate"], reference.memory.candidate, wheels, tolerance)
    assert_same_colour(track.fix_correlation, reference.memory.fix_correlation)
    assert tuple(track.landmarks) == pytest.approx(tuple(reference.memory.landmarks.means), rel=1e-5, abs=1e-7)
    other = reference.memory.adaptation
    assert flat(track.adaptation) == pytest.approx(flat(other), rel=1e-6, abs=1e-7)
    rules = zip(
        (*track.adaptation.position.rules, *track.adaptation.heading.rules),
        (*other.position.rules, *other.heading.rules),
        strict=True,
    )
    for mine, theirs in rules:
        assert mine == pytest.approx(theirs, rel=1e-6, abs=1e-7)


@pytest.mark.parametrize(("variant", "seed"), [*zip(FILTERS, (0, 1, 0, 1), strict=True), ("ekf", 2), (FILTERS[-1], 2)])
def test_the_compiled_filter_is_filterpys(variant, seed):
    """The errors of fixes are correlated. Some runs take the wheel separation as given; one calibrates landmarks."""
    rng = np.random.default_rng(seed)
    probability = (0.9, 0.999, 1.0)[seed % 3]
    separation_sigma = 0.0 if seed % 2 else 0.05
    options = options_of(
        FilterConfig(
            filter=variant,
            gate_probability=probability,
            relocation_timeout=0.8,
            wheel_separation_sigma=separation_sigma,
            wheels_as_configured=0.5 if seed % 2 else 0.2,
            left_radius_error=0.02 if seed else 0.0,
            right_radius_error=-0.01 if seed else 0.0,
            wheel_separation_error=0.03 if seed else 0.0,
            landmark_range_offset=0.03,
            landmark_gate=WEIGH if variant == FILTERS[-1] else REJECT,
        ),
        landmarks=seed == 2,
    )
    if seed != 2:
        options = options._replace(landmark_errors=NO_ERRORS)
    truth = np.array([*rng.uniform(-1.0, 1.0, 2), math.pi - 0.01 if seed % 2 else rng.uniform(-math.pi, math.pi)])
    twins = Twins(options, WITH_SENSORS if seed == 2 else WITH_WHEELS, Pose(*truth), random_covariance(rng))
    reference, arrays = twins.reference, twins.arrays
    now, verdicts, kinds = 0.0, set(), ["fix"] * 4 + ["heading", "landmark", "outlier"]
    for step in range(300):
        v, omega, dt = rng.uniform(-1.0, 2.0), rng.uniform(-4.0, 4.0), rng.uniform(0.01, 0.3)
        a, b, rho = *rng.uniform(1e-3, 0.1, 2), rng.uniform(-0.9, 0.9)
        twins.predict(Motion(Twist(v, omega), dt, TwistCovariance(a * a, rho * a * b, b * b)))
        now += dt
        middle = truth[2] + 0.5 * omega * dt
        truth += [v * dt * math.cos(middle), v * dt * math.sin(middle), omega * dt]
        if step in (100, 101, 200):
            truth += [4.0, 1.0, 1.0]  # kidnapped
        kind = kinds[rng.integers(len(kinds))] if step < 220 else ("heading", "landmark")[step % 2]
        if step == 240:
            truth += [2.0, -3.0, -1.5]  # and with no more fixes again
        if kind in ("fix", "outlier"):
            z = truth + rng.normal(0.0, 0.1, 3) + (rng.uniform(-3.0, 3.0, 3) if kind == "outlier" else 0.0)
            pose = Pose(z[0], z[1], wrapped(z[2]))
            R = random_covariance(rng)
            verdict = reference.take(PoseFix(0, pose, R))
            twins.track = twin.take_fix(twins.track, arrays, twin_fix(pose, R), options)
            assert twins.track.newest.fix_outcome == verdict
            verdicts.add(verdict)
        elif kind == "heading":
            z, variance = wrapped(truth[2] + rng.normal(0.0, 0.1)), rng.uniform(1e-3, 0.05)
            reference.take(Heading(0, z, np.array([[variance]])))
            twins.track = twin.take_heading(twins.track, arrays, z, variance, options)
        else:
            x, y = LANDMARKS[number := rng.integers(3)]
            exact = math.hypot(x - truth[0], y - truth[1]), wrapped(math.atan2(y - truth[1], x - truth[0]) - truth[2])
            twins.take_landmark(number, exact, now)
        assert twins.track.newest.nis == pytest.approx(reference.nis, rel=1e-6)
        # Each step is held together by itself: a difference in the last digit must not grow over hundreds of steps.
        assert_same(reference, twins.track, arrays, 1e-7)
    assert verdicts == ({ACCEPTED} if probability == 1.0 else {ACCEPTED, REJECTED, RELOCATED})


def test_it_finds_the_same_correlation_of_landmarks():
    """Their errors last 2 s; a kidnapping in between leaves no landmark a partner."""
    rng, options = np.random.default_rng(1), options_of(FilterConfig(), landmarks=True)
    twins = Twins(options, WITH_SENSORS, Pose(0.0, 0.0, 3.0), np.diag([0.03, 0.03, 0.01]))
    truth, c, errors = np.array([0.0, 0.0, 3.0]), math.exp(-0.1), rng.normal(size=(len(LANDMARKS), 2))
    for step in range(300):
        twins.predict(Motion(Twist(0.4, 0.3), 0.2, TwistCovariance(4e-4, 1e-5, 4e-4)))
        middle = truth[2] + 0.03
        truth += [0.08 * math.cos(middle), 0.08 * math.sin(middle), 0.06]
        if step == 150:
            truth += [2.0, 0.0, 1.0]
        errors = c * errors + math.sqrt(1.0 - c * c) * rng.normal(size=errors.shape)
        for number, (x, y) in enumerate(LANDMARKS):
            distance, bearing = math.hypot(x - truth[0], y - truth[1]), math.atan2(y - truth[1], x - truth[0])
            z = distance + 0.1 * errors[number, 0], wrapped(bearing - truth[2] + math.sqrt(0.004) * errors[number, 1])
            twins.take_landmark(number, z, 0.2 * step)
        assert_same(twins.reference, twins.track, twins.arrays, 1e-6)
    assert twins.track.landmarks.time == pytest.approx(2.0, rel=0.5)
