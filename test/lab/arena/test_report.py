"""Where a peer is ahead, the promised figures, and the numbers in the page's tables."""

import numpy as np
import pytest
from benchmark_page import beside_peers
from page_tables import tables

from diffbot_lab.arena.report.targets import peers_ahead, targets
from diffbot_lab.arena.statistics import figures_of
from diffbot_sim.compiled.batch import COLUMNS


def figures(seed=1):
    rng = np.random.default_rng(seed)
    outcomes = np.zeros((200, len(COLUMNS)))
    outcomes[:, COLUMNS.index("settling_time")] = rng.uniform(10.0, 11.0, 200)
    outcomes[:, COLUMNS.index("x")] = rng.uniform(0.0, 0.04, 200)
    outcomes[:, COLUMNS.index("reached_time")] = 12.0
    return figures_of(outcomes)


@pytest.fixture
def equal():
    """Results in which a peer and a bound have the figures of this project's law."""
    names = ("switching", "polar", "truth")
    laws = [
        {"name": name, "label": f"law {name}", "source": "-", "purpose": "-", "ours": name == names[0]}
        | {"bound": name == "truth", "tuned": True}
        for name in names
    ]
    cases = [
        {"name": name, "text": name, "table": "speed", "laws": [{"name": one} | figures() for one in names]}
        for name in ("nominal", "mix")
    ]
    return {"laws": laws, "cases": cases, "tuning": {"laws": {}}, "starts": 17, "runs_of_each_start": 1} | {
        "own_runs_of_each_start": 1,
        "seed": 7,
        "duration": 60.0,
        "xy_tolerance": 0.1,
        "yaw_tolerance": 0.1,
    }


def test_with_equal_figures_no_peer_is_ahead(equal):
    assert peers_ahead(equal) == []
    (beside,) = tables("\n".join(beside_peers(equal)))
    assert not any("**" in cell for row in beside for cell in row)


@pytest.mark.parametrize(
    ("part", "key", "figure"),
    [
        ("reached_time", "p99", "time of the answer, 99 %"),
        ("settling_time", "median", "settling time, median"),
        ("settling_time", "p99", "settling time, 99 %"),
        ("position", "p95", "final position error, 95 %"),
    ],
)
def test_a_smaller_figure_of_a_peer_is_listed_alone(equal, part, key, figure):
    own, peer, bound = equal["cases"][1]["laws"]
    peer[part][key] *= 0.9
    bound[part][key] *= 0.5  # a bound is no peer
    (found,) = peers_ahead(equal)
    assert (found["case"], found["peer"], found["figure"]) == ("mix", "law polar", figure)
    assert (found["peers"], found["ours"]) == (peer[part][key], own[part][key])
    assert not found["apart"]
    peer[part][f"{key}_interval"] = [0.0, 0.001]
    assert peers_ahead(equal)[0]["apart"]
    own["settled"] -= 1
    assert [one["figure"] for one in peers_ahead(equal)] == ["share settled", figure]


def value(results, case, text):
    (found,) = (one for one in targets(results) if (one.case, one.text) == (case, text))
    return found.value


def test_targets_follow_their_figures(equal):
    nominal, mixed = equal["cases"][0]["laws"][0], equal["cases"][1]["laws"][0]
    mixed["reached_time"] |= {"median": 17.0, "p99": 41.0}
    mixed["answered_by"]["60"] = 150
    mixed["false_reached_interval"] = [0.001, 0.02]
    mixed["position"]["p95"] = 0.06
    mixed["settled"] = 100
    mixed["revolutions"] = 1.2
    met = {one.text: one.met for one in targets(equal) if one.case == "mix"}
    assert value(equal, "mix", "share answered by 60 s") == 0.75
    assert value(equal, "mix", "share settled") == 0.5
    assert met == {
        "share answered by 60 s": False,
        "time of the answer, median [s]": True,
        "time of the answer, 99 % [s]": False,
        "share answered falsely, upper bound": False,
        "share settled": False,
        "settling time, 99 % [s]": mixed["settling_time"]["p99"] <= 19.5,
        "final position error, 95 % [m]": True,
    }
    assert value(equal, "every case", "most revolutions within 1 m of the goal") == 1.2
    assert value(equal, "nominal", "final position error, 95 % [m]") == nominal["position"]["p95"]
