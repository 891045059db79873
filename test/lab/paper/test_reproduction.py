"""The kept results of the paper's experiments are those of today."""

import json
from pathlib import Path

import pytest

from diffbot_lab.paper.experiment import run_experiment, summarise

KEPT = json.loads((Path(__file__).parents[3] / "docs/results/data/reproduction.json").read_text())


def about(value):
    """Return the same, with tolerances for the floats in it."""
    if isinstance(value, dict):
        return {name: about(one) for name, one in value.items()}
    if isinstance(value, list):
        return [about(one) for one in value]
    return pytest.approx(value, rel=1e-6, abs=1e-9) if isinstance(value, float) else value


@pytest.mark.parametrize("name", ["a", "b"])
def test_the_kept_results_are_todays(name):
    runs, seed = KEPT[name]["runs"], KEPT[name]["seed"]
    found = summarise(name, runs, seed, run_experiment(name, runs, seed))
    assert json.loads(json.dumps(found)) == about(KEPT[name])
