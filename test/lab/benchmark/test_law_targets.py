"""Each target of the law's benchmark follows its own figure, and no other."""

import copy
import json
from pathlib import Path

import pytest

from diffbot_lab.benchmark.law_report import targets

ROOT = Path(__file__).resolve().parents[3]
RUNS = 10_000
SETTLED = ("settled",)
# Row, target, path of the figure in the row, bound, True for a lower one.
TARGETS = [
    ("tuned", "share settled", SETTLED, RUNS, True),
    ("tuned", "settling time, median [s]", ("settling_time", "median"), 11.7, False),
    ("tuned", "settling time, 99 % [s]", ("settling_time", "p99"), 14.5, False),
    ("tuned", "final position error, 95 % [m]", ("position", "p95"), 0.05, False),
    ("tuned", "final position error, largest [m]", ("position", "max"), 0.08, False),
    ("tuned", "final heading error, largest [rad]", ("heading", "max"), 0.03, False),
    ("tuned", "share with one switch", ("one_switch",), 0.99, True),
    ("precise", "final position error, 95 % [m]", ("position", "p95"), 0.03, False),
    ("precise", "final heading error, largest [rad]", ("heading", "max"), 0.05, False),
    ("precise", "runs still moving", ("moving",), 0, False),
    ("paper_covariance", "share settled", SETTLED, RUNS, True),
    ("paper_covariance", "final heading error, largest [rad]", ("heading", "max"), 0.1, False),
    ("paper_covariance", "final position error, 95 % [m]", ("position", "p95"), 0.06, False),
    *(
        (name, *rest)
        for name in ("random_far", "random_near")
        for rest in (
            ("share settled", SETTLED, 0.999 * RUNS, True),
            ("switches, 99 %", ("switches", "p99"), 4.0, False),
            ("final heading error, largest [rad]", ("heading", "max"), 0.1, False),
        )
    ),
    *(
        (name, "share settled", SETTLED, 0.995 * RUNS, True)
        for name in ("ts_005", "ts_02", "fixes_2_hz", "noise_half", "noise_double", "calibrating", "radius_error",
                     "wheels_limited", "fix_delay")
    ),
]  # fmt: skip
RATIO = ("precise", "the same over the filter's")


def rows(results):
    return {one["name"]: one for one in (*results["laws"], *results["challenges"])}


def put(row, path, value):
    for key in path[:-1]:
        row = row[key]
    row[path[-1]] = value


@pytest.fixture(scope="module")
def kept():
    return json.loads((ROOT / "docs" / "benchmark.json").read_text())


@pytest.fixture
def good(kept):
    """Results in which every figure is well within its bound."""
    results = copy.deepcopy(kept)
    for one in rows(results).values():
        one["runs"], one["settled"], one["one_switch"] = RUNS, RUNS, 1.0
        for part in ("settling_time", "position", "heading", "switches"):
            one[part] = dict.fromkeys(one[part], 0.001)
        one["filter"] = dict.fromkeys(one["filter"], 0.001)
        if "moving" in one:
            one["moving"] = 0
    rows(results)["precise"]["filter"]["p95"] = 1.0
    return results


def missed(results):
    return [(one.case, one.text) for one in targets(results) if not one.met]


def test_the_targets_are_these(good):
    assert sorted((one.case, one.text) for one in targets(good)) == sorted([*(one[:2] for one in TARGETS), RATIO])
    assert missed(good) == []


@pytest.mark.parametrize(("name", "text", "path", "bound", "at_least"), TARGETS, ids=str)
def test_a_figure_decides_its_own_target_alone(good, name, text, path, bound, at_least):
    step = 1 if path in (SETTLED, ("moving",)) else 1e-6
    put(rows(good)[name], path, bound)
    assert missed(good) == []
    put(rows(good)[name], path, bound - step if at_least else bound + step)
    assert missed(good) == [(name, text)]


def test_the_precise_case_is_compared_with_its_own_filter(good):
    row = rows(good)["precise"]
    row["position"]["p95"], row["filter"]["p95"] = 0.0129, 0.01
    assert missed(good) == []
    row["position"]["p95"] = 0.0131
    assert missed(good) == [RATIO]
    row["filter"]["p95"] = None
    assert missed(good) == [RATIO]


def test_a_target_without_a_value_is_missed(good):
    put(rows(good)["tuned"], ("settling_time",), dict.fromkeys(("median", "p95", "p99", "max")))
    assert missed(good) == [("tuned", "settling time, median [s]"), ("tuned", "settling time, 99 % [s]")]
