"""The quantities in which a peer is ahead of the switching law."""

import numpy as np
import pytest

from diffbot_lab.benchmark.report import peers_ahead
from diffbot_lab.benchmark.statistics import figures_of
from diffbot_sim.batch import COLUMNS

NAMES = ("switching", "graceful")


def figures():
    rng = np.random.default_rng(1)
    outcomes = np.zeros((200, len(COLUMNS)))
    outcomes[:, COLUMNS.index("settling_time")] = rng.uniform(10.0, 11.0, 200)
    outcomes[:, COLUMNS.index("x")] = rng.uniform(0.0, 0.04, 200)
    outcomes[:, COLUMNS.index("reached_time")] = 12.0
    return figures_of(outcomes)


@pytest.fixture
def equal():
    """Results in which a peer has the figures of this project's law."""
    laws = [{"name": name, "label": f"law {name}"} for name in NAMES]
    return {"laws": laws, "cases": [{"name": "mix", "laws": [{"name": one} | figures() for one in NAMES]}]}


@pytest.mark.parametrize(
    ("part", "key", "figure"),
    [("reached_time", "p99", "time of the answer, 99 %"), ("position", "p95", "final position error, 95 %")],
)
def test_only_the_smaller_figure_of_a_peer_is_listed(equal, part, key, figure):
    assert peers_ahead(equal) == []
    own, peer = equal["cases"][0]["laws"]
    peer[part][key] *= 0.9
    (found,) = peers_ahead(equal)
    assert (found["case"], found["peer"], found["figure"]) == ("mix", "law graceful", figure)
    assert (found["peers"], found["ours"]) == (peer[part][key], own[part][key])
    assert not found["apart"]
    peer[part][f"{key}_interval"] = [0.0, 0.001]
    assert peers_ahead(equal)[0]["apart"]
    own["settled"] -= 1
    assert [one["figure"] for one in peers_ahead(equal)] == ["share settled", figure]
