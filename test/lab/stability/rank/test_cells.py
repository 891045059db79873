"""Blocks hold every cell that a box of states meets or touches."""

import math

import numpy as np

from diffbot_lab.stability.rank.cells import CellPlan, block_of, make_cells

PLAN = CellPlan(inside=0.5, fine_to=1.0, to=2.0, width=0.1, growth=0.1, columns=24)


def cells_of(block, rows, columns):
    last = min(block.last_row, rows - 1)
    return {
        (row, column % columns)
        for row in range(block.first_row, last + 1)
        for column in range(block.first_column, block.last_column + 1)
    }


def test_rows_and_columns_cover_the_plane():
    cells = make_cells(PLAN)
    assert cells.rho[0] == 0.5
    assert cells.rho[-2] < 2.0 <= cells.rho[-1]
    widths = np.diff(cells.rho)
    np.testing.assert_allclose(widths, 0.1 + 0.1 * np.maximum(0.0, cells.rho[:-1] - 1.0))
    assert cells.alpha[0] < -math.pi
    assert cells.alpha[-1] > math.pi
    np.testing.assert_allclose(np.diff(cells.alpha), 2.0 * math.pi / 24)


def test_a_block_has_the_cells_of_every_state_in_the_box():
    cells, rng = make_cells(PLAN), np.random.default_rng(1)
    rows, columns = len(cells.rho) - 1, 24
    for _ in range(300):
        rho, alpha = sorted(rng.uniform(0.3, 2.3, 2)), np.sort(rng.uniform(-9.0, 9.0, 2))
        block = block_of(cells.rho, columns, *rho, *alpha)
        found = cells_of(block, rows, columns)
        states = rng.uniform((rho[0], alpha[0]), (rho[1], alpha[1]), (40, 2))
        for distance, angle in states:
            row = np.searchsorted(cells.rho, distance, side="right") - 1
            wrapped = angle - 2.0 * math.pi * round(angle / (2.0 * math.pi))
            column = np.searchsorted(cells.alpha, wrapped, side="right") - 1
            if row >= rows:
                assert block.last_row >= rows
            elif row >= 0:
                assert (row, column) in found
        assert 0 <= block.first_column < columns
        assert len(found) <= (block.last_row - block.first_row + 1) * columns


def test_a_cell_that_is_only_touched_counts():
    cells = make_cells(PLAN)
    edge, angle = float(cells.rho[3]), float(cells.alpha[15])
    block = block_of(cells.rho, 24, edge - 0.01, edge, angle - 0.01, angle)
    assert block[:2] == (2, 3)
    assert block[2:] == (14, 15)
    block = block_of(cells.rho, 24, edge, edge + 0.01, angle, angle + 0.01)
    assert block[:2] == (2, 3)
    assert block[2:] == (14, 15)
