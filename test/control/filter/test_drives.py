"""Whole drives: all sensors at once, fixes that contradict the odometry, and measurements of extreme size."""

import math

import numpy as np
import pytest
from extremes import extreme_configs
from filter_drives import FAULTS, PLACES, SIGMAS, TRUE, Run, all_sensors, with_fault
from filter_runs import build_motion, covariance, fix, options, reading, started
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.filter import contradiction, ekf, models, noise
from diffbot_control.filter.config import FilterConfig
from diffbot_control.filter.contradiction import FROZEN, RELOCATING
from diffbot_control.filter.measurement import LANDMARKS, pose_fix
from diffbot_control.filter.odometry import OdometryStep
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance


@pytest.mark.parametrize("seed", range(2))
def test_with_all_sensors_late_biased_and_with_outliers_the_estimate_is_accurate_and_consistent(seed):
    nees, errors = [], []
    for found, estimate, robot in all_sensors(seed, 60.0):
        P = found.filter.P
        assert np.isfinite(found.filter.memory).all()
        assert np.linalg.eigvalsh(P / np.sqrt(np.outer(P.diagonal(), P.diagonal()))).min() > 0.0
        e = robot.error(estimate.pose)
        nees.append(e @ np.linalg.solve(estimate.P, e))
        errors.append(abs(e))
    assert 1.5 < np.mean(nees[100:]) < 5.0
    assert (np.sqrt(np.mean(np.square(errors[100:]), axis=0)) < (0.03, 0.03, 0.02)).all()
    x, deviations = found.filter.x, np.sqrt(found.filter.P.diagonal())
    true = {3: TRUE["left"], 4: TRUE["right"], 6: TRUE["bias"], 7: TRUE["range"]}
    assert all(abs(x[at] - value) < 4.0 * deviations[at] + 2e-3 for at, value in true.items())
    assert deviations[7] < 0.03
    assert found.outcomes[LANDMARKS][ekf.WEIGHED] > 10
    assert found.outcomes["fixes"][ekf.REJECTED] > 2
    assert found.contradiction.cause == ""
    # Only the errors of the GPS are time-correlated, by 0.9^3 from fix to fix.
    sources = found.consistency()
    assert sources.pop("fixes of gps").assumed == pytest.approx(0.9**3, abs=0.12)
    assert all(one.assumed == 0.0 and one.nis == pytest.approx(1.0, abs=0.3) for one in sources.values())


@pytest.mark.parametrize("scales", [(0.1, 0.1), (100.0, 1.0), (1.0, 100.0)])
def test_the_fuzzy_rules_correct_a_wrong_r(scales):
    run = Run("fixes", 0.0, 1, scales, filter="ekf_fnn", gate_probability=1.0)
    assert np.abs(np.log(run.scales() / scales)).max() < math.log(2.0)
    assert run.row[noise.TIME] == 0.0


@pytest.mark.parametrize(("fault", "every"), [*((fault, 1) for fault in FAULTS), ("frozen", 2)])
def test_fixes_that_contradict_the_odometry_are_detected_within_20_s(fault, every):
    story = with_fault(40.0, FAULTS[fault], every=every)
    time, cause = next((time, made.contradiction.cause) for time, made in story if made.contradiction.cause)
    assert cause == (FROZEN if fault == "frozen" else RELOCATING)
    assert time < 20.0


@pytest.mark.parametrize("outliers", [0.0, 0.3])
def test_noise_outliers_and_a_kidnapping_are_no_contradiction(outliers):
    story = with_fault(40.0, lambda x, y, theta, time: (x + 5.0 * (time > 10.0), y, theta), outliers)
    assert {made.contradiction.cause for _, made in story} == {""}


def test_a_contradiction_ends_after_a_minute_of_rest_or_by_initialise():
    story = [made.contradiction.cause for _, made in with_fault(100.0, FAULTS["turned by pi"], rest_after=5.0)]
    began = story.index(RELOCATING)
    assert story[-1] == ""
    assert 1200 <= story.index("", began) - began <= 1300
    *_, (_, made) = with_fault(10.0, FAULTS["turned by pi"])
    assert made.contradiction.cause == RELOCATING
    made.initialise(Pose(0.0, 0.0, 0.0), np.diag(SIGMAS**2))
    assert made.contradiction.cause == ""


def test_a_contradiction_ends_after_a_minute_of_rest_without_fixes():
    """As with AMCL, which publishes its pose only after a motion."""
    *_, (time, made) = with_fault(8.0, FAULTS["turned by pi"], every=1)
    assert made.contradiction.cause == RELOCATING
    for step in range(1, 650):
        stamp = round(1e9 * time) + step * 10**8
        pose = made.on_odometry(OdometryStep(stamp, Twist(0.0, 0.0), TwistCovariance(1e-4, 0.0, 1e-4))).pose
        made.check_innovations()
    assert made.contradiction.cause == ""
    made.on_measurement(pose_fix(stamp, pose, np.diag(SIGMAS**2)))
    made.check_innovations()
    assert made.contradiction.cause == ""


@pytest.mark.parametrize(
    ("seconds", "cause"),
    [((0, 20, 48, 40, 44), RELOCATING), ((0, 20, 40, 44), ""), ((40, 44, 51), ""), ((1, 2, 3), RELOCATING)],
)
def test_three_relocations_within_ten_seconds_are_a_contradiction(seconds, cause):
    memory = contradiction.NONE
    for second in seconds:
        memory = contradiction.with_relocation(memory, second * 10**9)
    assert (memory.cause, memory.since) == (cause, max(seconds) * 10**9 if cause else 0)


KINDS = "drive", "drive", "fix", "fix again", "heading", "landmark", "singular", "huge"
EVENTS = st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, 2**32 - 1)), min_size=20, max_size=60)
CONFIGS = [config for _, config in extreme_configs(FilterConfig, 3, 100)]


def event(rng, kind, time):
    """Return a motion or a measurement with numbers of very different sizes."""
    sized = lambda low, high: rng.choice([-1.0, 1.0], 2) * 10.0 ** rng.uniform(low, high, 2)  # noqa: E731
    angle = rng.uniform(-math.pi, math.pi)
    if kind == "drive":
        M = covariance(rng, 2, 1e-3, 3.0)
        return build_motion(*sized(-3, 1), 10.0 ** rng.uniform(-9.0, 0.0), M[0, 0], M[0, 1], M[1, 1])
    if kind == "heading":
        return reading(models.HEADING, [angle], covariance(rng, 1, 1e-3, 10.0), time)
    if kind == "landmark":
        R = covariance(rng, 2, 1e-3, 10.0)
        return reading(models.LANDMARK, [10.0 ** rng.uniform(-3, 2), angle], R, time, sized(-3, 2), 3)
    # The smallest deviation of a nearly singular R is a ten-thousandth of the largest.
    R = covariance(rng, 3, *((1e-4, 1.0) if kind == "singular" else (1e-2, 10.0)))
    return fix(*sized(-3, 7 if kind == "huge" else 2), angle, R, time)


@settings(max_examples=40)
@given(EVENTS, st.sampled_from(CONFIGS))
def test_the_state_stays_finite_symmetric_and_positive_definite(events, config):
    numbers = options(PLACES[:1], **config._asdict())
    found, last = started(numbers, (1.0, -2.0, 3.0), landmarks=1), fix(0.0)
    free = [at for at in range(numbers.size) if at < 3 or numbers.variances[at - 3] > 0.0]
    for number, (kind, seed) in enumerate(events):
        rng = np.random.default_rng(seed)
        one = last if kind == "fix again" else event(rng, kind, 0.1 * number)
        before = found.memory.copy()
        if kind == "drive":
            ekf.predict(found, numbers, one)
        else:
            outcome = ekf.take(found, numbers, one)
            assert config.gate_probability < 1.0 or outcome in (ekf.ACCEPTED, ekf.IGNORED)
            if outcome == ekf.REJECTED:
                np.testing.assert_array_equal(before[: numbers.size], found.x)
            last = one if models.is_fix(one.kind) else last
        for x, P in ((found.x, found.P), (found.candidate, found.candidate_P))[: 1 + int(found.gate[4])]:
            assert np.isfinite(found.memory).all()
            assert -math.pi < x[2] <= math.pi
            deviations = np.sqrt(P.diagonal()[free])
            assert (deviations > 0.0).all()
            correlations = P[np.ix_(free, free)] / np.outer(deviations, deviations)
            np.testing.assert_allclose(correlations, correlations.T, atol=1e-5)
            assert np.linalg.eigvalsh(0.5 * (correlations + correlations.T)).min() > -1e-9
