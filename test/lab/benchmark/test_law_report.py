"""Conclusions of the law's benchmark, and the numbers in its tables."""

import copy
import json
from pathlib import Path

import pytest
from page_tables import assert_shows, assert_shows_targets, tables

from diffbot_lab.benchmark.law_cases import LAWS
from diffbot_lab.benchmark.law_report import conclusions, not_leading, page, table, targets

ROOT = Path(__file__).resolve().parents[3]
FIGURES = ("settling_time", "over_bound", "position", "heading", "filter", "path_ratio", "effort", "switches")
NONE = dict.fromkeys(("median", "p95", "p99", "max"))


@pytest.fixture(scope="module")
def kept():
    return json.loads((ROOT / "docs" / "benchmark.json").read_text())


@pytest.fixture
def results(kept):
    return copy.deepcopy(kept)


def law(results, name):
    return next(one for one in results["laws"] if one["name"] == name)


@pytest.fixture
def equal(results):
    """Results in which every peer has exactly the figures of the tuned law."""
    ours = law(results, "tuned")
    for one in results["laws"]:
        if not one["ours"]:
            one.update({key: copy.deepcopy(ours[key]) for key in ("runs", "settled", *FIGURES)})
    return results


def test_with_equal_figures_no_peer_is_better(equal):
    assert not_leading(equal) == []
    assert "Nowhere" in page(equal)


@pytest.mark.parametrize(
    ("part", "key", "figure"),
    [
        ("position", "median", "final position error, median"),
        ("position", "p95", "final position error, 95 %"),
        ("position", "max", "final position error, largest"),
        ("heading", "median", "final heading error, median"),
        ("heading", "p95", "final heading error, 95 %"),
        ("heading", "max", "final heading error, largest"),
        ("settling_time", "median", "settling time of settled runs, median"),
        ("settling_time", "p99", "settling time of settled runs, 99 %"),
    ],
)
def test_a_smaller_error_or_time_of_a_peer_is_listed_alone(equal, part, key, figure):
    own = law(equal, "tuned")[part][key]
    law(equal, "polar")[part][key] = 0.5 * own
    law(equal, "graceful")[part][key] = 2.0 * own
    (lost,) = not_leading(equal)
    assert (lost["peer"], lost["figure"]) == ("polar law, Siegwart's gains", figure)
    assert (lost["ours"], lost["peers"]) == (own, 0.5 * own)


def test_a_larger_share_of_settled_runs_is_listed(equal):
    law(equal, "tuned")["settled"] -= 1
    lost = not_leading(equal)
    assert {one["figure"] for one in lost} == {"share settled"}
    assert len(lost) == sum(not one["ours"] for one in equal["laws"])
    assert lost[0]["ours"] < lost[0]["peers"] <= 1.0


def test_a_peer_without_settled_runs_leads_in_no_time(equal):
    law(equal, "polar_fast")["settling_time"] = dict(NONE)
    assert not_leading(equal) == []
    assert "- |" in page(equal)


def test_the_kept_results_hold_their_conclusions(kept):
    assert {key: kept[key] for key in ("targets", "not_leading")} == conclusions(kept)
    assert [one["name"] for one in kept["laws"]] == [one.name for one in LAWS]
    for one, described in zip(kept["laws"], LAWS, strict=True):
        assert (one["label"], one["source"], one["purpose"]) == described[1:2] + described[4:]


def pick(one, *pairs):
    return [one[part][key] for part, key in pairs]


ERRORS = tuple((part, key) for part in ("position", "heading") for key in ("median", "p95", "max"))


def test_every_number_of_the_page_is_that_of_the_results(kept):
    text = (ROOT / "docs" / "benchmark.md").read_text()
    assert text == page(kept)
    laws, sources, challenges, goals = tables(text)
    assert [row[0] for row in laws[1:]] == [one["label"] for one in kept["laws"]]
    for (_, *cells), one in zip(laws[1:], kept["laws"], strict=True):
        values = [100.0 * one["settled"] / one["runs"]]
        values += pick(one, ("settling_time", "median"), ("settling_time", "p99"), ("over_bound", "median"), *ERRORS)
        values += pick(one, ("path_ratio", "median"), ("effort", "median"))
        assert_shows(cells, [*values, one["switches"]["p99"] if one["ours"] else None])
    assert sources[1:] == [[one["label"], one["source"], one["purpose"]] for one in kept["laws"]]
    for (name, *cells), one in zip(challenges[1:], kept["challenges"], strict=True):
        assert name == f"`{one['name']}`: {one['text']}"
        values = [one["runs"], 100.0 * one["settled"] / one["runs"]]
        values += pick(one, ("settling_time", "median"), ("settling_time", "p99"), *ERRORS[:3], ("filter", "p95"))
        assert_shows(cells, [*values, *pick(one, ("heading", "p95"), ("heading", "max"), ("switches", "p99"))])
    assert_shows_targets(goals, kept["targets"])


def test_the_terminal_shows_the_same_numbers_and_what_is_missed(results):
    law(results, "tuned")["position"]["p95"] = 0.0512
    lines = table(results).splitlines()
    for one in (*results["laws"], *results["challenges"]):
        label = one.get("label", one["name"])
        (line,) = (line for line in lines if line.startswith(f"{label:<30}"))
        values = [100.0 * one["settled"] / one["runs"]]
        values += pick(one, ("settling_time", "median"), ("settling_time", "p99"), *ERRORS)
        values += pick(one, ("path_ratio", "median"), ("effort", "median"), ("switches", "p99"))
        assert_shows(line[len(label) :].replace("%", "").split(), values)
    assert f"Targets: {len(targets(results)) - 1} met, 1 missed" in lines
    assert "  missed: tuned, final position error, 95 % [m]: 0.051, not <= 0.05" in lines
