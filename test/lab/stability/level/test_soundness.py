"""The checker of a level passes what is proved, and finds mistakes planted in the search."""

import inspect

import pytest

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.level import bounds, enclosure, leaf
from diffbot_lab.stability.level.enclosure import problem_of, walk
from diffbot_lab.stability.level.file import LevelCertificate
from diffbot_lab.stability.level.verify import verify_level

RHO_MAX = 8.0
COARSE = problem_of({"h": 0.01})
"""beta hardly matters: so few cells that they are made without the compiler. A witness has V = 18.61."""


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
