"""The benchmark of the laws: its cases, its runs and its command."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from diffbot_lab.benchmark import report, runs
from diffbot_lab.benchmark.cases import arena_starts, cases_named, starts_named, world_of
from diffbot_lab.benchmark.entries import (
    ENTRIES,
    OWN_NAME,
    config_of,
    entries_for,
    is_run,
    tuned_values,
)
from diffbot_lab.benchmark.runs import TRAINING_SEED, BenchmarkOptions, run_benchmark, run_case, run_paths
from diffbot_tools import cli

PEER = "paper"
"""The same law with other gains, so no other law is compiled."""
FEW = BenchmarkOptions(1, 7, (PEER,), ("nominal", "random_near", "precise"))
(NOMINAL,) = cases_named(("nominal",))
BY_NAME = {one.name: one for one in (*ENTRIES, *entries_for((PEER,)))}


@pytest.fixture(scope="module")
def benchmarked():
    return run_benchmark(FEW)


def test_the_same_seed_gives_the_same_results(benchmarked):
    results, outcomes = benchmarked
    both = [OWN_NAME, PEER]
    assert [[one["name"] for one in row["laws"]] for row in results["cases"]] == [both, both, [OWN_NAME]]
    for name, found in outcomes.items():
        values = tuned_values(results["tuning"], BY_NAME[name])
        np.testing.assert_array_equal(run_case(BY_NAME[name], NOMINAL, values, 17, 7), found)


def test_a_law_or_case_that_is_given_twice_runs_once():
    assert [one.name for one in entries_for((PEER, OWN_NAME, PEER))] == [OWN_NAME, PEER]
    assert cases_named(("nominal", "nominal")) == (NOMINAL,)


def test_all_laws_have_the_same_noise():
    first = [run_paths(BY_NAME[name], NOMINAL, {}, arena_starts()[2], 3, 1)[:, 0, 3:6] for name in (OWN_NAME, PEER)]
    np.testing.assert_array_equal(*first)
    assert np.ptp(first[0][:, 0]) > 0.01


def test_random_starts_are_uniform_in_distance_and_angle_and_differ_by_kind_and_seed():
    for kind, low, high in (("far", 0.2, 15.0), ("near", 0.0, 1.0)):
        poses = starts_named(kind, 4000, 3)
        distance = np.hypot(poses[:, 0], poses[:, 1])
        assert np.quantile(distance, (0.0, 0.5, 1.0)) == pytest.approx([low, 0.5 * (low + high), high], abs=0.05 * high)
        for angle in (poses[:, 2], np.arctan2(poses[:, 1], poses[:, 0])):
            assert abs(np.exp(1j * angle).mean()) < 0.05
    kinds = [starts_named(kind, 9, seed) for kind, seed in (("far", 3), ("far", 4), ("training", 3))]
    assert len({one.tobytes() for one in kinds}) == 3
    np.testing.assert_array_equal(starts_named("arena", 20, 3)[17:], arena_starts()[:3])


@pytest.mark.parametrize("name", ["dead_time_02_unknown", "lag_030", "mix"])
def test_every_law_receives_the_data_sheet_of_the_case_and_the_plant_agrees_with_it(name):
    (case,) = cases_named((name,))
    sheet, plant = case.sheet, world_of(case)[0]
    latency = 0.2 if name == "dead_time_02_unknown" else sheet.get("command_latency", 0.0)
    lag, a_max = sheet.get("drive_time_constant", 0.0), sheet.get("linear.x.max_acceleration", math.inf)
    assert (plant.command_delay, plant.drive_time_constant, plant.acceleration_max) == (latency, lag, a_max)
    assert plant.angular_acceleration_max == sheet.get("angular.z.max_acceleration", math.inf)
    for entry in (one for one in ENTRIES if is_run(one, case)):
        known = config_of(entry, case, {}).data_sheet
        assert (known.v_max, known.omega_max) == (1.3, 1.5 if name == "mix" else 2.6), entry.name
        assert known.wheel_max * known.wheels.wheel_radius == pytest.approx(1.3)
        assert (known.command_latency, known.a_max) == (sheet.get("command_latency", 0.0), a_max)
        assert known.drive_time_constant == lag


def test_additional_runs_of_the_own_law_do_not_change_the_starts_of_the_peers():
    """Random starts depend on their number, so they are drawn once for all laws."""
    asked = BenchmarkOptions(1, 7, (PEER,), ("random_near",), own_runs=2)
    (row,) = run_benchmark(asked)[0]["cases"]
    assert [one["runs"] for one in row["laws"]] == [34, 17]
    (case,) = cases_named(("random_near",))
    alike = runs.figures_of(run_case(BY_NAME[PEER], case, {}, 17, 7, 34))
    assert row["laws"][1] == {"name": PEER} | alike


def test_the_command_passes_its_options_and_writes_results_and_figure(
    tmp_path, monkeypatch, benchmarked, capsys, kept_signal_handlers
):
    asked = []
    monkeypatch.setattr(report, "run_benchmark", lambda options: asked.append(options) or (benchmarked[0], {}))
    out = tmp_path / "deep" / "folder"
    flags = ["--runs", "3", "--seed", "9", "--law", "graceful", "--law", "a.b:C"]
    flags += ["--case", "mix", "--tuning", "file.json", "--own-runs", "5", "--out", str(out)]
    assert cli.main(["benchmark", "switching", *flags]) == 0
    assert asked == [BenchmarkOptions(3, 9, ("graceful", "a.b:C"), ("mix",), Path("file.json"), 5)]
    assert [path.name for path in out.iterdir()] == ["results.json"]  # a figure needs the nominal case
    monkeypatch.setattr(report, "run_benchmark", lambda options: benchmarked)
    assert cli.main(["benchmark", "switching", "--runs", "1", "--law", PEER, "--out", str(out)]) == 0
    assert json.loads((out / "results.json").read_text()) == benchmarked[0]
    assert sorted(path.name for path in out.iterdir()) == ["benchmark.png", "results.json"]
    assert "nominal: bounded speeds, nothing added" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--law", "dancing"], "law = 'dancing': must be package.module:Class or a registered law: docking, "),
        (["--law", "no_such_module:Law"], "ModuleNotFoundError"),
        (["--law", "math:pi"], "a class derived from diffbot_control.law.Law"),
        (["--law", "diffbot_control.law.switching:SwitchingLaw"], "another law of the comparison is called switching"),
        (["--case", "sunny"], "case = 'sunny': must be one of nominal, "),
        (["--seed", str(TRAINING_SEED)], "the laws were tuned with this seed"),
        (["--tuning", "no_such.json"], "cannot read no_such.json"),
    ],
)
def test_invalid_values_end_in_one_line_before_the_runs(
    arguments, text, tmp_path, monkeypatch, capsys, kept_signal_handlers
):
    monkeypatch.setattr(runs, "run_case", lambda *_: pytest.fail("ran"))
    assert cli.main(["benchmark", "switching", "--out", str(tmp_path), *arguments]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert text in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["localization", "--law", "graceful"], "unrecognized arguments: --law graceful"),
        (["tune", "--seed", "3"], "unrecognized arguments: --seed 3"),
        (["switching", "--budget", "24"], "unrecognized arguments: --budget 24"),
    ],
)
def test_each_part_accepts_only_its_own_options(arguments, error, capsys):
    with pytest.raises(SystemExit) as caught:
        cli.main(["benchmark", *arguments])
    assert caught.value.code == 2
    assert error in capsys.readouterr().err
