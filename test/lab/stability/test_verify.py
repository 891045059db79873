"""The checker accepts a valid certificate and finds mistakes in a certificate and in its maker."""

import numpy as np
import pytest

from diffbot_control.law.configuration import SwitchingConfig
from diffbot_core.errors import DiffbotError
from diffbot_lab.stability import maker
from diffbot_lab.stability.checker import cells_of, failing_kernel, verify
from diffbot_lab.stability.checker_bounds import checker_loop
from diffbot_lab.stability.file import first_cells
from diffbot_lab.stability.plan import Contract, ideal_law
from diffbot_lab.stability.runs import drive

CONFIG = SwitchingConfig()
CELL = "not verified: the cell rho"


def test_a_valid_certificate_is_accepted(certificate):
    verify(certificate)


def remade(monkeypatch, certificate, name, change):
    """Make the certificate with a maker one function of which is changed."""
    usual = getattr(maker, name)
    monkeypatch.setattr(maker, name, lambda *arguments: change(usual(*arguments)))
    return maker.certify(CONFIG, certificate.plan)


@pytest.mark.parametrize("change", [{"weight": -0.8}, {"noise": 0.02}])
def test_a_wrong_sign_and_too_little_noise_in_the_maker_are_found(monkeypatch, certificate, change):
    wrong = remade(monkeypatch, certificate, "maker_loop", lambda loop: loop._replace(**change))
    with pytest.raises(DiffbotError, match="not verified"):
        verify(wrong)


def test_a_maker_that_rounds_inward_is_found(monkeypatch, certificate):
    """The images are padded by 2e-5. With these cells, the smallest error that matters is 1e-4 more."""
    error = 1e-4

    def shrunk(images):
        boxes = images.boxes.copy()
        boxes[:, ::2] += error
        boxes[:, 1::2] -= error
        return images._replace(boxes=boxes)

    wrong = remade(monkeypatch, certificate, "boxes_of_row", shrunk)
    with pytest.raises(DiffbotError, match=CELL):
        verify(wrong)


def changed(certificate, at, rank):
    ranks = certificate.ranks.copy()
    ranks[at] = rank
    return certificate._replace(ranks=ranks)


def claiming(certificate, **changes):
    return certificate._replace(claims=certificate.claims._replace(**changes))


def test_ranks_that_are_one_too_small_are_found(certificate):
    """Not all are found, because some ranks of the maker are larger than necessary."""
    loop = checker_loop(ideal_law(CONFIG, certificate.plan), certificate.plan)
    first = first_cells(certificate.alphas, certificate.betas)
    found = 0
    for at in np.random.default_rng(1).choice(np.flatnonzero(certificate.ranks > 1), 40, replace=False):
        row = int(np.searchsorted(first, at, side="right")) - 1
        cells = cells_of(changed(certificate, at, certificate.ranks[at] - 1))
        failing = failing_kernel(loop, cells, row)
        assert failing in (-1, at - first[row])
        found += failing >= 0
        if failing >= 0:
            lowered = at
    assert found >= 30
    with pytest.raises(DiffbotError, match=f"{CELL}.* may lead to a rank that is not smaller"):
        verify(changed(certificate, lowered, certificate.ranks[lowered] - 1))


@pytest.mark.parametrize("rank", [0, 12])
def test_a_cell_that_is_left_out_is_found(certificate, rank):
    """The checker finds it in the claim of the start, and otherwise at the cells that lead to it."""
    at = int(np.flatnonzero(certificate.ranks == rank)[-1 if rank == 0 else 0])
    missing = changed(certificate, at, -1)
    with pytest.raises(DiffbotError, match=r"claims\.start"):
        verify(missing)
    with pytest.raises(DiffbotError, match=CELL):
        verify(claiming(missing, start=certificate.claims.seed))


@pytest.mark.parametrize("claim", ["radius", "start", "steps", "seed"])
def test_claims_that_are_too_good_are_found(certificate, claim):
    claims = certificate.claims
    better = {"radius": claims.radius - 1e-6, "start": certificate.rho[-1], "steps": claims.steps - 1, "seed": 0.15}
    with pytest.raises(DiffbotError, match=rf"claims\.{claim} = "):
        verify(claiming(certificate, **{claim: better[claim]}))


def test_a_seed_that_is_not_all_in_the_core_is_found(certificate):
    with pytest.raises(DiffbotError, match="not all states within it are in the core"):
        verify(changed(certificate, 0, 1))
    with pytest.raises(DiffbotError, match="not all states within it are in the core"):
        verify(claiming(certificate, seed=certificate.rho[-1] + 1.0))


def test_edges_that_begin_too_near_or_too_far_are_found(certificate):
    near = np.concatenate(([0.05], certificate.rho[1:]))
    with pytest.raises(DiffbotError, match=r"rho begins at 0.05 m, but must be above 0.0606"):
        verify(certificate._replace(rho=near))
    first = first_cells(certificate.alphas, certificate.betas)
    row = int(np.searchsorted(certificate.rho, certificate.claims.seed)) - 1
    far = certificate._replace(
        rho=certificate.rho[row:],
        alphas=certificate.alphas[row:],
        betas=certificate.betas[row:],
        ranks=certificate.ranks[first[row] :],
    )
    with pytest.raises(DiffbotError, match="beyond the seed"):
        verify(far)


def test_a_certificate_of_another_law_or_contract_is_found(certificate):
    weaker = CONFIG._replace(data_sheet=CONFIG.data_sheet._replace(omega_max=1.5))
    with pytest.raises(DiffbotError, match=CELL):
        verify(certificate._replace(config=weaker))
    contract = certificate.plan.contract._replace(eps_position=0.062)
    with pytest.raises(DiffbotError, match="not verified"):
        verify(certificate._replace(plan=certificate.plan._replace(contract=contract)))
    wide = CONFIG._replace(tolerance=CONFIG.tolerance._replace(xy_goal_tolerance=1.2))
    with pytest.raises(DiffbotError, match=r"claims\.seed = 1\.3 m, but Omega_L may lead to"):
        verify(certificate._replace(config=wide))


def test_bounds_that_grow_with_the_distance_are_checked_at_each_distance(plan, certificate):
    contract = Contract(position_slope=0.01, theta_slope=0.01, sigma_slope=0.002)
    sloped = maker.certify(CONFIG, plan._replace(contract=contract))
    assert sloped.claims.radius > certificate.claims.radius
    verify(sloped)
    assert drive(sloped, 200, plan.to, sloped.claims.steps, 1, any_memory=False)[0].broken == 0
    for steeper in ({"position_slope": 0.012}, {"theta_slope": 0.015}, {"sigma_slope": 0.02}):
        with pytest.raises(DiffbotError, match="not verified"):
            verify(sloped._replace(plan=plan._replace(contract=contract._replace(**steeper))))
