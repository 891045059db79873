"""The page docs/results/reproduction.md: today's results, from which every number and claim follows."""

import json
from pathlib import Path

import pytest
from reproduction import statements

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


def test_all_claims_hold_in_the_kept_results(kept):
    assert [one.text for one in statements(kept["a"], kept["b"], kept["scan"]) if not one.holds] == []
