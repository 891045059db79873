"""Mistakes planted in what makes a certificate of the level: the checker finds each of them."""

import inspect

import pytest

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.level import bounds, enclosure, leaf
from diffbot_lab.stability.level.enclosure import problem_of, walk
from diffbot_lab.stability.level.file import LevelCertificate
from diffbot_lab.stability.level.verify import verify_level

RHO_MAX = 8.0
PROBLEM = problem_of({"h": 0.01})
"""beta hardly matters: so few cells that they are made without the compiler. A witness has V = 18.61."""
TOP = leaf.top_of(PROBLEM, RHO_MAX)


@pytest.fixture(autouse=True)
def _uncompiled_search(monkeypatch):
    monkeypatch.setattr(enclosure, "compile_bounds", lambda kernel: kernel)
    monkeypatch.setattr(enclosure, "_NODES_AT_A_TIME", 1000)
    monkeypatch.setattr(enclosure, "_MAX_NODES", 4000)


def made(level):
    tree = walk(PROBLEM, level, TOP)
    return None if tree is None else LevelCertificate(PROBLEM, RHO_MAX, level, tree, None)


def plant_mistake(monkeypatch, function, old, new):
    source = inspect.getsource(getattr(bounds, function))
    assert source.count(old) == 1
    namespace = dict(vars(bounds))
    exec(compile("from __future__ import annotations\n" + source.replace(old, new), function, "exec"), namespace)
    monkeypatch.setattr(bounds, function, namespace[function])


def test_without_a_mistake_only_a_level_that_holds_is_made_and_verified(monkeypatch):
    assert made(18.5) is None
    good = made(19.5)
    assert verify_level(good) == 0
    with pytest.raises(DiffbotError, match="is not shown: rho "):
        verify_level(good._replace(level=18.6))
    right = leaf.motion_of

    def wrong(*arguments):
        length, turn = right(*arguments)
        return length, (-turn[1], -turn[0])

    monkeypatch.setattr(leaf, "motion_of", wrong)
    with pytest.raises(DiffbotError, match="is not shown: rho "):
        verify_level(good)


MISTAKES = {
    "a wrong sign": ("_rise_for", "y0, y1 = mul(u0, u1, s0, s1)", "y0, y1 = mul(u0, u1, -s1, -s0)"),
    "rounding inward, of what is measured": (
        *("narrowed", "sub(e0, e1, -problem.eps_theta, problem.eps_theta)"),
        "sub(e0, e1, 0.004 - problem.eps_theta, problem.eps_theta - 0.004)",
    ),
    "rounding inward, of the bound": ("_rise_for", "of_alpha + of_beta))", "of_alpha + of_beta)) - 0.03"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_in_the_search_is_found(name, monkeypatch):
    plant_mistake(monkeypatch, *MISTAKES[name])
    wrong = made(18.5)
    assert wrong is not None
    with pytest.raises(DiffbotError, match=r"tree: node [0-9]+ is not shown: rho 5"):
        verify_level(wrong)
