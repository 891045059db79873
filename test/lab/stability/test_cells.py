"""Ranks of the cells that a box of states meets."""

import math

import numpy as np

from diffbot_lab.stability.checker import Cells, keeps_below
from diffbot_lab.stability.checker_bounds import Box


def small_cells(ranks):
    rows = len(ranks)
    start = np.arange(rows + 1) * 32
    edges, columns = 1.0 + np.arange(rows + 1.0), np.full(rows, 8)
    return Cells(edges, columns, np.full(rows, 4), start, np.array(ranks, np.int16).ravel())


def columns_met(low, high, number):
    edges = -math.pi + 2.0 * math.pi * np.arange(number + 1) / number
    turns = 2.0 * math.pi * np.arange(-3, 4)[:, None]
    return ((edges[:-1] <= high + turns) & (edges[1:] >= low + turns)).any(axis=0)


def test_the_ranks_of_a_box_equal_a_search_over_all_cells():
    rng = np.random.default_rng(7)
    for _ in range(500):
        ranks = rng.integers(0, 10_000, (3, 8, 4))
        cells = small_cells(ranks)
        r, a, b = (np.sort(rng.uniform(low, high, 2)) for low, high in ((0.5, 4.2), (-8.0, 8.0), (-8.0, 8.0)))
        a[1], b[1] = min(a[1], a[0] + 2.0), min(b[1], b[0] + 2.0)
        rows = (cells.rho[:-1] <= r[1]) & (cells.rho[1:] >= r[0])
        expected = ranks[np.ix_(rows, columns_met(*a, 8), columns_met(*b, 4))].max(initial=0)
        beyond = r[1] >= cells.rho[-1]
        assert keeps_below(cells, Box(*r, *a, *b), expected) != beyond
        assert expected == 0 or not keeps_below(cells, Box(*r, *a, *b), expected - 1)


def test_a_touched_cell_counts_and_states_beyond_the_cells_have_no_rank():
    ranks = np.zeros((2, 32))
    ranks[1] = 9
    cells = small_cells(ranks)
    inside = Box(1.2, 1.9, 0.1, 0.2, 0.1, 0.2)
    assert keeps_below(cells, inside, 0)
    assert not keeps_below(cells, inside._replace(r1=2.0), 8)
    assert keeps_below(cells, inside._replace(r1=2.0), 9)
    assert not keeps_below(cells, inside._replace(r1=3.0), 40)
    assert not keeps_below(cells, inside._replace(r1=math.nan), 40)
