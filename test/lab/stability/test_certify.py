"""The maker: claims of a certificate, rows that are halved, and errors if there is no certificate."""

import numpy as np
import pytest

from diffbot_control.law.configuration import SwitchingConfig
from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.checker import verify
from diffbot_lab.stability.file import first_cells
from diffbot_lab.stability.maker import CORE, UNRANKED, Table, certify, steps_from
from diffbot_lab.stability.plan import Contract

CONFIG = SwitchingConfig()


def test_the_claims_follow_from_the_ranks(plan, certificate):
    claims, cells = certificate.claims, first_cells(certificate.alphas, certificate.betas)
    rows = np.searchsorted(cells, np.arange(len(certificate.ranks)), side="right") - 1
    assert claims.start == plan.to
    assert claims.steps == certificate.ranks[certificate.rho[rows] < plan.to].max() > 0
    assert claims.radius == certificate.rho[rows[certificate.ranks == CORE] + 1].max()
    assert claims.seed < claims.radius < 1.6


def turning(omega_dot_max):
    """Return a law with a limit of the angular acceleration, and a contract of its base."""
    config = CONFIG._replace(data_sheet=CONFIG.data_sheet._replace(omega_dot_max=omega_dot_max))
    return config, Contract(eps_v=0.001, eps_omega=0.01)


def test_rows_are_halved_where_a_law_that_turns_slowly_makes_little_progress(plan, certificate):
    config, contract = turning(1.6)
    slow = certify(config, plan._replace(contract=contract))
    assert len(slow.rho) > len(certificate.rho)
    assert slow.claims.steps > certificate.claims.steps
    verify(slow)


def test_a_law_that_cannot_turn_in_time_has_no_certificate(plan):
    config, contract = turning(0.05)
    with pytest.raises(DiffbotError, match=r"no certificate: the errors may drive the robot out of the core"):
        certify(config, plan._replace(contract=contract))


def test_a_cell_without_a_rank_is_an_error_only_within_the_start(certificate):
    rho, alphas, betas, ranks = certificate.rho, certificate.alphas, certificate.betas, certificate.ranks.copy()
    table, row = Table(rho, alphas, betas, first_cells(alphas, betas)), len(alphas) - 20
    ranks[table.start[row] + 5] = UNRANKED
    assert steps_from(table, ranks, float(rho[row])) > 0
    with pytest.raises(DiffbotError, match=rf"no certificate: .* the nearest at {rho[row]:.4g} m"):
        steps_from(table, ranks, float(rho[row]) + 0.001)


def test_bounds_that_grow_as_fast_as_the_distance_are_refused(plan):
    with pytest.raises(DiffbotError, match=r"position_slope \+ 3 \* sigma_slope"):
        certify(CONFIG, plan._replace(contract=Contract(sigma_slope=0.4)))
    with pytest.raises(DiffbotError, match=r"no certificate: Omega_L may stay in force as far as 1.5 m"):
        certify(CONFIG, plan._replace(contract=Contract(sigma_slope=0.32)))
