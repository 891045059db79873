"""Checks every claim of a certificate of the law with braking profiles again.

It shares no code with what made the certificate, only its assumptions: plan.py. The core is everything nearer than
the first edge, the cells of rank 0, and Omega_L. Nothing may lead out of it, and each other cell of a rank only to
smaller ones.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from tqdm import tqdm

from diffbot_control.law.configuration import ControllerConfig
from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.check.cells import cell_box, cells_of, failing_kernel
from diffbot_lab.stability.check.commands import Numbers, numbers_of
from diffbot_lab.stability.check.near import farthest_local, longest_step
from diffbot_lab.stability.file import Certificate, first_cells
from diffbot_lab.stability.plan import requesting


def verify(certificate: Certificate, threads: int | None = None) -> None:
    """Check every claim of a certificate.

    Args:
        certificate: as read.
        threads: at a time; one per core by default.

    Raises:
        DiffbotError: naming the first thing that is not proved.
    """
    law, seed = requesting(certificate.config, certificate.plan), certificate.plan.at(certificate.claims.seed)
    loop = numbers_of(law, seed)
    _check_claims(certificate)
    _check_local(certificate, law, loop, seed.contract.sigma_max)
    _check_inside(certificate, loop)
    _check_cells(certificate, law, threads)


def _check_claims(certificate: Certificate) -> None:
    """The claims are no more than what the ranks say."""
    claims, rho, ranks = certificate.claims, certificate.rho, certificate.ranks
    first = first_cells(certificate.alphas, certificate.betas)
    seed = ranks[: first[_rows_within(certificate, claims.seed)]]
    if not (claims.seed < rho[-1] and (seed == 0).all()):
        raise DiffbotError(f"not verified: claims.seed = {claims.seed:g} m, not all within it is in the core")
    core = np.flatnonzero(ranks == 0)
    farthest = rho[np.searchsorted(first, core[-1], side="right")] if len(core) else rho[0]
    if not max(farthest, claims.seed) <= claims.radius:
        raise DiffbotError(f"not verified: claims.radius = {claims.radius:g} m, the core reaches {farthest:g} m")
    starts = ranks[: first[_rows_within(certificate, claims.start)]]
    if not (claims.start < rho[-1] and (starts >= 0).all()):
        raise DiffbotError(f"not verified: claims.start = {claims.start:g} m, a cell within it has no rank")
    if not starts.max(initial=0) <= claims.steps:
        raise DiffbotError(f"not verified: claims.steps = {claims.steps}, a cell within the start has a higher rank")


def _rows_within(certificate: Certificate, distance: float) -> int:
    """Return how many rows begin within a distance [m]."""
    return int((certificate.rho[:-1] <= distance).sum())


def _check_local(certificate: Certificate, law: ControllerConfig, loop: Numbers, sigma_max: float) -> None:
    """Omega_L does not last beyond the seed of the core, by the contract of a robot within it."""
    seed = certificate.claims.seed
    farthest = farthest_local(loop, law, sigma_max)
    if not farthest <= seed:
        raise DiffbotError(f"not verified: claims.seed = {seed:g} m, Omega_L may lead to {farthest:.4f} m")


def _check_inside(certificate: Certificate, loop: Numbers) -> None:
    """A step of Omega_G from nearer than the first edge leads to where all is in the core."""
    inside, seed = float(certificate.rho[0]), certificate.claims.seed
    if not inside > 1.01 * loop.eps_rho:
        raise DiffbotError(f"not verified: rho begins at {inside:g} m, must be above {1.01 * loop.eps_rho:g} m")
    reach = inside + longest_step(loop, inside + loop.eps_rho)
    if not reach <= seed:
        raise DiffbotError(f"not verified: a step from within {inside:g} m may lead to {reach:.4f} m, beyond the seed")


def _check_cells(certificate: Certificate, law: ControllerConfig, threads: int | None) -> None:
    """Every cell of a rank leads only to smaller ranks, or stays in the core."""
    cells, rows = cells_of(certificate), range(len(certificate.alphas))
    loops = [numbers_of(law, certificate.plan.at(float(rho))) for rho in certificate.rho[1:]]
    pool = ThreadPoolExecutor(threads)
    try:
        found = pool.map(lambda row: int(failing_kernel(loops[row], cells, row)), rows)
        for row, failing in zip(rows, tqdm(found, "verify", len(rows), unit="row", disable=None), strict=True):
            if failing >= 0:
                _refuse(certificate, row, failing)
    finally:
        pool.shutdown(cancel_futures=True)


def _refuse(certificate: Certificate, row: int, failing: int) -> None:
    at = int(first_cells(certificate.alphas, certificate.betas)[row]) + failing
    r0, r1, a0, a1, b0, b1 = cell_box(cells_of(certificate), row, failing)
    meaning = "may leave the core" if certificate.ranks[at] == 0 else "may lead to a rank that is not smaller"
    where = f"rho {r0:.4f} to {r1:.4f} m, alpha {a0:.4f} to {a1:.4f} rad, beta {b0:.4f} to {b1:.4f} rad"
    raise DiffbotError(f"not verified: the cell {where}, of rank {certificate.ranks[at]}, {meaning}")
