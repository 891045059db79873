"""The numbers in the tables of the filter's benchmark, and the missed targets on the terminal."""

import copy
import json
from pathlib import Path

import pytest
from page_tables import assert_shows, assert_shows_targets, tables

from diffbot_control.filter.options import FilterConfig
from diffbot_lab.benchmark.filter_cases import SCENARIOS, SECTIONS, name_of
from diffbot_lab.benchmark.filter_report import conclusions, page_part, table, targets

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def kept():
    return json.loads((ROOT / "docs" / "localization.json").read_text())


def test_the_kept_results_hold_their_conclusions(kept):
    assert kept["targets"] == conclusions(kept)["targets"]
    assert kept["default_filter"] == FilterConfig().filter
    assert [one["name"] for one in kept["cases"]] == [name_of(one.name, *r) for one in SCENARIOS for r in one.rates]


def expected_values(one, kidnapped):
    """Numbers of a row behind rates and filter, the bounds of NIS and NEES in one list with their figure."""
    position = [one["position"][key] for key in ("rmse", "median", "p95")]
    heading = [one["heading"][key] for key in ("rmse", "median", "p95")]
    values = [*position, one["largest"], *heading, one["lost"]]
    values += [one["back_median"], one["back_max"]] if kidnapped else []
    nis = [] if one["nis"] is None else [one["nis"], one["nis_low"], one["nis_high"]]
    inside = None if one["nis_inside"] is None else 100.0 * one["nis_inside"]
    nees = [one["nees"], one["nees_low"], one["nees_high"]]
    return values, nis, inside, nees, [100.0 * one["rejected"], one["relocations"]]


def bounded(cell):
    """Return the three numbers of ``value (low .. high)``; none for ``-``."""
    return [] if cell == "-" else cell.replace("(", "").replace(")", "").replace("..", "").split()


def test_every_number_of_the_page_is_that_of_the_results(kept):
    part = page_part(kept)
    assert part in (ROOT / "docs" / "localization-results.md").read_text()
    goals, *sections = tables(part)
    assert_shows_targets(goals, kept["targets"])
    assert len(sections) == len(SECTIONS)
    for section, (head, *rows) in zip(SECTIONS, sections, strict=True):
        cases = [one for one in kept["cases"] if one["section"] == section]
        expected = [(case, name, one) for case in cases for name, one in case["filters"].items()]
        text = ""
        numbers = iter(expected)
        for row in rows:
            if row[0] == "":
                text = row[1]
                continue
            case, name, one = next(numbers)
            assert text == f"*{case['text']}*"
            assert row[:2] == [f"{case['odometry_rate']}/{case['fix_rate']}", f"`{name}`"]
            values, nis, inside, nees, rest = expected_values(one, "max" in head)
            count = 2 + len(values)
            assert_shows(row[2:count], values)
            assert_shows(bounded(row[count]), nis)
            assert_shows(row[count + 1 : count + 2], [inside])
            assert_shows(bounded(row[count + 2]), nees)
            assert_shows(row[count + 3 :], rest)
        assert next(numbers, None) is None


def test_the_terminal_shows_the_same_numbers_and_what_is_missed(kept):
    results = copy.deepcopy(kept)
    case = next(one for one in results["cases"] if one["name"] == "slip_10_5")
    case["filters"][results["default_filter"]]["lost"] = 3
    lines = table(results).splitlines()
    rows = iter([line for line in lines if line.startswith("ekf")])
    for case in results["cases"]:
        assert f"{case['odometry_rate']}/{case['fix_rate']} Hz: {case['text']}" in lines
        for name, one in case["filters"].items():
            found, *cells = next(rows).replace("%", "").split()
            assert found == name
            values = [one["position"]["rmse"], one["position"]["p95"], one["largest"]]
            values += [one["heading"]["rmse"], one["heading"]["p95"], one["lost"], one["back_median"], one["back_max"]]
            assert_shows(cells, [*values, one["nis"], one["nees"], 100.0 * one["rejected"], one["relocations"]])
    assert next(rows, None) is None
    assert f"Targets: {len(targets(results)) - 1} met, 1 missed" in lines
    assert "  missed: slip_10_5, runs lost: 3.000, not <= 0" in lines
    assert page_part(results).count("**no**") == 1
