"""The checker's own bounds hold the robot's law, limits, switch and plant."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.law.braking_step import braking_step
from diffbot_control.law.configuration import ControllerConfig, ControllerMemory
from diffbot_control.law.finish import (
    V_LEG,
    Finish,
    Standing,
    fastest_leg,
    finish_command,
    is_leg,
    longest_reach,
    next_finish,
)
from diffbot_control.law.polar_coordinates import Navigation, navigation_variables
from diffbot_control.law.regions import OMEGA_L, Switching
from diffbot_control.law.speed_profile import vagueness_of
from diffbot_control.law.steering import BACK, FRONT, drive_and_hold, drive_and_steer, led_by
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty
from diffbot_lab.stability.tuned.check.cells import Cells, keeps_below, rank_at
from diffbot_lab.stability.tuned.check.commands import command_of, numbers_of, sinc_range
from diffbot_lab.stability.tuned.check.near import farthest_of_ring, leaving_radius
from diffbot_lab.stability.tuned.check.steps import Box, after, clipped, motion_of, slice_count, slice_of, with_beta
from diffbot_lab.stability.tuned.contract import Contract
from diffbot_sim.model.philox import Draw
from diffbot_sim.model.plant import PlantConfig, new_plant, plant_step

CONFIG = ControllerConfig()
GAINS, SHEET = CONFIG.profile_gains, CONFIG.data_sheet
CONTRACT = Contract(sigma_max=0.05)
LOOP = numbers_of(CONFIG, CONTRACT)
SLOWING = vagueness_of(CONTRACT.sigma_max, GAINS, CONFIG.tolerance.xy_goal_tolerance)
"""by the largest deviation of the contract"""
PLANT = PlantConfig()
ROUNDING = 1e-12


def moved(pose, command, left, right):
    return plant_step(new_plant(pose), command, Draw(left, right, 0.0, 0.0), PLANT).pose


def measured(pose, errors):
    x, y, theta = errors
    share = CONTRACT.eps_position / max(1.0, math.hypot(x, y))
    return Pose(
        pose.x + share * x,
        pose.y + share * y,
        wrap_angle(pose.theta + CONTRACT.eps_theta * theta),
    )


def images_of(box, width):
    """Boxes after one step, as the check of the cells makes them."""
    parts = slice_count(LOOP, box, width)
    for part in range(parts):
        one = slice_of(LOOP, box, part, parts)
        for others in (-1, 0, 1):
            d0, d1, p, q = with_beta(LOOP, box, one, others)
            for turns in (-1, 0, 1):
                alpha, beta = clipped(p, q, turns), clipped(box.b0 + d0, box.b1 + d1, others)
                if one.possible and d0 <= d1 and alpha[0] <= alpha[1] and beta[0] <= beta[1]:
                    command = command_of(LOOP, (one.near, one.far), alpha, beta)
                    yield after(box, *motion_of(LOOP, command))


def near_or_around(angle, low, high):
    return any(low - ROUNDING <= angle + 2.0 * math.pi * turn <= high + ROUNDING for turn in (-1, 0, 1))


def test_commands_of_the_law_are_inside_their_bounds():
    rng = np.random.default_rng(1)
    for _ in range(1500):
        near = rng.uniform(0.05, 12.0) ** rng.choice([1.0, 3.0]) % 12.0 + 0.02
        alpha, beta = rng.uniform(-math.pi, math.pi, 2)
        wide = 0.2 * rng.uniform(size=3)
        low, high = np.array([near, alpha, beta]), np.array([near, alpha, beta]) + wide
        high[1:] = np.minimum(high[1:], math.pi)
        bounds = command_of(LOOP, *zip(low, high, strict=True))
        for share in (*np.eye(3), *rng.uniform(size=(4, 3)), np.zeros(3), np.ones(3)):
            at = Navigation(*(low + share * (high - low)))
            v, omega = drive_and_steer(at, rng.choice([0.0, SLOWING]), FRONT, GAINS, SHEET)
            assert bounds.v0 - ROUNDING <= v <= bounds.v1 + ROUNDING, (low, high, at)
            assert bounds.w0 - ROUNDING <= omega <= bounds.w1 + ROUNDING, (low, high, at)


def test_bounds_of_a_command_without_width_are_the_command():
    rng = np.random.default_rng(4)
    loop = LOOP._replace(slow_react=LOOP.react)
    for _ in range(300):
        at = Navigation(rng.uniform(0.1, 5.0), *rng.uniform(-math.pi, math.pi, 2))
        bounds = command_of(loop, *((value, value) for value in at))
        v, omega = drive_and_steer(at, 0.0, FRONT, GAINS, SHEET)
        assert bounds == pytest.approx((v, v, omega, omega), abs=1e-7)


def test_bounds_of_sinc_against_many_points():
    rng = np.random.default_rng(5)
    for low, high in np.sort(rng.uniform(-6.9, 6.9, (300, 2)), axis=1):
        values = np.sinc(np.linspace(low, high, 5001) / math.pi)
        assert sinc_range(low, high) == pytest.approx((values.min(), values.max()), abs=1e-5)
        assert sinc_range(low, high)[0] <= values.min()
        assert sinc_range(low, high)[1] >= values.max()


@pytest.mark.parametrize("leading", [FRONT, BACK])
def test_states_after_a_step_are_in_the_images_of_their_cell_whichever_end_leads(leading):
    rng = np.random.default_rng(2 + leading)
    for _ in range(120):
        rho = rng.choice([rng.uniform(0.3, 1.0), rng.uniform(1.0, 12.0)])
        alpha, beta = rng.uniform(-math.pi, math.pi - 0.1, 2)
        box = Box(rho, rho + 0.01, alpha, alpha + 0.04, beta, beta + 0.1)
        boxes = list(images_of(box, 0.1))
        for _ in range(12):
            r, a, b = (rng.uniform(low, high) for low, high in zip(box[::2], box[1::2], strict=True))
            turned = 0.0 if leading == FRONT else math.pi
            pose = Pose(-r * math.cos(b + turned), -r * math.sin(b + turned), wrap_angle(b - a))
            errors = np.sign(rng.uniform(-1.0, 1.0, 3)) * rng.choice([1.0, rng.uniform()])
            seen = led_by(navigation_variables(measured(pose, errors)), leading)
            command = drive_and_steer(seen, SLOWING * rng.uniform(), leading, GAINS, SHEET)
            reached = led_by(navigation_variables(moved(pose, command, *rng.choice([-1.0, 1.0], 2))), leading)
            assert any(
                one.r0 - ROUNDING <= reached.rho <= one.r1 + ROUNDING
                and near_or_around(reached.alpha, one.a0, one.a1)
                and near_or_around(reached.beta, one.b0, one.b1)
                for one in boxes
            ), (box, pose, errors)


@pytest.mark.parametrize(("u", "z"), [((0.02, 0.1), (-0.2, 0.1)), ((-0.1, 0.05), (0.0, 0.2)), ((-0.1, -0.1), (0, 0))])
def test_bounds_after_a_move_are_those_of_many_moves(u, z):
    """Chord and rotation vary freely: nothing is outside, and each bound is nearly reached."""
    rng = np.random.default_rng(6)
    for alpha in np.linspace(0.0, math.pi, 21):
        box = Box(0.4, 0.41, alpha, alpha + 0.05, 0.0, 0.0)
        bounds = after(box, *u, *z)
        r, a, length, turn = (
            np.where(rng.uniform(size=4000) < 0.5, rng.uniform(low, high, 4000), rng.choice([low, high], 4000))
            for low, high in ((0.4, 0.41), (alpha, alpha + 0.05), u, z)
        )
        goal = r * np.exp(1j * a) - length * np.exp(0.5j * turn)
        direction = np.angle(goal * np.exp(-1j * a))
        found = np.abs(goal), a + direction - turn, direction
        for values, low, high, near in zip(found, bounds[::2], bounds[1::2], (2e-3, 5e-3, 2e-2), strict=True):
            assert low <= values.min() <= low + near
            assert high - near <= values.max() <= high


def test_steps_of_omega_l_stay_within_the_largest_distance_of_their_ring():
    rng = np.random.default_rng(3)
    largest, farthest = farthest_of_ring(LOOP, 0.38, 0.385, 30, 12, 0.06), 0.0
    for _ in range(4000):
        r, alpha, beta = rng.uniform(0.38, 0.385), rng.uniform(0.0, math.pi), rng.uniform(-math.pi, math.pi)
        pose = Pose(-r * math.cos(beta), -r * math.sin(beta), wrap_angle(beta - alpha))
        seen = measured(pose, rng.choice([-1.0, 0.0, 1.0], 3))
        command = drive_and_hold(navigation_variables(seen), seen.theta, 0.0, GAINS, SHEET)
        reached = moved(pose, command, *rng.choice([-1.0, 1.0], 2))
        farthest = max(farthest, math.hypot(reached.x, reached.y))
    assert largest - 0.006 < farthest <= largest


@pytest.mark.parametrize(("tolerance", "reach"), [(0.1, 0.0), (0.4, 0.0), (0.1, 0.5)])
@pytest.mark.parametrize("factor", [2.0, 12.0])
def test_poses_beyond_the_leaving_radius_count_as_outside_and_nearer_ones_may_not(factor, tolerance, reach):
    """A factor of 12 lets the radius grow with the distance."""
    policy = CONFIG.region_policy
    policy = policy._replace(covariance=policy.covariance._replace(eps_P_leave_factor=factor))
    config = CONFIG._replace(region_policy=policy, tolerance=CONFIG.tolerance._replace(xy_goal_tolerance=tolerance))
    radius, last = leaving_radius(config, CONTRACT.sigma_max, reach), policy.covariance.eps_P_leave_steps - 1
    before = ControllerMemory()._replace(
        switching=Switching(OMEGA_L, 1, last), finish=Finish(V_LEG, 1.0, reach, 2), command=Twist(0.2, 0.0)
    )
    for rho in np.linspace(0.02, 3.0, 150):
        found = []
        for sigma in np.linspace(0.0, CONTRACT.sigma_max, 12):
            seen = Estimate(Pose(0.0, rho, 0.0), Uncertainty(sigma, 0.0))
            found.append(braking_step(before, seen, Pose(0.0, 0.0, 0.0), 0.1, config)[2].region)
        assert (OMEGA_L in found) == (rho <= radius)


@settings(max_examples=300, deadline=None)
@given(
    st.floats(0.02, 0.5), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(0.0, 0.2), st.booleans(), st.booleans()
)
def test_no_leg_of_the_finish_goes_farther_or_faster_than_the_bounds(tolerance, x, y, sigma, reached, backward):
    """Sampled with the law itself, from where a leg begins to its last one; the heading can be known."""
    goal, local = CONFIG.tolerance._replace(xy_goal_tolerance=tolerance), Pose(x, y, 0.0)
    state, rest = Finish(), Standing(10.0, reached, backward)
    state = next_finish(state, local, rest, Uncertainty(sigma, 0.01), goal, CONFIG.finish)
    while is_leg(state):
        assert state.reach <= longest_reach(abs(y), goal)
        far = Pose(-9.0 * state.side, 0.0, 0.0)
        assert abs(finish_command(state, far, goal, CONFIG.finish, GAINS, SHEET).v) <= fastest_leg(CONFIG.finish)
        end = Pose(2.0 * state.side * state.reach + state.side * tolerance, y, 0.0)
        state = next_finish(state, end, rest, Uncertainty(sigma, 0.01), goal, CONFIG.finish)


def small_cells(ranks):
    rows = len(ranks)
    start = np.arange(rows + 1) * 32
    edges, columns = 1.0 + np.arange(rows + 1.0), np.full(rows, 8)
    return Cells(edges, columns, np.full(rows, 4), start, np.array(ranks, np.int16).ravel())


def columns_met(low, high, number):
    edges = -math.pi + 2.0 * math.pi * np.arange(number + 1) / number
    turns = 2.0 * math.pi * np.arange(-3, 4)[:, None]
    return ((edges[:-1] <= high + turns) & (edges[1:] >= low + turns)).any(axis=0)


def test_ranks_met_by_a_box_against_a_search():
    rng = np.random.default_rng(7)
    for _ in range(500):
        ranks = rng.integers(0, 10_000, (3, 8, 4))
        cells = small_cells(ranks)
        r, a, b = (np.sort(rng.uniform(low, high, 2)) for low, high in ((0.5, 4.2), (-8.0, 8.0), (-8.0, 8.0)))
        a[1], b[1] = min(a[1], a[0] + 2.0), min(b[1], b[0] + 2.0)
        rows = (cells.rho[:-1] <= r[1]) & (cells.rho[1:] >= r[0])
        expected = ranks[np.ix_(rows, columns_met(*a, 8), columns_met(*b, 4))].max(initial=0)
        beyond = r[1] >= cells.rho[-1]
        assert keeps_below(cells, Box(*r, *a, *b), expected) != beyond
        assert expected == 0 or not keeps_below(cells, Box(*r, *a, *b), expected - 1)


def test_the_rank_of_a_state_is_that_of_its_cell():
    cells = small_cells(np.arange(96).reshape(3, 32))
    assert rank_at(cells, 0.9, 0.0, 0.0) == 0
    assert rank_at(cells, 2.5, -math.pi + 0.1, -math.pi + 0.1) == 32
    assert rank_at(cells, 2.5, 0.1, math.pi - 0.1) == 32 + 4 * 4 + 3
    assert rank_at(cells, 4.0, 0.0, 0.0) == 32_767


def test_a_cell_that_is_just_touched_counts_and_beyond_the_cells_nothing_is_ranked():
    ranks = np.zeros((2, 32))
    ranks[1] = 9
    cells = small_cells(ranks)
    inside = Box(1.2, 1.9, 0.1, 0.2, 0.1, 0.2)
    assert keeps_below(cells, inside, 0)
    assert not keeps_below(cells, inside._replace(r1=2.0), 8)
    assert keeps_below(cells, inside._replace(r1=2.0), 9)
    assert not keeps_below(cells, inside._replace(r1=3.0), 40)
    assert not keeps_below(cells, inside._replace(r1=math.nan), 40)
