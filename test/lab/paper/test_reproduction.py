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


def about(value):
    """The same, with tolerances for the floats in it."""
    if isinstance(value, dict):
        return {name: about(one) for name, one in value.items()}
    if isinstance(value, list):
        return [about(one) for one in value]
    return pytest.approx(value, rel=1e-6, abs=1e-9) if isinstance(value, float) else value


@pytest.mark.parametrize("name", ["a", "b"])
def test_the_kept_results_are_todays(name, kept):
    runs, seed = kept[name]["runs"], kept[name]["seed"]
    found = summarise(name, runs, seed, run_experiment(name, runs, seed))
    assert json.loads(json.dumps(found)) == about(kept[name])


def test_all_claims_hold_in_the_kept_results(kept):
    assert [one.text for one in statements(kept["a"], kept["b"], kept["scan"]) if not one.holds] == []
