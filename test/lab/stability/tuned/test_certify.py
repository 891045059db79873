"""A small certificate of the tuned law: cells, claims, and what is refused."""

import numpy as np
import pytest

from diffbot_control.law.configuration import ControllerConfig
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose
from diffbot_lab.stability.adversary.drift import drift
from diffbot_lab.stability.tuned import certify as maker
from diffbot_lab.stability.tuned import verify as checker
from diffbot_lab.stability.tuned.certify import certify, tuned_loop
from diffbot_lab.stability.tuned.check.commands import numbers_of
from diffbot_lab.stability.tuned.contract import Contract
from diffbot_lab.stability.tuned.file import first_cells
from diffbot_lab.stability.tuned.table import CORE

CONTRACT = Contract()
CONFIG = ControllerConfig()


def test_the_claims_are_what_the_ranks_say(plan, certificate):
    claims, cells = certificate.claims, first_cells(certificate.alphas, certificate.betas)
    rows = np.searchsorted(cells, np.arange(len(certificate.ranks)), side="right") - 1
    assert claims.start == plan.to
    assert claims.steps == certificate.ranks[certificate.rho[rows] < plan.to].max() > 0
    assert claims.radius == certificate.rho[rows[certificate.ranks == CORE] + 1].max()
    assert claims.seed < claims.radius < 1.6


def test_without_a_rank_for_all_there_is_no_certificate(plan, monkeypatch):
    """Beyond this distance the speed is too low for the errors of the wheels."""
    slow = CONFIG._replace(profile_gains=CONFIG.profile_gains._replace(turn_react=1.2))
    near = maker.near_bounds(tuned_loop(CONFIG, CONTRACT), CONFIG, CONTRACT.sigma_max)
    monkeypatch.setattr(maker, "near_bounds", lambda *_: near)
    with pytest.raises(DiffbotError, match=r"no certificate: [0-9.]+ % of the cells, from"):
        certify(slow, plan)


def test_an_adversary_comes_near_the_bounds_of_omega_l_but_not_beyond():
    near = maker.near_bounds(tuned_loop(CONFIG, CONTRACT), CONFIG, CONTRACT.sigma_max)
    checked = checker.farthest_local(numbers_of(CONFIG, CONTRACT), CONFIG, CONTRACT.sigma_max)
    idle = CONFIG._replace(finish=CONFIG.finish._replace(finish_tries=0))
    for config in (idle, CONFIG):
        farthest = drift(config, CONTRACT, near.leaving, Pose(0.0, 0.13, 0.0), 6000).farthest
        assert 0.1 < farthest < checked <= near.holding
