"""Prediction, correction, gate and relocation of the filter, compared with textbook equations and scipy."""

import math

import numpy as np
import pytest
from filter_runs import (
    R_FIX,
    ROWS,
    assert_state,
    build_motion,
    covariance,
    fix,
    jacobian,
    measured,
    moved,
    options,
    process_noise,
    reading,
    started,
    textbook,
    wrapped,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import chdtrc, chdtri
from scipy.stats import chi2

from diffbot_control.filter import ekf, models, state
from diffbot_control.filter.consistency import chi_square_bound, survival
from diffbot_control.filter.ekf import ACCEPTED, IGNORED, REJECTED, RELOCATED, WEIGHED
from diffbot_core.geometry import Point

PLACES = (Point(5.0, 3.0),)
SMALL_WALK = 1e-4**2
CONFIGS = {
    3: ({"filter": "ekf"}, ()),
    6: ({"filter": "ekf_calibrating"}, ()),
    7: ({"filter": "ekf_calibrating", "use_gyro": True}, ()),
    10: ({"filter": "ekf_calibrating", "use_gyro": True}, PLACES),
}


def filled(n, seed, **values):
    """Return a filter of n states with small errors and a full covariance that keeps its corrections straight."""
    config, places = CONFIGS[n]
    numbers, rng = options(places, **{**config, "detect_correlation": False, **values}), np.random.default_rng(seed)
    found = started(numbers, landmarks=len(places))
    found.x[:] = [*rng.uniform(-3.0, 3.0, 3), *rng.uniform(-0.05, 0.05, n - 3)]
    found.P[:, :] = covariance(rng, n, 0.02, 0.18)
    return found, numbers, rng


@pytest.mark.parametrize("n", [3, 6, 7, 10])
@pytest.mark.parametrize("with_gyro", [False, True])
def test_the_prediction_is_the_textbook_prediction_with_random_walks_of_the_errors(n, with_gyro):
    for seed in range(10):
        found, numbers, rng = filled(n, seed)
        x, P, M = found.x.copy(), found.P.copy(), covariance(rng, 2, 0.05, 0.3)
        rate = models.TurnRate(0.4, 0.02) if with_gyro else models.NO_RATE
        motion = build_motion(*rng.normal(size=2), 0.2, M[0, 0], M[0, 1], M[1, 1], rate=rate, lateral=0.01)
        ekf.predict(found, numbers, motion)
        F, Q = jacobian(lambda s: moved(s, motion), x), process_noise(x, motion)  # noqa: B023
        walking = range(3, min(n, 7))
        Q[walking, walking] += SMALL_WALK * 0.2
        assert_state(found, moved(x, motion), F @ P @ F.T + Q, 1e-8)


def test_known_errors_have_no_random_walk():
    numbers = options(PLACES, filter="ekf_calibrating", wheel_separation_sigma=0.0, left_radius_error=0.02)
    found = started(numbers, landmarks=1)
    ekf.predict(found, numbers, build_motion(0.5, 0.3, 0.2, 1e-3, 0.0, 1e-3))
    assert found.P[5:7, 5:7].tolist() == [[0.0, 0.0], [0.0, 0.0]]
    np.testing.assert_allclose(np.diag(found.P)[3:], [*[1e-4 + 2e-9] * 2, 0.0, 0.0, 0.05**2, 1e-4, 1e-4], rtol=1e-9)
    assert found.x[3:].tolist() == [0.02, *[0.0] * 6]


KINDS = [(kind, n) for kind in (models.POSE_FIX, models.POSITION_FIX, models.HEADING) for n in (3, 10)]
KINDS += [(kind, 10) for kind in (models.LANDMARK, models.RANGE, models.BEARING)]


@pytest.mark.parametrize(("kind", "n"), KINDS)
@pytest.mark.parametrize("factor", [0.5, 0.999, 1.001, 400.0])
def test_the_correction_is_the_textbook_correction_reduced_by_bound_over_nis_beyond_the_gate(kind, n, factor):
    for seed in range(5):
        found, numbers, rng = filled(n, seed, gate_probability=0.99, wheel_radius_sigma=0.2, wheel_separation_sigma=0.2)
        x, P, rows = found.x.copy(), found.P.copy(), ROWS[kind]
        H = jacobian(lambda s: measured(kind, s, PLACES[0]), x)
        R, y = covariance(rng, len(rows), 0.05, 0.2), rng.normal(size=len(rows))
        noise = R.copy()
        if kind in (models.LANDMARK, models.RANGE, models.BEARING):
            d = math.hypot(PLACES[0].x - x[0], PLACES[0].y - x[1])
            spread = P[0, 0] + P[1, 1]
            linear = np.diag([(1.0 + x[8]) ** 2 * spread**2 / (2.0 * d**2), spread**2 / d**4])
            noise = R + linear[np.ix_(rows, rows)]
        # The NIS is ``factor`` times the bound. Innovations of angles that would wrap are left out.
        bound = chi2.ppf(0.99, len(rows))
        y *= math.sqrt(factor * bound / textbook(x, P, y, H, noise)[2])
        angle = {models.POSE_FIX: 2, models.HEADING: 0, models.LANDMARK: 1, models.BEARING: 0}.get(kind)
        if angle is not None and abs(y[angle]) > 3.0:
            continue
        z = measured(kind, x, PLACES[0]) + y
        if angle is not None:
            z[angle] = wrapped(z[angle])
        one = reading(kind, z, R, at=PLACES[0])
        outcome = ekf.take(found, numbers, one)
        assert found.last[one.place, [state.NIS, state.OUTCOME]] == pytest.approx([factor * bound, outcome], rel=1e-6)
        x_after, P_after, _ = textbook(x, P, y, H, noise)
        if factor < 1.0:
            assert outcome == ACCEPTED
            assert_state(found, x_after, P_after, 1e-7)
        elif kind in (models.POSE_FIX, models.POSITION_FIX):
            assert outcome == REJECTED
            assert_state(found, x, P, 0.0)
        else:
            assert outcome == WEIGHED
            assert_state(found, x + (x_after - x) / factor, P + (P_after - P) / factor, 1e-7)


@pytest.mark.parametrize("y_theta", [1.2, -0.2, -0.1], ids=["large turn", "small turn", "no turn"])
def test_a_correction_moves_along_an_arc_if_the_heading_is_uncertain(y_theta):
    P, R = np.diag([0.5, 0.4, 0.9]), np.diag([0.1, 0.2, 0.3])
    P[0, 2] = P[2, 0] = 0.3
    x, y, numbers = np.array([1.0, 2.0, 0.5]), np.array([0.5, -0.4, y_theta]), options(filter="ekf")
    found = started(numbers, x, P)
    assert ekf.take(found, numbers, fix(*(x + y), R)) == ACCEPTED
    straight, P_after, _ = textbook(x, P, y, np.eye(3), R)
    dx, dy, turn = straight - x
    # The arc is the sum of many small steps.
    along = (dx + 1j * dy) * np.exp(1j * turn * (np.arange(20_000) + 0.5) / 20_000).mean()
    c, s = math.cos(turn), math.sin(turn)
    T = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    assert_state(found, [1.0 + along.real, 2.0 + along.imag, 0.5 + turn], T @ P_after @ T.T, 1e-8)


@pytest.mark.parametrize("dof", [1, 2, 3, 10, 99, 150])
def test_chi_square_bounds_and_probabilities_equal_those_of_scipy(dof):
    for tail in (0.999, 0.975, 0.5, 0.025, 1e-3, 1e-4, 1e-9, 1e-15):
        assert chi_square_bound(dof, tail) == pytest.approx(float(chdtri(dof, tail)), rel=1e-12)
    for x in (0.0, 1e-6, 0.3, 1.0, float(dof), 3.0 * dof, 700.0):
        assert survival(x, dof) == pytest.approx(float(chdtrc(dof, x)), rel=1e-12, abs=1e-300)


def test_the_slack_widens_the_gate_for_fixes_only():
    numbers, slack = options(filter="ekf"), 0.7
    x = math.sqrt(math.exp(slack) * chi2.ppf(0.999, 3) * 2.0 * R_FIX[0, 0])
    theta = math.sqrt(chi2.ppf(0.999, 1) * 2.0 * R_FIX[2, 2])
    for measurement, outcome in (
        (fix(0.999 * x), ACCEPTED),
        (fix(1.001 * x), REJECTED),
        (reading(models.HEADING, [1.01 * theta], R_FIX[2:, 2:]), WEIGHED),
    ):
        found = started(numbers, P=R_FIX)
        found.gate[state.SLACK] = slack
        assert ekf.take(found, numbers, measurement) == outcome


TRIES = st.lists(st.tuples(st.sampled_from((0, 0, 1, 2)), st.floats(0.0, 1.0)), max_size=40)


@settings(max_examples=100)
@given(TRIES, st.integers(2, 4))
def test_the_gate_rejects_relocates_and_widens_according_to_the_rejection_streak(tries, needed):
    numbers = options(filter="ekf", relocation_fixes=needed, detect_correlation=False)
    found, here, rejected, slack = started(numbers, P=1e-4 * np.eye(3)), 0, [], 0.0
    time = 0.0
    for place, dt in tries:
        ekf.predict(found, numbers, build_motion(0.0, 0.0, dt, 0.0, 0.0, 0.0))
        time += dt
        outcome = ekf.take(found, numbers, fix(1e6 * place, R=1e-4 * np.eye(3)))
        if place == here:
            assert outcome == ACCEPTED
            rejected, slack = [], max(slack - 0.05, 0.0)
        else:
            rejected.append((place, time))
            slack += 0.2
            agreeing = 1
            while agreeing < len(rejected) and rejected[-1 - agreeing][0] == place:
                agreeing += 1
            since = time - rejected[0][1]
            if abs(since - 1.5) < 1e-9:
                return  # rounding decides
            if agreeing >= needed or (len(rejected) >= needed and since > 1.5):
                assert outcome == RELOCATED
                slack = max(slack - 0.2 * agreeing, 0.0) if agreeing >= needed else slack
                here, rejected = place, []
            else:
                assert outcome == REJECTED
        assert found.x[0] == pytest.approx(1e6 * here, abs=1.0)
        assert found.gate[state.SLACK] == pytest.approx(slack, abs=1e-9)


@pytest.mark.parametrize("kind", [models.POSE_FIX, models.POSITION_FIX])
@pytest.mark.parametrize("n", [3, 10])
def test_a_relocated_filter_equals_a_filter_that_started_with_the_first_rejected_fix(kind, n):
    found, numbers, rng = filled(n, 1)
    m, R = len(ROWS[kind]), covariance(rng, 3, 0.1, 0.2)
    z, second = np.array([70.0, -40.0, 1.0]), started(numbers, landmarks=n == 10)
    for step in range(3):
        motion = build_motion(0.5, 0.2, 0.1, 1e-3, 1e-4, 1e-3)
        for one in (found, second):
            ekf.predict(one, numbers, motion)
        one = reading(kind, (z + rng.normal(0.0, 0.05, 3))[:m], R[:m, :m])
        if step == 0:
            # The errors of the sensors stay, and with a position also the heading, without any correlation.
            second.x[:], second.P[:, :] = found.x, 0.0
            second.x[:m], second.P[:3, :3] = one.z, np.diag([0.0, 0.0, math.pi**2])
            second.P[:m, :m], second.P[3:, 3:] = one.R, found.P[3:, 3:]
        else:
            assert ekf.take(second, numbers, one) == ACCEPTED
        assert ekf.take(found, numbers, one) == (RELOCATED if step == 2 else REJECTED)
    assert_state(found, second.x, second.P, 1e-9)
    assert found.gate[state.HAS_CANDIDATE] == found.gate[state.REJECTIONS] == 0.0


@pytest.mark.parametrize("kind", [models.LANDMARK, models.RANGE, models.BEARING])
@pytest.mark.parametrize(("away", "outcome"), [(0.0, IGNORED), (0.999, IGNORED), (1.01, ACCEPTED)])
def test_a_landmark_at_the_position_of_the_robot_is_ignored(kind, away, outcome):
    numbers, m = options(PLACES, gate_probability=1.0), len(ROWS[kind])
    found = started(numbers, (1.0, 2.0, 3.0), 0.1 * np.eye(3), 1)
    before, at = found.memory.copy(), (1.0 + away * models.MIN_LANDMARK_DISTANCE, 2.0)
    assert ekf.take(found, numbers, reading(kind, [0.5, 0.1][:m], 0.1 * np.eye(m), at=at)) == outcome
    assert np.array_equal(found.memory, before) == (outcome == IGNORED)
    assert np.isfinite(found.memory).all()


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_measurement_that_is_not_finite_or_has_a_singular_covariance_is_rejected(value):
    numbers = options(PLACES)
    found = started(numbers, landmarks=1)
    x, P = found.x.copy(), found.P.copy()
    with np.errstate(invalid="ignore"):
        assert ekf.take(found, numbers, fix(value)) == REJECTED
        assert ekf.take(found, numbers, reading(models.HEADING, [math.nan], np.eye(1))) == REJECTED
    assert_state(found, x, P, 0.0)
    assert ekf.take(found, numbers, fix(0.0)) == ACCEPTED
    found.P[:3, :3] = 0.0
    x, P = found.x.copy(), found.P.copy()
    assert ekf.take(found, numbers, fix(0.1, R=np.zeros((3, 3)))) == REJECTED
    assert_state(found, x, P, 0.0)
