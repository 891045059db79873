"""Where a peer is ahead, the promised figures, and the numbers in the page's tables."""

import json
from pathlib import Path

import numpy as np
import pytest
from page_tables import assert_shows, assert_shows_targets, tables

from diffbot_lab.benchmark.law_pages import CASE_PAGES, pages
from diffbot_lab.benchmark.law_statistics import figures_of
from diffbot_lab.benchmark.law_targets import peers_ahead, targets
from diffbot_sim.compiled.batch import COLUMNS

RESULTS = Path(__file__).resolve().parents[3] / "docs" / "results"
DATA = RESULTS / "data"


@pytest.fixture(scope="module")
def kept():
    return json.loads((DATA / "benchmark.json").read_text())


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
    assert "Nowhere" in pages(equal)["index.md"]


@pytest.mark.parametrize(
    ("part", "key", "figure"),
    [
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
    own = equal["cases"][0]["laws"][0]
    mixed = equal["cases"][1]["laws"][0]
    mixed["settling_time"]["median"] = 1.3 * own["settling_time"]["median"]
    mixed["settling_time"]["p99"] = 1.6 * own["settling_time"]["p99"]
    mixed["position"]["p95"] = 1.2 * own["position"]["p95"]
    mixed["settled"] = 150
    mixed["revolutions"] = 1.2
    assert value(equal, "mix", "settling time, median / nominal") == pytest.approx(1.3)
    assert value(equal, "mix", "settling time, 99 % / nominal") == pytest.approx(1.6)
    assert value(equal, "mix", "final position error, 95 % / nominal") == pytest.approx(1.2)
    assert value(equal, "mix", "share settled") == 0.75
    assert value(equal, "every case", "most revolutions within 1 m of the goal") == 1.2
    assert value(equal, "every case", "peers ahead in share settled") == 1.0
    assert value(equal, "every case", "peers behind in fewer than two of three figures") == 1.0
    assert value(equal, "nominal", "final position error, largest [m]") == own["position"]["max"]


def assert_shows_figures(cells, one):
    """Compare the cells of a law, behind its name, with its figures; of the intervals, that of the 99 %."""
    largest, spins, reached = (cell.replace("(", "").replace(")", "").replace(",", "").split() for cell in cells[4:])
    time, position = one["settling_time"], one["position"]
    values = [100.0 * one["settled"] / one["runs"], time["median"], time["p99"], position["p95"]]
    assert_shows([cell.split(" [")[0] for cell in cells[:4]], values)
    assert_shows(largest, [position["max"], one["heading"]["max"]])
    assert_shows(spins, [one["revolutions"], one["spinning"]])
    assert_shows(reached, [one["reached"], one["false_reached"]])
    if time["p99_interval"]:
        assert_shows(cells[2].split("[")[1].strip("]").split(", "), time["p99_interval"])


def test_every_number_of_the_pages_is_that_of_the_results(kept):
    labels = {one["name"]: one["label"] for one in kept["laws"]}
    cases = {one["name"]: one["laws"] for one in kept["cases"]}
    found = pages(kept)
    for page in CASE_PAGES:
        shown = tables(found[page.file])
        for rows, name in zip(shown, page.cases, strict=True):
            for cells, one in zip(rows[1:], cases.pop(name), strict=True):
                assert cells[0] == labels[one["name"]]
                assert_shows_figures(cells[1:], one)
    goals, further = tables(found["targets.md"])
    assert_shows_targets(goals, kept["targets"])
    for cells, (name, (one,)) in zip(further[1:], cases.items(), strict=True):
        assert cells[0].startswith(f"`{name}`: ")
        assert_shows_figures(cells[1:], one)
