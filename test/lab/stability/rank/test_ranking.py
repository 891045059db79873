"""Ranks are longest ways to the core, and the core is all that recurs: against graphs walked cell by cell."""

import numpy as np
import pytest

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.rank.ranking import UNRANKED, Graph, rank_cells

ROWS, COLUMNS = 12, 6


def random_graph(seed):
    """Cells that mostly lead inwards by 1 to 3 rows, and some that do not."""
    rng = np.random.default_rng(seed)
    blocks, counts = [], []
    for row in range(ROWS):
        for _ in range(COLUMNS):
            number = int(rng.integers(1, 4))
            counts.append(number)
            for _ in range(number):
                # Up to the middle a cell may lead back to its own row or farther out.
                last = row - 1 + int(rng.random() < 0.3 and row < ROWS // 2)
                first = max(0, last - int(rng.integers(0, 3)))
                left = int(rng.integers(0, COLUMNS))
                blocks.append((first, last, left, left + int(rng.integers(0, 3))))
    start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return Graph(np.array(blocks, np.int16), start, ROWS, COLUMNS)


def successors(graph):
    """Return the set of cells that each cell leads to; OUT if beyond."""
    result = []
    for cell in range(ROWS * COLUMNS):
        found = set()
        for first, last, left, right in graph.blocks[graph.start[cell] : graph.start[cell + 1]]:
            for row in range(first, last + 1):
                found |= {
                    row * COLUMNS + column % COLUMNS if row < ROWS else "out" for column in range(left, right + 1)
                }
        result.append(found)
    return result


def walk(start, following):
    found, waiting = set(start), list(start)
    while waiting:
        for one in following[waiting.pop()]:
            if one != "out" and one not in found:
                found.add(one)
                waiting.append(one)
    return found


@pytest.mark.parametrize("seed", range(2))
def test_core_and_ranks_of_random_graphs(seed):
    graph = random_graph(seed)
    following = successors(graph)
    inside_rows = 2
    on_cycles = {cell for cell in range(ROWS * COLUMNS) if cell in walk(following[cell] - {"out"}, following)}
    recurrent = rank_cells(graph, inside_rows, lambda alive: None).recurrent.ravel()
    assert on_cycles
    assert on_cycles <= set(np.flatnonzero(recurrent))
    core = walk(set(np.flatnonzero(recurrent)) | set(range(inside_rows * COLUMNS)), following)
    ranks = rank_cells(graph, inside_rows, lambda alive: None).ranks.ravel()
    assert set(np.flatnonzero(ranks == 0)) == core
    # Outside of the core: one more than the highest rank that follows.
    for cell in np.flatnonzero(ranks > 0):
        assert ranks[cell] == 1 + max((int(ranks[one]) for one in following[cell]), default=0)
    assert (ranks != UNRANKED).all()
    assert ranks.max() >= 3


def test_what_may_leave_the_cells_has_no_rank():
    blocks = np.array([(0, -1, 0, 0), (0, 0, 0, 0), (3, 5, 0, 0), (2, 2, 0, 0)], np.int16)
    graph = Graph(blocks, np.arange(5, dtype=np.int64), 4, 1)
    # Row 1 leads to row 0; row 2 to row 3 and beyond, and row 3 to row 2.
    with pytest.raises(DiffbotError, match="no certificate"):
        rank_cells(graph, 1, lambda alive: None)
    blocks[3] = (1, 1, 0, 0)
    assert rank_cells(graph, 1, lambda alive: None).ranks.ravel().tolist() == [0, 1, UNRANKED, 2]
