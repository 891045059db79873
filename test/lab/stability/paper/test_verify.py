"""The checker passes what is proved and finds planted mistakes; its own images hold every step of the loop."""

import math

import numpy as np
import pytest
from certificates import (
    CELLS,
    COARSE,
    LAW_13,
    LAW_17,
    PAPER_13,
    PAPER_17,
    START,
    assert_held,
    coarse_certificate,
    steps_from,
)

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.paper import graph, images
from diffbot_lab.stability.paper import verify as checker
from diffbot_lab.stability.paper.certify import certify
from diffbot_lab.stability.paper.file import EXACT_ARC, Certificate, Claims
from diffbot_lab.stability.paper.lookup import TOO_HIGH, RankLookup
from diffbot_lab.stability.paper.verify import Boxes, failing_cells, verify


@pytest.mark.parametrize("loop", [LAW_13, LAW_17._replace(plant=EXACT_ARC)], ids=["13", "17 arc"])
def test_certificates_are_verified(loop):
    verify(coarse_certificate(loop), threads=1)


def test_a_maker_that_forgets_a_part_of_the_steering_is_found(monkeypatch):
    """Its images are then computed without the compiler."""
    usual = images._steering

    def one_end(*given):
        return (usual(*given)[0],) * 2

    monkeypatch.setattr(images, "_steering", one_end)
    monkeypatch.setattr(graph, "_fill_kernel", graph._fill)
    wrong, _ = certify(LAW_13, START, COARSE, threads=1)
    with pytest.raises(DiffbotError, match=r"not verified: [0-9]+ cells; the first, rho"):
        verify(wrong, threads=1)


def test_a_cell_that_an_image_just_touches_is_found():
    """Rounding inward by a single bit would lose it."""
    first = Boxes(*(np.array([one]) for one in (1.0, 1.05, 0.3, 0.35)))
    found, v, omega = checker.commands_of(LAW_13, checker.slices_of(LAW_13, first, 0.04))
    farthest = float(checker.images_of(LAW_13, first.take(found), v, omega)[0][1].max())
    assert 0.7 < farthest < 1.05
    alpha = coarse_certificate(LAW_13).alpha
    ranks = np.zeros((3, len(alpha) - 1), np.int16)
    ranks[1] = 7
    for edge, highest in ((farthest, 7), (math.nextafter(farthest, 2.0), 0)):
        rho = np.array([0.5, edge, 1.2, 1.3])
        lookup = RankLookup(Certificate(LAW_13, rho, alpha, ranks, Claims(1.0, 1.2, 7)))
        assert checker.highest_next(LAW_13, lookup, first, 0.04)[0] == highest


def changed(certificate, row, column, rank):
    ranks = certificate.ranks.copy()
    ranks[row, column] = rank
    return certificate._replace(ranks=ranks)


@pytest.mark.parametrize("rank", [0, 12])
def test_a_cell_left_out_is_found(rank):
    good = coarse_certificate(LAW_13)
    row, column = np.argwhere(good.ranks == rank)[-1]
    bad = changed(good, row, column, -1)
    failing = failing_cells(bad, threads=1)
    assert len(failing)
    neighbours = np.stack(np.divmod(failing, len(good.alpha) - 1), axis=1)
    assert (np.abs(neighbours[:, 0] - row) < 12).all()
    with pytest.raises(DiffbotError, match="not verified"):
        verify(bad, threads=1)


def test_a_rank_that_does_not_fall_is_found():
    good = coarse_certificate(LAW_13)
    row, column = np.argwhere(good.ranks == 5)[0]
    assert len(failing_cells(changed(good, row, column, 4), threads=1)) == 1
    assert len(failing_cells(changed(good, row, column, 6), threads=1)) >= 1


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (lambda c: c._replace(claims=c.claims._replace(radius=c.claims.radius - 0.01)), "claims.radius"),
        (lambda c: c._replace(claims=c.claims._replace(steps=c.claims.steps - 1)), "claims.steps"),
        (lambda c: c._replace(claims=c.claims._replace(start=2.5)), "claims.start"),
        (lambda c: c._replace(alpha=c.alpha * 0.999), "do not cover -pi to pi"),
        (lambda c: c._replace(rho=np.concatenate([[0.06], c.rho[1:]])), "rho begins at 0.06"),
        (lambda c: changed(c, 0, 0, 1), "a step from inside"),
        (lambda c: c._replace(loop=c.loop._replace(eps_theta=0.1)), "cells; the first"),
        (lambda c: c._replace(loop=c.loop._replace(eps_P=0.8, eps_P_leave=1.0)), "cells; the first"),
    ],
)
def test_each_other_claim_is_checked(change, part):
    with pytest.raises(DiffbotError, match=part):
        verify(change(coarse_certificate(LAW_13)), threads=1)


@pytest.mark.parametrize("loop", [PAPER_13, PAPER_17, PAPER_17._replace(plant=EXACT_ARC)], ids=["13", "17", "arc"])
@pytest.mark.parametrize("cell", CELLS[1:4])
def test_every_step_from_a_cell_ends_in_the_checkers_images(loop, cell):
    boxes = Boxes(*(np.array([side]) for side in cell))
    found, v, omega = checker.commands_of(loop, checker.slices_of(loop, boxes, 0.1))
    (r0, r1), (a0, a1) = checker.images_of(loop, boxes.take(found), v, omega)
    assert_held(steps_from(loop, cell, 100, np.random.default_rng(3)), r0, r1, a0, a1)


def test_the_highest_rank_in_a_box_against_a_search():
    good, rng = coarse_certificate(LAW_13), np.random.default_rng(4)
    lookup = RankLookup(good)
    rho = np.sort(rng.uniform(0.1, 2.6, (2, 300)), axis=0)
    alpha = np.sort(rng.uniform(-9.0, 9.0, (2, 300)), axis=0)
    found = lookup.highest((rho[0], rho[1]), (alpha[0], alpha[1]))
    for index in range(300):
        rows = (good.rho[:-1] <= rho[1, index]) & (good.rho[1:] > rho[0, index])
        columns = np.zeros(len(good.alpha) - 1, bool)
        for turn in range(-2, 3):
            low, high = alpha[:, index] + 2.0 * math.pi * turn
            columns |= (good.alpha[:-1] <= high) & (good.alpha[1:] > low)
        part = good.ranks[rows][:, columns]
        expected = int(part.max(initial=0))
        if (part < 0).any() or rho[1, index] >= good.rho[-1]:
            expected = TOO_HIGH
        assert found[index] == expected
