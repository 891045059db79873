"""The checker's bound of a rise of V holds every simulated step, and it finds mistakes planted in the search."""

import inspect
import math

import numpy as np
import pytest

from diffbot_control.law.polar_coordinates import navigation_variables
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_lab.stability.level import bounds, enclosure, leaf
from diffbot_lab.stability.level.enclosure import problem_of, walk
from diffbot_lab.stability.level.file import LevelCertificate
from diffbot_lab.stability.level.leaf import Boxes, highest_rise
from diffbot_lab.stability.level.step import levels
from diffbot_lab.stability.level.verify import verify_level
from diffbot_lab.stability.level.witness import witness_at

PAPER = problem_of({})
RHO_MAX = 8.0
COARSE = problem_of({"h": 0.01})
"""beta hardly matters: so few cells that they are made without the compiler. A witness has V = 18.61."""


def side(rng, x, largest, low, high):
    """Interval around x, of any size up to the largest, within [low, high]."""
    width = largest * 10.0 ** (-7.0 * rng.random())
    start = x - width * rng.random()
    return max(start, low), min(start + width, high)


def cell_around(rng, step, problem, largest):
    """Bounds of a cell that holds the step: rho, alpha, beta, measured alpha, eps_v, eps_omega."""
    x, y = step.eps_x - step.rho * math.cos(step.beta), step.eps_y - step.rho * math.sin(step.beta)
    error = wrap_angle(navigation_variables(Pose(x, y, 0.0)).beta - step.beta)
    sides = (
        (step.rho, 2.0 * largest, 0.0, 100.0),
        (step.alpha, largest, -math.pi, math.pi),
        (step.beta, largest, 0.0, math.pi),
        (step.alpha + error - step.eps_theta, largest, -10.0, 10.0),
        (step.eps_v, 0.1 * largest, -problem.eps_v, problem.eps_v),
        (step.eps_omega, 0.1 * largest, -problem.eps_omega, problem.eps_omega),
    )
    return [end for one in sides for end in side(rng, *one)]


def rises_above_the_bound(number, problem, largest):
    """Rise of V in random steps, each noise at its bound or within, less the bound of a random cell that holds it."""
    rng = np.random.default_rng(5)
    rows, rises = [], []
    for _ in range(number):
        choice = rng.uniform(-1.0, 1.0, 7)
        choice[2:] = np.where(rng.random(5) < 0.5, np.sign(choice[2:]), choice[2:])
        step = witness_at(choice, 12.0 * rng.random() ** 2, problem)
        before, after = levels(step, problem)
        rows.append(cell_around(rng, step, problem, largest))
        rises.append(after - before)
    return np.array(rises) - highest_rise(Boxes.of(np.array(rows)), problem)


@pytest.mark.parametrize("exact_arc", [False, True])
def test_no_step_breaks_the_checkers_bound(exact_arc):
    assert rises_above_the_bound(3000, PAPER._replace(exact_arc=exact_arc), 3.0).max() <= 1e-12


@pytest.mark.parametrize(
    ("function", "change"),
    [
        ("motion_of", lambda length, turn: (length, (-turn[1], -turn[0]))),
        ("bearing_error", lambda low, high: (0.9 * low, 0.9 * high)),
    ],
)
def test_a_mistake_in_the_checker_would_be_found(function, change, monkeypatch):
    right = getattr(leaf, function)
    monkeypatch.setattr(leaf, function, lambda *arguments: change(*right(*arguments)))
    assert (rises_above_the_bound(1500, PAPER, 0.1) > 1e-3).mean() > 0.01


@pytest.fixture
def made(monkeypatch):
    """Return the function that makes a certificate without the compiler; None if the level is not shown."""
    monkeypatch.setattr(enclosure, "compile_bounds", lambda kernel: kernel)
    monkeypatch.setattr(enclosure, "_NODES_AT_A_TIME", 1000)
    monkeypatch.setattr(enclosure, "_MAX_NODES", 4000)

    def certificate(level):
        tree = walk(COARSE, level, leaf.top_of(COARSE, RHO_MAX))
        return None if tree is None else LevelCertificate(COARSE, RHO_MAX, level, tree, None)

    return certificate


def test_only_a_level_that_holds_is_made_and_verified(made):
    assert made(18.5) is None
    good = made(19.5)
    assert verify_level(good) == 0
    with pytest.raises(DiffbotError, match="is not shown: rho "):
        verify_level(good._replace(level=18.6))


@pytest.mark.parametrize(
    ("function", "old", "new"),
    [
        ("_rise_for", "y0, y1 = mul(u0, u1, s0, s1)", "y0, y1 = mul(u0, u1, -s1, -s0)"),
        ("_rise_for", "of_alpha + of_beta))", "of_alpha + of_beta)) - 0.03"),
    ],
    ids=["a wrong sign", "rounding inward"],
)
def test_a_mistake_in_the_search_is_found(function, old, new, made, monkeypatch):
    source = inspect.getsource(getattr(bounds, function))
    assert source.count(old) == 1
    namespace = dict(vars(bounds))
    exec(compile("from __future__ import annotations\n" + source.replace(old, new), function, "exec"), namespace)
    monkeypatch.setattr(bounds, function, namespace[function])
    wrong = made(18.5)
    assert wrong is not None
    with pytest.raises(DiffbotError, match=r"tree: node [0-9]+ is not shown: rho 5"):
        verify_level(wrong)
