"""Tuning: the same budget for every law, and the law's own values among the candidates."""

import json

import numpy as np
import pytest

from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_lab.benchmark import tuning as law_tuning
from diffbot_lab.benchmark.cases import TRAINING, cases_named
from diffbot_lab.benchmark.entries import ENTRIES, TUNING, config_of, read_tuning, tuned_values
from diffbot_lab.benchmark.runs import TRAINING_SEED
from diffbot_lab.benchmark.tuning import POPULATION, RUNS, TRAINING_CASES, cost_of, tune_all
from diffbot_sim.batch import COLUMNS

TUNED = tuple(one for one in ENTRIES if one.space)


@pytest.fixture
def landscape(monkeypatch):
    """Replace the runs by outcomes whose cost is quadratic about the middle of each range; collect the arguments."""
    asked = []

    def run(entry, case, values, count, seed):
        asked.append((entry.name, case.name, case.starts, count, seed, dict(values)))
        away = [(values[name] - low) / (high - low) - 0.5 for name, (low, high) in entry.space.items()]
        outcomes = np.zeros((count, len(COLUMNS)))
        outcomes[:, COLUMNS.index("settling_time")] = 10.0 + 50.0 * float(np.square(away).mean())
        return outcomes

    monkeypatch.setattr(law_tuning, "run_case", run)
    return asked


def test_every_law_has_the_same_budget_and_runs(landscape):
    tuning = tune_all(TUNED[:3], 4 * POPULATION)
    assert list(tuning["laws"]) == [one.name for one in TUNED[:3]]
    assert {one["evaluations"] for one in tuning["laws"].values()} == {4 * POPULATION}
    assert {one[1] for one in landscape} == set(TRAINING_CASES)
    assert {one[2:5] for one in landscape} == {(TRAINING, RUNS, TRAINING_SEED)}


def test_tuning_starts_with_the_laws_values_and_never_ends_worse(landscape):
    (entry,) = (one for one in ENTRIES if one.name == "graceful_pose")
    tuning = tune_all((entry,), 8 * POPULATION)
    (nominal,) = cases_named(("nominal",))
    own = config_of(entry, nominal, {})
    first = landscape[0][5]
    assert (first["k_phi"], first["stop_distance"]) == (own.k_phi, own.stop.stop_distance)
    found = tuning["laws"]["graceful_pose"]
    assert found["cost"] < found["untuned_cost"]
    for name, value in found["values"].items():
        assert entry.space[name][0] <= value <= entry.space[name][1]
    assert tune_all((entry,), 8 * POPULATION) == tuning  # by its seed


def outcomes(**columns):
    made = np.zeros((100, len(COLUMNS)))
    made[:, COLUMNS.index("settling_time")] = 12.0
    for name, values in columns.items():
        made[: len(values), COLUMNS.index(name)] = values
    return made


def test_the_cost_of_given_outcomes():
    assert cost_of(outcomes()) == pytest.approx(12.0 / 12.0 + 12.0 / 14.0)
    failed = outcomes(settling_time=[np.nan] * 2)
    assert cost_of(failed) == pytest.approx(1.0 + 60.0 / 14.0 + 20.0 * 0.02)
    assert cost_of(outcomes(turning=[9.5])) == pytest.approx(cost_of(outcomes()) + 0.2)
    assert cost_of(outcomes(x=[0.1] * 100)) == pytest.approx(cost_of(outcomes()) + 2.0)


def test_tuned_values_are_read_and_checked(tmp_path):
    path = tmp_path / "tuning.json"
    path.write_text(json.dumps({"laws": {"graceful": {"values": {"k_phi": 2.0}}}}))
    (graceful,) = (one for one in ENTRIES if one.name == "graceful")
    assert tuned_values(read_tuning(path), graceful) == {"k_phi": 2.0}
    assert tuned_values(read_tuning(path), ENTRIES[0]) == {}
    kept = read_tuning(TUNING)
    assert {name for name, one in kept["laws"].items() if one["values"]} == {one.name for one in TUNED}
    assert all(tuned_values(kept, one) for one in TUNED)
    with pytest.raises(InvalidValueError, match="tuning of graceful = 'gain'"):
        tuned_values({"laws": {"graceful": {"values": {"gain": 2.0}}}}, graceful)
    for text in ("{", "[]", "{}", '{"laws": {"graceful": 5}}'):
        path.write_text(text)
        with pytest.raises(DiffbotError, match=r"tuning\.json is not"):
            read_tuning(path)
    with pytest.raises(InvalidValueError, match="budget = 5"):
        tune_all(TUNED, 5)
