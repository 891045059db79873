"""One small certificate for all tests: far from the goal, where large cells suffice."""

import functools

import pytest

from diffbot_control.law.configuration import ControllerConfig
from diffbot_lab.stability.check import verify as checker
from diffbot_lab.stability.maker import certify as maker
from diffbot_lab.stability.plan import Plan, requesting

NEAR_ONCE, CHECKED_ONCE = functools.cache(maker.near_bounds), functools.cache(checker.farthest_local)
"""The bounds of Omega_L take most of the time, and are the same for all small certificates of one law."""


@pytest.fixture(autouse=True)
def bound_omega_l_once(monkeypatch):
    monkeypatch.setattr(maker, "near_bounds", NEAR_ONCE)
    monkeypatch.setattr(checker, "farthest_local", CHECKED_ONCE)


@pytest.fixture(scope="session")
def plan():
    law = requesting(ControllerConfig(), Plan())
    near = NEAR_ONCE(maker.tuned_loop(law, Plan()), law, Plan().contract.sigma_max)
    return Plan(to=1.9, margin=1.3 - near.holding, fineness=0.4)


@pytest.fixture(scope="session")
def certificate(plan):
    return maker.certify(ControllerConfig(), plan)
