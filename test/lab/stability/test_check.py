"""The checker's own bounds hold the robot's law, limits, switch and plant."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tuned_steps import CONFIG, CONTRACT

from diffbot_control.law.braking_step import braking_step
from diffbot_control.law.configuration import ControllerMemory
from diffbot_control.law.finish import (
    V_LEG,
    Finish,
    Standing,
    fastest_leg,
    finish_command,
    is_leg,
    longest_reach,
    next_finish,
    v_sigma_max,
)
from diffbot_control.law.regions import OMEGA_L, Switching
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty
from diffbot_lab.stability.check.cells import Cells, keeps_below
from diffbot_lab.stability.check.near import leaving_radius
from diffbot_lab.stability.check.steps import Box


@pytest.mark.parametrize(("tolerance", "reach", "factor"), [(0.1, 0.0, 2.0), (0.4, 0.0, 12.0), (0.1, 0.5, 12.0)])
def test_poses_beyond_the_leaving_radius_count_as_outside_and_nearer_ones_may_not(factor, tolerance, reach):
    """A factor of 12 lets the radius grow with the distance."""
    policy = CONFIG.region_policy
    policy = policy._replace(covariance=policy.covariance._replace(eps_P_leave_factor=factor))
    config = CONFIG._replace(region_policy=policy, tolerance=CONFIG.tolerance._replace(xy_goal_tolerance=tolerance))
    radius, last = leaving_radius(config, CONTRACT.sigma_max, reach), policy.covariance.eps_P_leave_steps - 1
    before = ControllerMemory()._replace(
        switching=Switching(OMEGA_L, 1, last), finish=Finish(V_LEG, 1.0, reach, 2), command=Twist(0.2, 0.0)
    )
    for rho in np.linspace(0.02, 3.0, 75):
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
    gains, sheet = CONFIG.profile_gains, CONFIG.data_sheet
    goal, local = CONFIG.tolerance._replace(xy_goal_tolerance=tolerance), Pose(x, y, 0.0)
    state, rest = Finish(), Standing(10.0, reached, backward)
    state = next_finish(state, local, rest, Uncertainty(sigma, 0.01), goal, CONFIG.finish)
    assert state.kind != V_LEG or sigma < v_sigma_max(goal)
    while is_leg(state):
        assert state.reach <= longest_reach(abs(y), goal)
        far = Pose(-9.0 * state.side, 0.0, 0.0)
        assert abs(finish_command(state, far, goal, CONFIG.finish, gains, sheet).v) <= fastest_leg(CONFIG.finish)
        end = Pose(2.0 * state.side * state.reach + state.side * tolerance, y, 0.0)
        state = next_finish(state, end, rest, Uncertainty(sigma, 0.01), goal, CONFIG.finish)


def test_a_v_begins_only_where_the_bound_of_its_reach_supposes():
    """Whatever deviation up to 0.05 m is reported; nearly all of the bound is used."""
    still = ControllerMemory()._replace(switching=Switching(OMEGA_L, 1, 0), finish=Finish(rest=10.0))
    begun = []
    for sigma in np.linspace(0.0, 0.05, 26):
        for y in np.linspace(0.1, 0.25, 151):
            seen = Estimate(Pose(0.0, y, 0.0), Uncertainty(sigma, 0.01))
            memory, _, _ = braking_step(still, seen, Pose(0.0, 0.0, 0.0), 0.1, CONFIG)
            begun += [y] if memory.finish.kind == V_LEG else []
    bound = leaving_radius(CONFIG, min(0.05, v_sigma_max(CONFIG.tolerance)), 0.0)
    assert bound - 0.005 < max(begun) <= bound


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
