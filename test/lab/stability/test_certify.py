"""A small certificate: cells, claims, and what is refused."""

import numpy as np
import pytest

from diffbot_control.law.configuration import ControllerConfig
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose
from diffbot_core.schema import build
from diffbot_lab.stability.adversary.drift import drift, lured_out
from diffbot_lab.stability.check import verify as checker
from diffbot_lab.stability.check.commands import numbers_of
from diffbot_lab.stability.check.verify import verify
from diffbot_lab.stability.file import first_cells
from diffbot_lab.stability.maker import certify as maker
from diffbot_lab.stability.maker.certify import certify, tuned_loop
from diffbot_lab.stability.maker.table import CORE
from diffbot_lab.stability.plan import Contract, Plan
from diffbot_lab.stability.runs import ContractLoop

CONTRACT = Contract()
CONFIG = ControllerConfig()


def test_the_claims_are_what_the_ranks_say(plan, certificate):
    claims, cells = certificate.claims, first_cells(certificate.alphas, certificate.betas)
    rows = np.searchsorted(cells, np.arange(len(certificate.ranks)), side="right") - 1
    assert claims.start == plan.to
    assert claims.steps == certificate.ranks[certificate.rho[rows] < plan.to].max() > 0
    assert claims.radius == certificate.rho[rows[certificate.ranks == CORE] + 1].max()
    assert claims.seed < claims.radius < 1.6


@pytest.fixture
def turning(plan, monkeypatch):
    """Return a function that certifies the law with another reaction time of turning; Omega_L does not depend on it."""
    near = maker.near_bounds(tuned_loop(CONFIG, Plan()), CONFIG, CONTRACT.sigma_max)
    monkeypatch.setattr(maker, "near_bounds", lambda *_: near)

    def certified(react):
        return certify(CONFIG._replace(profile_gains=CONFIG.profile_gains._replace(turn_react=react)), plan)

    return certified


def test_rows_are_halved_where_a_law_that_turns_slowly_makes_little_progress(turning, certificate):
    slow = turning(1.2)
    assert set(certificate.rho) < set(slow.rho)
    assert slow.claims.steps > certificate.claims.steps
    verify(slow)


def test_without_a_rank_for_all_there_is_no_certificate(turning):
    with pytest.raises(DiffbotError, match=r"no certificate: [0-9.]+ % of the cells, from"):
        turning(2.5)


def test_adversaries_come_near_the_bounds_of_omega_l_but_not_beyond():
    """One drifts aside to where the robot no longer rests; the other lures it out in a V."""
    near = maker.near_bounds(tuned_loop(CONFIG, Plan()), CONFIG, CONTRACT.sigma_max)
    checked = checker.farthest_local(numbers_of(CONFIG, Plan()), CONFIG, CONTRACT.sigma_max)
    loop = ContractLoop(CONFIG, CONTRACT, 0.1)
    aside = drift(loop, near.resting, Pose(0.0, near.resting, 0.0), 2000).farthest
    lured = lured_out(loop, near.resting, 0.9).farthest
    assert near.resting < aside < lured < checked <= near.holding < 2.0 * lured


@pytest.mark.parametrize(("name", "value"), [("finish_wait", 0.0), ("eps_P_leave_factor", 21.0)])
def test_a_finish_or_a_switch_that_is_not_bounded_is_refused(plan, name, value):
    with pytest.raises(DiffbotError, match=name):
        certify(build(ControllerConfig, {name: value}), plan)
