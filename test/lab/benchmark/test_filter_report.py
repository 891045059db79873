"""The numbers in the tables of the filter's benchmark, and the missed targets on the terminal."""

import json
from pathlib import Path

import pytest
from page_tables import assert_shows, tables

from diffbot_lab.benchmark.filter_cases import SECTIONS
from diffbot_lab.benchmark.filter_pages import cases_part

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def kept():
    return json.loads((ROOT / "docs/results/data/localization.json").read_text())


def bounded(cell):
    """Return the three numbers of ``value (low .. high)``; none for ``-``."""
    return [] if cell == "-" else cell.replace("(", "").replace(")", "").replace("..", "").split()


def bounds_of(one, name):
    return [] if one[name] is None else [one[name], one[f"{name}_low"], one[f"{name}_high"]]


def test_every_number_of_the_cases_is_that_of_the_results(kept):
    shown = iter(tables(cases_part(kept, *SECTIONS)))
    for text in dict.fromkeys(one["text"] for one in kept["cases"]):
        cases = [one for one in kept["cases"] if one["text"] == text]
        (_, *accuracy), (head, *rest) = next(shown), next(shown)
        expected = [(case, name, one) for case in cases for name, one in case["filters"].items()]
        for first, second, (case, name, one) in zip(accuracy, rest, expected, strict=True):
            rates = f"{case['odometry_rate']}/{case['fix_rate']}"
            assert first[:2] == second[:2] == [rates, f"`{name}`"]
            position, heading = one["position"], one["heading"]
            values = [position["rmse"], position["p95"], one["largest"], heading["rmse"], heading["p95"], one["lost"]]
            assert_shows(first[2:], values)
            assert_shows(bounded(second[2]), bounds_of(one, "nis"))
            assert_shows(bounded(second[4]), bounds_of(one, "nees"))
            inside = None if one["nis_inside"] is None else 100.0 * one["nis_inside"]
            assert_shows([second[3], *second[5:7]], [inside, 100.0 * one["rejected"], one["relocations"]])
            assert ("back" in head[-1]) == (case["filters"]["ekf"]["back_max"] is not None)
            if "back" in head[-1]:
                assert_shows(second[7].split(", "), [one["back_median"], one["back_max"]])
    assert next(shown, None) is None
