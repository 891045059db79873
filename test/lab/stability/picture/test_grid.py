"""At a point of the grid no admissible noise does worse than the picture says, and without noise it is exact.

Between the points it may: a counterexample.
"""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.law.lyapunov_law import PAPER_GAINS, Gains, global_law, heading_hold
from diffbot_control.law.polar_coordinates import discrete_model, in_front, navigation_variables
from diffbot_control.law.presets import PAPER, PRESETS
from diffbot_control.law.regions import FixedRegionPolicy, RegionPolicy
from diffbot_core.geometry import Pose
from diffbot_lab.stability.level.bounds import LevelProblem
from diffbot_lab.stability.level.witness import Witness, levels
from diffbot_lab.stability.picture.grid import (
    Grid,
    evaluate_grid,
    heading_bound,
    highest_rise,
    level_of,
    make_grid,
    worst_rate,
)
from diffbot_lab.stability.settings import NoiseBox, noise_box
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig

PAPER_BOX = NoiseBox(0.3, 0.3, 0.17, 0.065, 0.2167)
NO_NOISE = NoiseBox(0.0, 0.0, 0.0, 0.0, 0.0)
T_S = 0.1


def wrapped(angles):
    return math.pi - np.remainder(math.pi - np.asarray(angles), 2.0 * math.pi)


def textbook_law(rho, alpha, beta, gains):
    """Eq. (13) with v along the robot's real axis."""
    v = gains.gamma * np.tanh(rho) * np.cos(alpha)
    slope = np.where(rho > 1e-9, np.tanh(rho) / np.maximum(rho, 1e-9), 1.0)
    turn = gains.gamma * np.sinc(alpha / math.pi) * slope * np.cos(alpha)
    return v, gains.k * alpha + turn * (alpha + gains.h * beta)


def textbook_rate(state, noise, gains, t_s):
    """Change of V of Eq. (8) in one step of (6), (7), over Ts, with what is measured of the pose wrong by ``noise``."""
    rho, alpha, beta = state
    eps_x, eps_y, eps_theta, eps_v, eps_omega = noise
    x, y, theta = -rho * np.cos(beta) + eps_x, -rho * np.sin(beta) + eps_y, beta - alpha + eps_theta
    bearing = wrapped(np.arctan2(0.0 - y, 0.0 - x))
    v, omega = textbook_law(np.hypot(x, y), wrapped(bearing - theta), bearing, gains)
    v, omega = v + eps_v, omega + eps_omega
    after = (
        rho - v * t_s * np.cos(alpha),
        wrapped(alpha + v * t_s * np.sin(alpha) / rho - omega * t_s),
        wrapped(beta + v * t_s * np.sin(alpha) / rho),
    )
    before, then = (0.5 * (r**2 + a**2 + gains.h * b**2) for r, a, b in (state, after))
    return (then - before) / t_s


def random_states(rng, number):
    """Near and far, with a quarter of the angles close to the cut."""
    rho = np.exp(rng.uniform(math.log(1e-3), math.log(20.0), number))
    angles = rng.uniform(-math.pi, math.pi, (2, number))
    close = rng.random((2, number)) < 0.25
    angles[close] = wrapped(math.pi + rng.normal(0.0, 0.1, close.sum()))
    return rho, *angles


def random_noise(rng, box, number, each):
    """Uniform within the box, and as many of its corners."""
    inside = rng.uniform(-1.0, 1.0, (5, each, number))
    corners = rng.choice([-1.0, 1.0], (5, each, number))
    return np.concatenate([inside, corners], axis=1) * np.array(box)[:, None, None]


def assert_no_noise_does_worse(rng, gains, box, t_s, number, each):
    state = random_states(rng, number)
    bound = worst_rate(Grid(*state), gains, box, t_s)
    rates = textbook_rate(state, random_noise(rng, box, number, each), gains, t_s)
    excess = rates.max(axis=0) - bound
    assert bound.shape == (number,)
    assert np.isfinite(bound).all()
    # Rounding of V over Ts.
    slack = 1e-12 * (level_of(Grid(*state), gains) + 100.0) / t_s
    worst = int(np.argmax(excess - slack))
    assert (excess <= slack).all(), ([float(one[worst]) for one in state], gains, box, t_s, excess[worst])
    return rates.max(axis=0), bound


BOXES = {
    "paper's": PAPER_BOX,
    "none": NO_NOISE,
    "position only": NoiseBox(0.5, 0.1, 0.0, 0.0, 0.0),
    "heading only": NoiseBox(0.0, 0.0, 0.8, 0.0, 0.0),
    "all headings": NoiseBox(0.0, 0.0, math.pi, 0.0, 0.0),
    "input only": NoiseBox(0.0, 0.0, 0.0, 0.2, 0.5),
    "large": NoiseBox(3.0, 1.0, 2.0, 1.0, 4.0),
    "tiny": NoiseBox(1e-6, 1e-6, 1e-6, 1e-6, 1e-6),
}


@pytest.mark.parametrize("name", BOXES)
@pytest.mark.parametrize(
    "gains", [PAPER_GAINS, Gains(1.0, 8.0, 2.0, 2.7), Gains(0.3, 0.1, 0.05, 1.0)], ids=["a", "b", "c"]
)
def test_no_admissible_noise_does_worse(name, gains):
    assert_no_noise_does_worse(np.random.default_rng(1), gains, BOXES[name], T_S, 4000, 30)


def test_no_admissible_noise_does_worse_with_long_steps():
    # Steps that turn by more than a whole turn, and run past the goal.
    assert_no_noise_does_worse(np.random.default_rng(2), PAPER_GAINS._replace(k=20.0), PAPER_BOX, 1.0, 4000, 30)


small = st.floats(0.0, 1.0)


@given(
    st.builds(Gains, st.floats(0.05, 5.0), st.floats(0.01, 15.0), st.floats(0.01, 5.0), st.just(2.7)),
    st.builds(NoiseBox, small, small, st.floats(0.0, 3.5), small, st.floats(0.0, 3.0)),
    st.floats(0.001, 0.5),
    st.integers(0, 2**32),
)
@settings(max_examples=60)
def test_no_noise_does_worse_for_any_gains_and_bounds(gains, box, t_s, seed):
    assert_no_noise_does_worse(np.random.default_rng(seed), gains, box, t_s, 300, 20)


# On the cut itself rounding decides on which side each of the two models is.
OFF_THE_CUT = st.floats(-math.pi + 1e-6, math.pi - 1e-6)


@given(st.floats(1e-3, 30.0), OFF_THE_CUT, OFF_THE_CUT, st.tuples(*[st.floats(-1.0, 1.0)] * 5))
@settings(max_examples=400)
def test_no_noise_does_worse_with_the_projects_own_law_and_models(rho, alpha, beta, share):
    gains = PAPER_GAINS
    noise = [one * bound for one, bound in zip(share, PAPER_BOX, strict=True)]
    x, y, theta = -rho * math.cos(beta), -rho * math.sin(beta), beta - alpha
    measured = navigation_variables(Pose(x + noise[0], y + noise[1], float(wrapped(theta + noise[2]))))
    command = global_law(measured, gains)
    navigation = navigation_variables(Pose(x, y, float(wrapped(theta))))._replace(rho=rho, alpha=alpha, beta=beta)
    sign = 1.0 if in_front(alpha) else -1.0  # the models count v along the paper's forward direction
    after = discrete_model(navigation, sign * command.v, command.omega, T_S, sign * noise[3], noise[4])
    levels = [0.5 * (r**2 + a**2 + gains.h * b**2) for r, a, b in (navigation, after)]
    ours = float(textbook_rate((rho, alpha, beta), noise, gains, T_S))
    assert (levels[1] - levels[0]) / T_S == pytest.approx(ours, abs=1e-9 * (1.0 + levels[0]))
    point = Grid(np.array([rho]), np.array([alpha]), np.array([beta]))
    assert ours <= worst_rate(point, gains, PAPER_BOX, T_S)[0] + 1e-10 * (1.0 + levels[0])


def test_without_noise_it_is_the_closed_form():
    # dV/dt = -gamma rho tanh(rho) cos(alpha)^2 - k alpha^2, up to O(Ts).
    rng = np.random.default_rng(3)
    gains = Gains(1.1, 2.0, 0.4, 2.7)
    rho = rng.uniform(0.3, 12.0, 3000)
    alpha, beta = rng.uniform(-3.0, 3.0, (2, 3000))
    expected = -gains.gamma * rho * np.tanh(rho) * np.cos(alpha) ** 2 - gains.k * alpha**2
    errors = [np.abs(worst_rate(Grid(rho, alpha, beta), gains, NO_NOISE, t_s) - expected).max() for t_s in (1e-3, 1e-4)]
    assert errors[0] < 0.3
    assert errors[1] == pytest.approx(0.1 * errors[0], rel=0.05)


def test_without_noise_it_is_the_very_step():
    state = random_states(np.random.default_rng(4), 3000)
    exact = textbook_rate(state, np.zeros((5, 1)), PAPER_GAINS, T_S)
    inside = np.abs(exact) < 1e3  # beside the cut what is measured may be on either side of it by rounding alone
    away = inside & (np.abs(state[1]) < 3.1) & (np.abs(state[2]) < 3.1)
    bound = worst_rate(Grid(*state), PAPER_GAINS, NO_NOISE, T_S)
    crossing = bound - exact > 1e-6
    assert crossing[away].mean() < 0.1  # a step across the cut is bounded by pi^2
    assert bound[away & ~crossing] == pytest.approx(exact[away & ~crossing], abs=1e-6)


def test_with_little_noise_it_is_not_far_off():
    rng = np.random.default_rng(5)
    box = NoiseBox(1e-3, 1e-3, 1e-3, 1e-3, 1e-3)
    rho = rng.uniform(1.0, 10.0, 2000)
    alpha, beta = rng.uniform(-2.5, 2.5, (2, 2000))
    rates = textbook_rate((rho, alpha, beta), random_noise(rng, box, 2000, 200), PAPER_GAINS, T_S).max(axis=0)
    gap = worst_rate(Grid(rho, alpha, beta), PAPER_GAINS, box, T_S) - rates
    assert (gap >= 0.0).all()
    assert gap.max() < 0.1
    assert np.median(gap) < 0.02


def test_more_noise_is_never_better():
    grid = make_grid(8.0, 15)
    rates = [
        worst_rate(grid, PAPER_GAINS, NoiseBox(*(scale * np.array(PAPER_BOX))), T_S) for scale in (0.0, 0.3, 1.0, 3.0)
    ]
    for less, more in itertools.pairwise(rates):
        assert (more >= less - 1e-9).all()
        assert (more > less).mean() > 0.9


def test_the_grid():
    rho, alpha, beta = make_grid(12.0, 21)
    assert (rho.shape, alpha.shape, beta.shape) == ((21, 1, 1), (1, 21, 1), (1, 1, 21))
    assert rho.max() == 12.0
    assert rho.min() > 0.0
    assert (np.diff(np.diff(rho.ravel())) > 0.0).all()
    for angles in (alpha.ravel(), beta.ravel()):
        assert angles[-1] == pytest.approx(math.pi)
        assert angles[0] > -math.pi
        assert np.diff(angles) == pytest.approx(np.full(20, 2.0 * math.pi / 21.0))


def test_the_level_is_the_highest_that_fails():
    assert highest_rise(np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.1, -1.0])) == 2.0
    assert highest_rise(np.array([1.0, 2.0, 3.0]), np.array([-1.0, -1.0, 0.0])) == 3.0
    assert highest_rise(np.array([1.0, 2.0]), np.array([-1.0, -1.0])) == 0.0


def test_between_the_points_v_increases_above_the_level_of_the_grid():
    """The counterexample that withdrew the picture's claim to hold for all states."""
    level = evaluate_grid(PRESETS[PAPER], PAPER_BOX, T_S, 12.0, 81)["level"]
    assert level == pytest.approx(15.523, abs=1e-3)
    problem = LevelProblem(*PAPER_GAINS[:3], T_S, *PAPER_BOX, exact_arc=False)
    before, after = levels(Witness(5.259, -2.893, -2.176, 0.3, -0.3, 0.17, 0.065, -0.2167), problem)
    assert before == pytest.approx(18.4157, abs=1e-4)
    assert after == pytest.approx(18.4238, abs=1e-4)
    # In the paper's polar model, too.
    noise = np.array([0.3, -0.3, 0.17, 0.065, -0.2167])
    assert T_S * textbook_rate((5.259, -2.893, -2.176), noise, PAPER_GAINS, T_S) == pytest.approx(0.0073, abs=1e-4)


def test_at_the_points_no_noise_lifts_v_above_the_level():
    grid = make_grid(12.0, 31)
    computed = evaluate_grid(PRESETS[PAPER], PAPER_BOX, T_S, 12.0, 31)
    assert computed["inside_grid"]
    rng = np.random.default_rng(6)
    shape = np.broadcast(*grid).shape
    state = [np.broadcast_to(one, shape).ravel() for one in grid]
    level = level_of(Grid(*state), PAPER_GAINS)
    rates = textbook_rate(state, random_noise(rng, PAPER_BOX, len(level), 8), PAPER_GAINS, T_S)
    assert (rates[:, level > computed["level"]] < 0.0).all()
    # It does not hold trivially: below, noise does lift V.
    assert (rates > 0.0).any()
    assert 0.0 < computed["share_decreasing"] < 1.0


def test_without_noise_v_decreases_nearly_everywhere():
    computed = evaluate_grid(PRESETS[PAPER], NO_NOISE, 1e-3, 12.0, 31)
    assert computed["share_decreasing"] > 0.95
    assert computed["radius_condition"] == 0.0


@pytest.mark.parametrize("k_2", [0.5, 2.7, 10.0, 14.0, 19.0])
def test_the_bound_of_the_heading_is_reached_and_not_passed(k_2):
    gains = PAPER_GAINS._replace(k_2=k_2)
    bound = heading_bound(gains, PAPER_BOX, T_S)
    # The worst noise pushes to the side on which the noiseless loop will be.
    theta = 0.0
    largest = []
    for _ in range(3000):
        side = 1.0 if (1.0 - k_2 * T_S) * theta >= 0.0 else -1.0
        theta += T_S * (heading_hold(theta - side * PAPER_BOX.eps_theta, gains) + side * PAPER_BOX.eps_omega)
        largest.append(abs(theta))
    assert max(largest) == pytest.approx(bound, rel=1e-9)
    # Any other admissible noise stays below, from whatever heading within the bound.
    rng = np.random.default_rng(7)
    theta = rng.uniform(-bound, bound, 1000)
    for _ in range(300):
        measured = theta + rng.uniform(-1.0, 1.0, 1000) * PAPER_BOX.eps_theta
        theta = theta + T_S * (-k_2 * measured + rng.uniform(-1.0, 1.0, 1000) * PAPER_BOX.eps_omega)
        assert np.abs(theta).max() <= bound


@pytest.mark.parametrize("k_2", [20.0, 25.0, 1000.0])
def test_a_loop_that_does_not_contract_has_no_bound(k_2):
    assert heading_bound(PAPER_GAINS._replace(k_2=k_2), PAPER_BOX, T_S) == math.inf


def test_the_box_is_what_plant_and_sensors_do():
    plant = PlantConfig(exact_arc=False, drive_noise=0.0, eps_v_max=0.065, eps_omega_max=0.2167)
    assert noise_box(plant, SensorConfig(), PRESETS[PAPER]) == pytest.approx(PAPER_BOX)
    # Section 4.1: 5 % of each wheel at 1.3 m/s are 0.065 m/s and 0.2167 rad/s.
    box = noise_box(PlantConfig(drive_noise=0.05), SensorConfig(0.0, 0.1, 0.2, 0.3), PRESETS[PAPER])
    assert box == pytest.approx((0.1, 0.2, 0.3, 0.065, 0.21667), abs=1e-5)
    assert box.eps_position == pytest.approx(math.sqrt(0.05))


def test_in_pieces_the_grid_is_the_same(monkeypatch):
    whole = evaluate_grid(PRESETS[PAPER], PAPER_BOX, T_S, 12.0, 21)
    monkeypatch.setattr("diffbot_lab.stability.picture.grid._POINTS_AT_A_TIME", 1000)
    pieces = evaluate_grid(PRESETS[PAPER], PAPER_BOX, T_S, 12.0, 21)
    for key, value in whole.pop("maps").items():
        np.testing.assert_array_equal(pieces["maps"][key], value)
    assert {key: pieces[key] for key in whole} == whole
    # The figures follow from all points of the grid.
    grid = make_grid(12.0, 21)
    worst, level = worst_rate(grid, PAPER_GAINS, PAPER_BOX, T_S), level_of(grid, PAPER_GAINS)
    bad = worst >= 0.0
    assert whole["level"] == level[bad].max()
    distance = math.sqrt(2.0 * (level[bad].max() + T_S * worst[bad].max()))
    assert whole["distance_of_level"] == pytest.approx(distance, rel=1e-12)
    assert whole["share_decreasing"] == pytest.approx((~bad).mean(), abs=1e-12)
    assert whole["largest_distance_without_decrease"] == np.broadcast_to(grid.rho, bad.shape)[bad].max()


def test_the_leaving_radius_does_not_matter():
    policies = (RegionPolicy(fixed=FixedRegionPolicy(0.5, leave)) for leave in (0.5, 0.9))
    one, other = (
        evaluate_grid(PRESETS[PAPER]._replace(region_policy=policy), PAPER_BOX, T_S, 5.0, 11) for policy in policies
    )
    assert one["level"] == other["level"]
