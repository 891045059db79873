"""Cells without a way to the core have no rank."""

import numpy as np
import pytest

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.rank.ranking import UNRANKED, Graph, rank_cells


def test_what_may_leave_the_cells_has_no_rank():
    blocks = np.array([(0, -1, 0, 0), (0, 0, 0, 0), (3, 5, 0, 0), (2, 2, 0, 0)], np.int16)
    graph = Graph(blocks, np.arange(5, dtype=np.int64), 4, 1)
    # Row 1 leads to row 0; row 2 to row 3 and beyond, and row 3 to row 2.
    with pytest.raises(DiffbotError, match="no certificate"):
        rank_cells(graph, 1, lambda alive: None)
    blocks[3] = (1, 1, 0, 0)
    assert rank_cells(graph, 1, lambda alive: None).ranks.ravel().tolist() == [0, 1, UNRANKED, 2]
