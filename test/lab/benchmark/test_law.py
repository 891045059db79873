"""The arena: its runs, its figures and its command."""

import copy
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.schema import to_dict
from diffbot_lab import cli
from diffbot_lab.benchmark import law as benchmark
from diffbot_lab.benchmark import law_effects, law_tuning
from diffbot_lab.benchmark.law import ArenaOptions, run_benchmark, still_moving, takes_part
from diffbot_lab.benchmark.law_cases import CASES, OWN, arena_starts, cases_named, starts_named, world_of
from diffbot_lab.benchmark.law_entries import ENTRIES, OWN_NAME, config_of, entries_for
from diffbot_lab.benchmark.law_report import conclusions
from diffbot_lab.benchmark.law_runs import case_of, run_case, run_paths
from diffbot_sim.compiled.batch import COLUMNS

ROOT = Path(__file__).resolve().parents[3]
PEER = "rotate_drive_rotate"
SPREADS = ("settling_time", "position", "heading", "filter", "effort", "switches", "reached_time")
FEW = ArenaOptions(1, 7, (PEER,), ("nominal", "random_near", "precise"))
(NOMINAL,) = cases_named(("nominal",))
BY_NAME = {one.name: one for one in ENTRIES}


@pytest.fixture(scope="module")
def benchmarked():
    return run_benchmark(FEW)


@pytest.fixture
def results(benchmarked):
    return copy.deepcopy(benchmarked[0])


def test_results_have_the_documented_shape(results):
    assert json.loads(json.dumps(results, allow_nan=False)) == results
    assert [one["name"] for one in results["laws"]] == [OWN_NAME, PEER]
    assert [one["name"] for one in results["cases"]] == ["nominal", "random_near", "precise"]
    assert [[one["name"] for one in row["laws"]] for row in results["cases"]] == [[OWN_NAME, PEER]] * 2 + [[OWN_NAME]]
    for one in (one for row in results["cases"] for one in row["laws"]):
        assert one["runs"] == 17
        low, high = one["settled_interval"]
        assert 0.0 <= low <= one["settled"] / 17 <= high <= 1.0
        for spread in SPREADS:
            values = [one[spread][key] for key in ("median", "p95", "p99", "max")]
            assert values == [None] * 4 or values == sorted(values)
    assert isinstance(results["cases"][2]["moving"], int)
    assert {key: results[key] for key in ("targets", "ahead")} == conclusions(results)


def test_the_same_seed_gives_the_same_results(benchmarked):
    tuning = law_tuning.read_tuning(None)
    for name, found in benchmarked[1].items():
        values = law_tuning.tuned_values(tuning, BY_NAME[name])
        np.testing.assert_array_equal(run_case(BY_NAME[name], NOMINAL, values, 17, 7), found)


def test_more_runs_of_the_own_law_begin_with_those_of_the_peers(benchmarked):
    for name in ("nominal", "random_near"):
        (case,) = cases_named((name,))
        many, few = run_case(BY_NAME[OWN_NAME], case, {}, 51, 7), run_case(BY_NAME[OWN_NAME], case, {}, 17, 7, 51)
        np.testing.assert_array_equal(many[:17], few)
    more = ArenaOptions(1, 7, own_runs=3)
    assert [more.runs_of(BY_NAME[name]) for name in (OWN_NAME, "switching_tuned", PEER)] == [51, 17, 17]


def test_all_laws_meet_the_same_noise():
    first = [run_paths(BY_NAME[name], NOMINAL, {}, arena_starts()[2], 3, 1)[:, 0, 3:6] for name in (OWN_NAME, PEER)]
    np.testing.assert_array_equal(*first)
    assert np.ptp(first[0][:, 0]) > 0.01


def test_a_bound_is_fed_with_the_true_pose():
    assert case_of(BY_NAME["truth"], NOMINAL, {}).feedback != case_of(BY_NAME[PEER], NOMINAL, {}).feedback


def test_the_starts():
    starts = arena_starts()
    np.testing.assert_allclose(np.hypot(starts[:16, 0], starts[:16, 1]), 12.0)
    np.testing.assert_allclose(starts[8:16, 2], math.radians(220.0 - 360.0))
    np.testing.assert_array_equal(starts_named("arena", 20, 3)[17:], starts[:3])
    far, near, docking = (starts_named(kind, 4000, 3) for kind in ("far", "near", "docking"))
    for poses, low, high in ((far, 0.2, 15.0), (near, 0.0, 1.0)):
        distance = np.hypot(poses[:, 0], poses[:, 1])
        assert low <= distance.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < distance.max() <= high
        assert np.median(distance) == pytest.approx(0.5 * (low + high), rel=0.05)  # even by distance
        for angle in (poses[:, 2], np.arctan2(poses[:, 1], poses[:, 0])):
            assert abs(np.exp(1j * angle).mean()) < 0.05
    assert -3.0 <= docking[:, 0].min() < docking[:, 0].max() <= -0.5
    assert np.abs(docking[:, 1]).max() == pytest.approx(0.3, abs=0.01)
    assert not np.array_equal(starts_named("training", 9, 3), starts_named("far", 9, 3))
    assert not np.array_equal(starts_named("far", 9, 3), starts_named("far", 9, 4))


def test_every_law_has_the_data_sheet_of_every_case():
    for case in CASES:
        for entry in (one for one in ENTRIES if takes_part(one, case)):
            sheet = config_of(entry, case, {}).data_sheet
            limits = (sheet.v_max, sheet.omega_max, sheet.wheel_max * sheet.wheels.wheel_radius)
            assert limits == (1.3, 1.5 if case.name.endswith("mix") else 2.6, pytest.approx(1.3)), entry.name
            known = sheet.command_latency, sheet.drive_time_constant, sheet.a_max
            found = (case.sheet.get("command_latency", 0.0), case.sheet.get("drive_time_constant", 0.0))
            assert known == (*found, case.sheet.get("linear.x.max_acceleration", math.inf))


def test_the_plant_of_a_known_case_is_that_of_its_data_sheet():
    for case in CASES:
        actuators = world_of(case)[0].actuators
        if case.name != "dead_time_02_unknown":
            assert actuators.command_delay == case.sheet.get("command_latency", 0.0)
        assert actuators.drive_time_constant == case.sheet.get("drive_time_constant", 0.0)
        assert actuators.acceleration_max == case.sheet.get("linear.x.max_acceleration", math.inf)
        assert actuators.angular_acceleration_max == case.sheet.get("angular.z.max_acceleration", math.inf)
    (unknown,) = cases_named(("dead_time_02_unknown",))
    assert (world_of(unknown)[0].actuators.command_delay, dict(unknown.sheet)) == (0.2, {})


def test_only_this_law_runs_in_its_own_cases():
    own = [case for case in CASES if case.table == OWN]
    assert own
    assert all([one.name for one in ENTRIES if takes_part(one, case)] == [OWN_NAME] for case in own)


def test_still_moving_looks_at_the_last_second():
    histories = np.zeros((4, 101, 9))
    histories[0, 95, 6] = -0.06
    histories[1, 85, 6] = 1.0  # earlier
    histories[2, 95, 6] = 0.04  # slower
    histories[3, 95, 7] = 1.0  # turns in place
    assert still_moving(histories, 0.1) == 1
    assert still_moving(histories, 0.05) == 2


def test_command_writes_results_and_figure(tmp_path, monkeypatch, benchmarked, capsys, kept_signal_handlers):
    monkeypatch.setattr(benchmark, "run_benchmark", lambda options: benchmarked)
    out = tmp_path / "deep" / "folder"
    assert cli.main(["benchmark", "--runs", "1", "--law", PEER, "--out", str(out)]) == 0
    assert json.loads((out / "results.json").read_text()) == benchmarked[0]
    assert (out / "benchmark.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in out.iterdir()) == ["benchmark.png", "results.json"]
    written = capsys.readouterr()
    assert "rotate, drive, rotate" in written.out
    assert "Targets:" in written.out


def test_command_passes_its_flags_on(tmp_path, monkeypatch, benchmarked, kept_signal_handlers):
    asked = []
    monkeypatch.setattr(benchmark, "run_benchmark", lambda options: asked.append(options) or benchmarked)
    flags = ["--runs", "3", "--seed", "9", "--out", str(tmp_path), "--no-figures", "--law", "polar", "--law", "a.b:C"]
    flags += ["--case", "mix", "--tuning", "file.json", "--own-runs", "5"]
    assert cli.main(["benchmark", "switching", *flags]) == 0
    assert asked == [ArenaOptions(3, 9, ("polar", "a.b:C"), ("mix",), Path("file.json"), 5)]
    assert [path.name for path in tmp_path.iterdir()] == ["results.json"]


@pytest.mark.parametrize("arguments", [["dancing"], ["--runs", "0"], ["--seed", "-1"], ["--runs", "many"]])
def test_wrong_usage_is_status_2(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(["benchmark", *arguments])
    assert ended.value.code == 2
    assert capsys.readouterr().err.startswith("usage: diffbot")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--law", "dancing"], "law = 'dancing': must be package.module:Class or one of aicardi, "),
        (["--law", "no_such_module:Law"], "ModuleNotFoundError"),
        (["--law", "math:pi"], "a law with a text 'name'"),
        (["--case", "sunny"], "case = 'sunny': must be one of nominal, "),
        (["--seed", str(law_tuning.TRAINING_SEED)], "another one than that of the tuning"),
        (["--tuning", "no_such.json"], "cannot read no_such.json"),
    ],
)
def test_bad_values_end_in_one_line(arguments, text, tmp_path, capsys, kept_signal_handlers):
    assert cli.main(["benchmark", "--out", str(tmp_path), *arguments]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert text in line
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_a_file_is_refused_before_the_runs(tmp_path, monkeypatch, capsys, kept_signal_handlers):
    monkeypatch.setattr(benchmark, "run_benchmark", lambda options: pytest.fail("ran"))
    (tmp_path / "file").write_text("")
    assert cli.main(["benchmark", "--out", str(tmp_path / "file")]) == 1
    assert "cannot write to" in capsys.readouterr().err


def test_interrupted_leaves_nothing_behind(tmp_path, monkeypatch, kept_signal_handlers):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(benchmark, "run_case", interrupted)
    assert cli.main(["benchmark", "--runs", "1", "--out", str(tmp_path)]) == 130
    assert list(tmp_path.iterdir()) == []


def test_no_runs_are_refused():
    with pytest.raises(InvalidValueError, match="runs = 0"):
        run_benchmark(ArenaOptions(0, 1))
    assert issubclass(InvalidValueError, DiffbotError)


def test_the_example_of_a_law_runs_in_the_arena(tmp_path):
    command = [sys.executable, ROOT / "examples" / "straight_line.py", "--runs", "2", "--no-figures"]
    command += ["--case", "nominal", "--out", tmp_path]
    done = subprocess.run(command, check=False, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "plain Python" not in done.stderr
    (row,) = json.loads((tmp_path / "results.json").read_text())["cases"]
    ours, example = row["laws"]
    assert (ours["name"], example["name"]) == (OWN_NAME, "straight_line")
    assert example["settled"] > 0.8 * example["runs"] == 0.8 * 34
    assert example["settling_time"]["median"] > 9.2  # 12 m at 1.3 m/s


def test_a_foreign_law_has_its_own_name_and_no_tuning():
    ours, polar, foreign = entries_for(("polar", "diffbot_lab.laws.polar:Polar"))
    assert (ours.name, polar, foreign.law) == (OWN_NAME, BY_NAME["polar"], "diffbot_lab.laws.polar:Polar")
    assert not foreign.space


def test_each_effect_is_of_one_changed_parameter():
    by_case = {case.name: config_of(BY_NAME[OWN_NAME], case, {}) for case in cases_named(law_effects.CASES)}
    seen = set()
    for one in law_effects.variants():
        before = to_dict(by_case[one.case.name])
        after = to_dict(config_of(BY_NAME[OWN_NAME], one.case, {}))
        changed = {name for name in before if before[name] != after[name]}
        assert changed == ({one.parameter} if one.parameter else set())
        if one.parameter:
            ratio = after[one.parameter] / before[one.parameter]
            # Half of five steps is two.
            assert ratio in (0.5, 2.0) or (one.parameter, ratio) == ("settling_steps", 0.4)
        seen.add((one.case.name, one.parameter, one.value))
    assert len(seen) == len(list(law_effects.variants())) == 2 + 2 * 2 * 18 + 2 * 7


def test_effects_are_those_of_runs_with_that_value(monkeypatch):
    monkeypatch.setattr(law_effects, "PARAMETERS", ("react",))
    monkeypatch.setattr(law_effects, "CASES", ("nominal",))
    results = law_effects.run_effects(1, 7)
    medians = [row["settling_time"]["median"] for row in results["rows"]]
    for values, median in zip(({}, {"react": 0.25}, {"react": 1.0}), medians, strict=True):
        settling = run_case(BY_NAME[OWN_NAME], NOMINAL._replace(own=values), {}, 17, 7)
        assert median == pytest.approx(np.median(settling[:, COLUMNS.index("settling_time")]), abs=1e-9)
    assert len(set(medians)) == 3
    head, _, first, second, _ = law_effects.law_table(results)
    assert head == "| parameter | value | nominal: settled [%] | nominal: median [s] | nominal: 95 % [m] |"
    assert first.startswith(f"| as it is |  | 100.0 | {medians[0]:.1f} |")
    assert second.startswith(f"| `react` | 0.25 | 100.0 | {medians[1]:.1f} |")


@pytest.mark.parametrize(("runs", "seed", "name"), [(0, 7, "runs"), (1, law_tuning.TRAINING_SEED, "seed")])
def test_effects_refuse_bad_values(runs, seed, name):
    with pytest.raises(InvalidValueError, match=name):
        law_effects.run_effects(runs, seed)
