"""The pages of docs/results/reproduction: today's results, from which every number and claim follows."""

import copy
import json
from pathlib import Path

import pytest
from page_tables import assert_shows, tables
from reproduction import pages, statements

from diffbot_lab.paper.experiment import run_experiment, summarise

RESULTS = Path(__file__).resolve().parents[3] / "docs" / "results"


@pytest.fixture(scope="module")
def kept():
    return json.loads((RESULTS / "data" / "reproduction.json").read_text())


def assert_close(found, kept_value, where=""):
    if isinstance(kept_value, dict):
        assert found.keys() == kept_value.keys(), where
        for key in kept_value:
            assert_close(found[key], kept_value[key], f"{where}.{key}")
    elif isinstance(kept_value, list):
        assert len(found) == len(kept_value), where
        for number, (one, other) in enumerate(zip(found, kept_value, strict=True)):
            assert_close(one, other, f"{where}[{number}]")
    else:
        expected = pytest.approx(kept_value, rel=1e-6, abs=1e-9) if isinstance(kept_value, float) else kept_value
        assert found == expected, where


@pytest.mark.parametrize("name", ["a", "b"])
def test_the_kept_results_are_todays(name, kept):
    runs, seed = kept[name]["runs"], kept[name]["seed"]
    found = summarise(name, runs, seed, run_experiment(name, runs, seed))
    assert_close(json.loads(json.dumps(found)), kept[name])


def test_the_pages_are_made_from_the_kept_results(kept):
    found = {path.name: path.read_text() for path in (RESULTS / "reproduction").glob("*.md")}
    assert found == pages(kept["a"], kept["b"], kept["scan"])


def test_all_claims_hold_in_the_kept_results(kept):
    assert [one.text for one in statements(kept["a"], kept["b"], kept["scan"]) if not one.holds] == []
    assert "NO |" not in pages(kept["a"], kept["b"], kept["scan"])["index.md"]


def change(results, law=None, setting=None, **changes):
    for one in results["groups"]:
        if law in (None, one["law"]) and setting in (None, one["setting"]):
            for key, value in changes.items():
                if isinstance(value, dict):
                    one[key] = {**one[key], **value}
                else:
                    one[key] = value


MUTATIONS = {
    "|v| never": lambda a, b, scan: change(b, "law 17", "quiet", max_speed=1.3001),
    "Law (13) brings": lambda a, b, scan: change(a, "law 13", "raw", abs_theta={"0.95": 1.9}),
    "Law (13) brings the position": lambda a, b, scan: change(a, "law 13", "raw", position={"0.95": 0.21}),
    "Law (17) brings |theta|": lambda a, b, scan: change(b, "law 17", "ekf", abs_theta={"0.5": 0.11}),
    "Law (17) leaves": lambda a, b, scan: change(a, "law 17", "quiet", position={"0.5": 0.09}),
    "Law (17) leaves a lateral": lambda a, b, scan: change(a, "law 17", "raw", position={"0.5": 0.09}),
    "B: all 16 starts": lambda a, b, scan: change(b, None, "raw", reached_local_region=799),
    "With the rear sector": lambda a, b, scan: b["literal_rear_sector"]["raw as printed"]["position"].update(
        {"0.5": 0.3}
    ),
    "Without position noise": lambda a, b, scan: scan["law 13"][2].update(agree_interval=[0.49, 0.6]),
    "Without position noise at": lambda a, b, scan: scan["law 13"][0].update(agree_interval=[0.09, 0.11]),
    "Without it and": lambda a, b, scan: scan["law 17"][0].update(agree_interval=[0.2, 0.25]),
    "Without it, law (17)": lambda a, b, scan: scan["law 17"][2].update(median_sd_v=0.19),
    "In no reading": lambda a, b, scan: scan["law 17"][9].update(agree_positive_y=0.02),
}


@pytest.mark.parametrize("start", MUTATIONS)
def test_the_page_says_no_to_what_does_not_hold(start, kept):
    a, b, scan = (copy.deepcopy(kept[name]) for name in ("a", "b", "scan"))
    MUTATIONS[start](a, b, scan)
    failing = [one.text for one in statements(a, b, scan) if not one.holds]
    assert len(failing) == 1
    assert failing[0].startswith(start)
    lines = [line for line in pages(a, b, scan)["index.md"].splitlines() if line.endswith("| NO |")]
    assert len(lines) == 1
    assert lines[0].startswith("| " + start.replace("|", "\\|"))


def test_every_number_of_the_pages_is_that_of_the_results(kept):
    found = pages(kept["a"], kept["b"], kept["scan"])
    claims, distances = tables(found["index.md"])
    (ranks,), (near, box), (readings,) = (tables(found[f"{one}.md"]) for one in ("end-states", "noise", "rear-sector"))
    groups = [one for one in kept["a"]["groups"] if "paper" in one]
    expected = [(one, name) for one in groups for name in ("x", "y", "theta")]
    for row, (one, name) in zip(ranks[1:], expected, strict=True):
        assert row[:2] == [f"{one['law']}, {one['setting']}", f"{name} [{'rad' if name == 'theta' else 'm'}]"]
        paper, ours = one["paper"][name], one[name]
        assert_shows(row[2:6], [paper["value"], ours["0.5"], ours["0.05"], ours["0.95"]])
        assert row[6] == ("yes" if paper["inside_1_99"] else "**no**")
        assert_shows(row[7:], [100.0 * paper["share_below"]])
    expected = [(content, one) for content in (kept["a"], kept["b"]) for one in content["groups"]]
    for row, (content, one) in zip(distances[1:], expected, strict=True):
        assert row[:2] == [f"{content['experiment'].upper()}, {one['label']}", one["setting"]]
        assert row[2] == f"{one['reached_local_region']} of {one['runs']}"
        values = [one[part][key] for part in ("position", "abs_theta") for key in ("0.5", "0.95")]
        assert_shows(row[3:], [*values, one["path_length"]["0.5"]])
    for shown, law in ((near, "law 13"), (box, "law 17")):
        for row, one in zip(shown[1:], kept["scan"][law], strict=True):
            assert row.pop(0) == one["reading"]
            share, interval = row[-4 if law == "law 17" else -2].split(" % ")
            values = [one["agree"], *one["agree_interval"]]
            assert_shows([share, *interval.strip("[]").split(", ")], [100.0 * value for value in values])
            if law == "law 17":
                assert_shows(row[:1], [one["eps_P"]])
                assert_shows(row[2:], [one["median_abs_y"], 100.0 * one["positive_y"], one["median_sd_v"]])
            else:
                assert_shows(row[1:], [one["median_sd_v"]])
    assert len(claims) == 11
    for row, (name, one) in zip(readings[1:], kept["b"]["literal_rear_sector"].items(), strict=True):
        assert row[0] == name
        assert_shows(row[1:], [one[part][key] for part in ("position", "abs_theta") for key in ("0.5", "0.95")])
