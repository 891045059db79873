"""The filter with two wheels' errors as states, and landmarks, against finite differences and a textbook's step."""

import math

import numpy as np
import pytest
from filter_runs import (
    SEPARATION,
    Robot,
    build_motion,
    covariance,
    gated_filter,
    jacobian,
    landmark,
    numbers_of,
    winding,
    wrapped,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2, multivariate_normal

from diffbot_control.filter.ekf import PoseEkf
from diffbot_control.filter.models import MIN_LANDMARK_DISTANCE
from diffbot_core.geometry import Point, Pose

CHECK = settings(max_examples=50)
POSES = st.tuples(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0), st.floats(-3.1, 3.1))
ERRORS = st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
TWISTS = st.tuples(st.floats(-2.0, 2.0), st.floats(-3.0, 3.0), st.floats(0.01, 0.5))
SEEDS = st.integers(0, 10_000)
CALIBRATING = ("ekf_calibrating", "ekf_fnn_calibrating")


@pytest.fixture(scope="module", autouse=True)
def straight_corrections():
    """The textbook's corrections are straight; those along an arc, of a lost heading, have tests of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("diffbot_control.filter.ekf.TURNED_VARIANCE", math.inf)
        yield


def body(v, omega, left, right, separation):
    """The twist of a body on wheels with relative radius errors, from the speeds of their rims."""
    v_l = (v - 0.5 * omega * separation) * (1.0 + left)
    v_r = (v + 0.5 * omega * separation) * (1.0 + right)
    return 0.5 * (v_l + v_r), (v_r - v_l) / separation


def midpoint(pose, v, omega, dt):
    x, y, theta = pose
    middle = theta + 0.5 * omega * dt
    return np.array([x + v * dt * math.cos(middle), y + v * dt * math.sin(middle), theta + omega * dt])


def model(state, v, omega, dt, separation):
    """The motion model of the class's docstring, written anew."""
    return np.array([*midpoint(state[:3], *body(v, omega, *state[3:], separation), dt), *state[3:]])


def calibrating(state, P, separation=SEPARATION, walk=0.0):
    ekf = PoseEkf(2)
    ekf.wheel_separation, ekf.random_walk = separation, walk
    ekf.set_state(np.array(state), P)
    return ekf


def same_pose(found, expected, tolerance=1e-9):
    np.testing.assert_allclose(found[:2], expected[:2], rtol=tolerance, atol=tolerance)
    assert wrapped(found[2] - expected[2]) == pytest.approx(0.0, abs=tolerance)
    assert -math.pi < found[2] <= math.pi
    np.testing.assert_allclose(found[3:], expected[3:], rtol=tolerance, atol=tolerance)


@CHECK
@given(POSES, ERRORS, TWISTS, SEEDS, st.floats(0.1, 2.0), st.floats(0.0, 1e-2))
def test_predict_is_the_textbook_step_of_the_documented_model(pose, errors, twist, seed, separation, walk):
    v, omega, dt = twist
    rng = np.random.default_rng(seed)
    state, P, M = (*pose, *errors), covariance(rng, 5), 0.1 * covariance(rng, 2)
    ekf = calibrating(state, P, separation, walk)
    ekf.predict(build_motion(v, omega, dt, M[0, 0], M[0, 1], M[1, 1]))
    F = jacobian(lambda s: model(s, v, omega, dt, separation), state)
    # The noise acts on the twist of the body; two wheels of other errors each gain walk dt.
    moved = body(v, omega, *errors, separation)
    G = jacobian(lambda u: midpoint(pose, u[0], u[1], dt), moved)
    Q = np.zeros((5, 5))
    Q[:3, :3] = G @ M @ G.T
    Q[3, 3] = Q[4, 4] = walk * dt
    same_pose(ekf.x, model(state, v, omega, dt, separation), 1e-12)
    np.testing.assert_allclose(ekf.F, F, atol=1e-7)
    np.testing.assert_allclose(ekf.Q, Q, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(ekf.P, F @ P @ F.T + Q, rtol=1e-6, atol=1e-6)


def of_both(rng, three, five):
    """Give both filters the same random event; return their NIS, if it was a measurement."""
    if rng.random() < 0.5:
        M = 0.1 * covariance(rng, 2)
        motion = build_motion(*rng.normal(0.0, 1.5, 2), rng.uniform(0.01, 0.4), M[0, 0], M[0, 1], M[1, 1])
        for ekf in (three, five):
            ekf.predict(motion)
        return 0.0, 0.0
    kind = rng.integers(3)
    if kind == 0:
        z, R = three.x + rng.normal(0.0, 0.3, 3), covariance(rng, 3)
        return three.update_pose(Pose(*z), R), five.update_pose(Pose(*z), R)
    if kind == 1:
        z, R = three.x[2:] + rng.normal(0.0, 0.3, 1), covariance(rng, 1)
        return three.update_heading(float(z[0]), R), five.update_heading(float(z[0]), R)
    point, R = rng.uniform(-10.0, 10.0, 2), covariance(rng, 2)
    z = numbers_of(landmark(three.x, point, R)) + rng.normal(0.0, 0.1, 2)
    return three.update_landmark(*z, R, Point(*point)), five.update_landmark(*z, R, Point(*point))


@pytest.mark.parametrize("seed", range(2))
def test_with_wheels_known_to_be_perfect_it_is_the_filter_of_three_states(seed):
    rng = np.random.default_rng(seed)
    three, five = PoseEkf(), calibrating(np.zeros(5), np.zeros((5, 5)), rng.uniform(0.2, 2.0))
    P = covariance(rng, 3)
    three.set_state(np.array([1.0, 2.0, 3.0]), P)
    five.set_state(np.array([1.0, 2.0, 3.0, 0.0, 0.0]), np.pad(P, ((0, 2), (0, 2))))
    for _ in range(100):
        one, other = of_both(rng, three, five)
        assert other == pytest.approx(one, rel=1e-9)
        same_pose(five.x, [*three.x, 0.0, 0.0])
        np.testing.assert_allclose(five.P, np.pad(three.P, ((0, 2), (0, 2))), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("wheel", "forward", "turn"), [(3, 0.5, -1.0 / 0.6), (4, 0.5, 1.0 / 0.6)])
def test_which_wheel_it_is_shows_in_one_straight_metre(wheel, forward, turn):
    # From a known pose 1 m ahead; the exact fix at its end is off by what an error of 1 % of one wheel does.
    ekf = calibrating(np.zeros(5), np.diag([0.0, 0.0, 0.0, 4e-4, 4e-4]))
    ekf.predict(build_motion(1.0, 0.0, 1.0, 0.0, 0.0, 0.0))
    z = np.array([1.0 + 0.01 * forward, 0.5 * 0.01 * turn, 0.01 * turn])
    ekf.update_pose(Pose(*z), 1e-14 * np.eye(3))
    expected = [0.0, 0.0]
    expected[wheel - 3] = 0.01
    np.testing.assert_allclose(ekf.x[3:], expected, atol=1e-4)
    assert np.sqrt(ekf.P.diagonal()[3:]).max() < 1e-6


def sight(state, point):
    """Range and bearing, written anew with complex numbers."""
    seen = (complex(*point) - complex(state[0], state[1])) * complex(math.cos(state[2]), -math.sin(state[2]))
    return np.array([abs(seen), math.atan2(seen.imag, seen.real)])


def textbook(state, P, y, H, R):
    """Kalman's update in its short form, and the NIS by the logarithm of scipy's density."""
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, H @ P).T
    nis = -2.0 * multivariate_normal(cov=S).logpdf(y) - np.linalg.slogdet(2.0 * math.pi * S)[1]
    return np.array(state) + K @ y, P - K @ S @ K.T, nis


def filters(state, rng):
    """Both filters at the same pose, with their states and covariances."""
    three, P = PoseEkf(), covariance(rng, 3)
    three.set_state(np.array(state[:3]), P)
    whole = covariance(rng, 5)
    return ((three, np.array(state[:3]), P), (calibrating(state, whole), np.array(state), whole))


@CHECK
@given(POSES, ERRORS, st.floats(0.05, 30.0), st.floats(-3.1, 3.1), SEEDS)
def test_landmark_update_is_the_textbook_s_with_a_jacobian_by_finite_differences(pose, errors, distance, angle, seed):
    rng = np.random.default_rng(seed)
    point = pose[0] + distance * math.cos(angle), pose[1] + distance * math.sin(angle)
    y, R = rng.normal(0.0, 0.2, 2), covariance(rng, 2)
    for ekf, state, P in filters((*pose, *errors), rng):
        z = sight(state, point) + y
        z[1] = wrapped(z[1])
        # About the direction itself, where the angle does not jump.
        at = sight(state, point)[1]
        steady = lambda s, at=at: np.array([sight(s, point)[0], wrapped(sight(s, point)[1] - at)])  # noqa: E731
        # What the derivatives leave out counts as noise.
        spread = P[0, 0] + P[1, 1]
        wider = R + np.diag([0.5 * (spread / distance) ** 2, (spread / distance**2) ** 2])
        x, P_after, nis = textbook(state, P, y, jacobian(steady, state), wider)
        assert ekf.update_landmark(*z, R, Point(*point)) == pytest.approx(nis, rel=1e-5, abs=1e-7)
        same_pose(ekf.x, x, 1e-6)
        np.testing.assert_allclose(ekf.P, P_after, rtol=1e-5, atol=1e-6)


@CHECK
@given(POSES, ERRORS, SEEDS)
def test_nis_of_fix_and_heading_is_that_of_scipy_s_density(pose, errors, seed):
    rng = np.random.default_rng(seed)
    for size, H in ((3, np.eye(3, 5)), (1, np.eye(5)[2:3])):
        for ekf, state, P in filters((*pose, *errors), rng):
            y, R = rng.normal(0.0, 0.5, size), covariance(rng, size)
            columns = H[:, : len(state)]
            z = columns @ state + y
            z[-1] = wrapped(z[-1])
            x, P_after, nis = textbook(state, P, y, columns, R)
            found = ekf.update_pose(Pose(*z), R) if size == 3 else ekf.update_heading(float(z[0]), R)
            assert found == pytest.approx(nis, rel=1e-8, abs=1e-10)
            same_pose(ekf.x, x)
            np.testing.assert_allclose(ekf.P, P_after, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("states", [3, 5])
def test_a_landmark_behind_goes_the_short_way_across_pi(states):
    # Straight behind, seen 0.1 rad to one side of pi by a robot that believes it to be 0.1 rad to the other.
    ekf = PoseEkf() if states == 3 else PoseEkf(2)
    ekf.set_state(
        np.array([0.0, 0.0, 0.1, *[0.0] * (states - 3)]),
        1e-12 * np.eye(states) + np.diag([0, 0, 1.0, 0, 0])[:states, :states],
    )
    nis = ekf.update_landmark(5.0, -math.pi + 0.1, np.eye(2), Point(-5.0, 0.0))
    # Expected at pi - 0.1; the innovation of 0.2 and not -6.08 turns it by -0.1.
    assert nis == pytest.approx(0.04 / 2.0)
    assert ekf.x[2] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("away", "corrected"), [(0.0, False), (0.999, False), (1.01, True)])
def test_a_landmark_under_the_robot_corrects_nothing(away, corrected):
    for ekf, state, P in filters((1.0, 2.0, 3.0, 0.01, 0.02), np.random.default_rng(0)):
        point = Point(1.0 + away * MIN_LANDMARK_DISTANCE, 2.0)
        assert math.isfinite(ekf.update_landmark(0.5, 0.1, 0.1 * np.eye(2), point)) == corrected
        # Seen from 0.5 m, so the robot stands further back than it believed.
        assert (ekf.x[0] < state[0]) == corrected
        assert (ekf.P[0, 0] < P[0, 0]) == corrected
        assert np.isfinite(ekf.x).all()


@pytest.mark.parametrize("variant", CALIBRATING)
@pytest.mark.parametrize("errors", [(0.025, -0.02), (0.0, 0.03)])
def test_radius_errors_are_found(variant, errors):
    robot = Robot(np.random.default_rng(7), errors)
    found = gated_filter(variant)
    for step in range(450):
        found.predict(robot.move(*winding(step)))
        if step % 2 == 0:
            found.take(robot.fix())
    x, P = found.memory.belief
    sigma = np.sqrt(P.diagonal()[3:])
    assert sigma.max() < 0.2 * 0.02
    assert np.abs(x[3:] - errors).max() < 3.5 * sigma.max()
    assert np.hypot(*(x[:2] - robot.truth[:2])) < 0.15


def wheel_nees(runs, claimed=0.02, steps=120):
    """Sum of e' P^-1 e of the wheels' errors, drawn with a deviation of 2 %; the trial's number is its seed."""
    total = 0.0
    for run in range(runs):
        rng = np.random.default_rng(run)
        errors = rng.normal(0.0, 0.02, 2)
        robot = Robot(rng, errors)
        found = gated_filter("ekf_calibrating", gate_probability=1.0, wheel_radius_sigma=claimed, wheel_radius_walk=0.0)
        start = robot.fix()
        found.memory = found.memory._replace(
            belief=found.memory.belief._replace(x=np.array([*numbers_of(start), 0.0, 0.0]))
        )
        for step in range(steps):
            found.predict(robot.move(*winding(step + 20 * run)))
            if step % 3 == 0:
                found.take(robot.fix())
        error = found.memory.belief.x[3:] - errors
        total += error @ np.linalg.solve(found.memory.belief.P[3:, 3:], error)
    return total


def test_the_wheels_sigma_is_honest():
    low, high = chi2.ppf([0.002, 0.998], 2 * 60)
    assert low < wheel_nees(60) < high
    # A wrong one at the start would show.
    assert wheel_nees(30, claimed=0.005) > chi2.ppf(0.998, 2 * 30)


def test_the_walk_lets_the_sigma_grow():
    walk = 1e-3
    found = gated_filter("ekf_calibrating", wheel_radius_walk=walk, wheel_radius_sigma=0.02)
    for _ in range(100):
        found.predict(build_motion(0.0, 0.0, 0.1, 1e-6, 0.0, 1e-6))
    # 1e-3 per sqrt(s) for 10 s on top of 2 %.
    assert found.memory.belief.P[3, 3] == pytest.approx(0.02**2 + 10.0 * walk**2)


def test_an_impossible_error_of_a_wheel_is_forgotten():
    # 5 sigma of 2 % is 10 %; one that slips by 60 % is taken for a radius only until then.
    found = gated_filter("ekf_calibrating", gate_probability=1.0, wheel_radius_sigma=0.02)
    robot = Robot(np.random.default_rng(1), (-0.6, 0.0))
    forgotten = 0
    for _ in range(80):
        before = found.memory.belief.x[3:]
        found.predict(robot.move(1.0, 0.05))
        found.take(robot.fix())
        x, P = found.memory.belief
        assert np.abs(x[3:]).max() <= 0.1
        if np.abs(before).max() > 0.05 and not x[3:].any():
            forgotten += 1
            np.testing.assert_array_equal(P[3:, 3:], 0.02**2 * np.eye(2))
            assert not P[3:, :3].any()
            assert not P[:3, 3:].any()
    assert forgotten > 0
