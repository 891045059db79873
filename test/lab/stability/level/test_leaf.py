"""The checker's bounds hold every simulated step, are the step in a point, and are not the search's."""

import math

import numpy as np
import pytest
from level_steps import PAPER, PROBLEMS, random_choice, sides_around

from diffbot_lab.stability.level import leaf
from diffbot_lab.stability.level.bounds import Cell, rise
from diffbot_lab.stability.level.leaf import Boxes, highest_rise, root_of, settled, swing, top_of
from diffbot_lab.stability.level.problem import Witness
from diffbot_lab.stability.level.step import levels
from diffbot_lab.stability.level.witness import witness_at


def steps_in_boxes(number, seed, problem, largest):
    """Rows of random boxes, and V before and after a random step in each."""
    rng, choice = np.random.default_rng(seed), np.zeros(7)
    rows, changes = [], []
    for _ in range(number):
        random_choice(rng, choice)
        step = witness_at(choice, 12.0 * rng.random() ** 2, problem)
        rows.append(sides_around(rng, step, problem, largest))
        changes.append(levels(step, problem))
    return np.array(rows), *np.array(changes).T


@pytest.mark.parametrize("name", PROBLEMS)
def test_no_step_breaks_the_bound(name):
    rows, before, after = steps_in_boxes(8000, 5, PROBLEMS[name], 3.0)
    assert (after - before <= highest_rise(Boxes.of(rows), PROBLEMS[name]) + 1e-12).all()


@pytest.mark.parametrize("name", ["Euler", "exact arc", "no noise"])
def test_no_step_from_a_settled_box_breaks_the_claim(name):
    problem = PROBLEMS[name]
    rows, before, after = steps_in_boxes(6000, 6, problem, 0.3)
    for level in (3.0, 8.0, 19.0):
        shown = settled(Boxes.of(rows), problem, level, 70.0)
        above = shown & (before > level) & (before < 70.0)
        below = shown & (before <= level)
        assert above.sum() > 300
        assert below.sum() > 300
        assert (after < before)[above].all()
        assert (after <= level)[below].all()


@pytest.mark.parametrize("exact_arc", [False, True])
def test_without_noise_a_point_is_the_step(exact_arc):
    problem = PROBLEMS["no noise"]._replace(exact_arc=exact_arc)
    rng = np.random.default_rng(2)
    for _ in range(100):
        rho, alpha, beta = rng.uniform(0.5, 10.0), rng.uniform(-3.0, 3.0), rng.uniform(0.0, 3.0)
        row = np.array([[rho, rho, alpha, alpha, beta, beta, alpha - 1e-12, alpha + 1e-12, 0.0, 0.0, 0.0, 0.0]])
        before, after = levels(Witness(rho, alpha, beta, 0.0, 0.0, 0.0, 0.0, 0.0), problem)
        assert 0.0 < highest_rise(Boxes.of(row), problem)[0] - (after - before) < 1e-8


WRONG = {
    "turn": ("motion_of", lambda length, turn: (length, (-turn[1], -turn[0]))),
    "length": ("motion_of", lambda length, turn: ((-length[1], -length[0]), turn)),
    "swing": ("swing", lambda low, high: (-high, -low)),
    "bearing": ("bearing_error", lambda low, high: (0.9 * low, 0.9 * high)),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_sign_in_the_checker_would_be_found(name, monkeypatch):
    function, change = WRONG[name]
    right = getattr(leaf, function)
    monkeypatch.setattr(leaf, function, lambda *arguments: change(*right(*arguments)))
    rows, before, after = steps_in_boxes(3000, 7, PAPER, 0.1)
    broken = after - before > highest_rise(Boxes.of(rows), PAPER) + 1e-3
    assert broken.mean() > 0.01


def test_in_small_boxes_the_bound_is_near_the_step_and_no_looser_than_the_searchs():
    rows, before, after = steps_in_boxes(1000, 8, PAPER, 0.01)
    checked = highest_rise(Boxes.of(rows), PAPER)
    searched = np.array([rise(Cell(*row), PAPER, -1.0) for row in rows])
    assert np.median(checked - (after - before)) < 0.01
    assert (checked < searched + 1e-3).all()
    assert (checked != searched).all()


def test_the_bearing_swings_by_what_geometry_says():
    """Extremes over a fine grid of a box are within the bounds, and near them."""
    rho, length, angle = (2.0, 2.2), (-0.3, 0.5), (0.4, 1.3)
    low, high = swing(*(tuple(np.array([side]) for side in sides) for sides in (rho, length, angle)))
    grid = np.meshgrid(*(np.linspace(*sides, 60) for sides in (rho, length, angle)))
    goal = grid[0] - grid[1] * np.exp(-1j * grid[2])
    found = np.angle(goal)
    assert low[0] <= found.min() < low[0] + 0.05
    assert high[0] - 0.05 < found.max() <= high[0]


def test_near_the_goal_any_bearing_may_result():
    low, high = swing(*((np.array([a]), np.array([b])) for a, b in ((0.0, 0.4), (0.3, 0.5), (0.0, 0.1))))
    assert low[0] <= -math.pi
    assert math.pi <= high[0]


def test_the_root_holds_all_states_and_measurements():
    problem = PROBLEMS["any heading"]
    root = root_of(problem, top_of(problem, 12.0))
    assert root[0] == 0.0
    assert root[1] ** 2 > 144.0 + 1.17 * math.pi**2
    assert (root[2:8:2] <= [-math.pi, 0.0, -3.0 * math.pi]).all()
    assert (root[3:8:2] >= [math.pi, math.pi, 3.0 * math.pi]).all()
    assert root[8:].tolist() == [-0.065, 0.065, -0.2167, 0.2167]
