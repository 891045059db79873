"""The benchmark of the law: its runs, its figures and its command."""

import copy
import json
import math
import signal

import numpy as np
import pytest

from diffbot_control.filter.options import CALIBRATING
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_lab import cli
from diffbot_lab.benchmark import law as benchmark
from diffbot_lab.benchmark.law import figures_of, run_and_report, run_benchmark, still_moving
from diffbot_lab.benchmark.law_cases import CHALLENGES, DELAYED, LAWS, Challenge, arena_starts, case_of
from diffbot_lab.benchmark.law_report import conclusions
from diffbot_sim.compiled.batch import COLUMNS, Starts, run_batch, run_histories
from diffbot_sim.model.simulator import StartPose, WorldConfig
from diffbot_sim.reference_loop import simulate

ORIGIN = Pose(0.0, 0.0, 0.0)
SPREADS = ("settling_time", "over_bound", "position", "heading", "filter", "path_ratio", "effort", "switches")


@pytest.fixture(scope="module")
def benchmarked():
    return run_benchmark(1, 1)


@pytest.fixture
def results(benchmarked):
    return copy.deepcopy(benchmarked[0])


@pytest.fixture
def here():
    """Keep the handlers of the test process: the command sets its own."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)


def challenge(results, name):
    return next(one for one in results["challenges"] if one["name"] == name)


def test_results_have_the_documented_shape(results):
    assert json.loads(json.dumps(results, allow_nan=False)) == results
    assert [one["name"] for one in results["laws"]] == [one.name for one in LAWS]
    names = [one["name"] for one in results["challenges"]]
    assert names == [*(one.name for one in CHALLENGES), "random_far", "random_near", "fix_delay"]
    for one in (*results["laws"], *results["challenges"]):
        assert 0 <= one["settled"] <= one["runs"]
        for spread in SPREADS:
            values = [one[spread][key] for key in ("median", "p95", "p99", "max")]
            assert values == [None] * 4 or values == sorted(values)
    assert [one["runs"] for one in results["laws"]] == [17] * len(LAWS)
    assert challenge(results, "random_far")["runs"] == 10
    assert isinstance(challenge(results, "precise")["moving"], int)
    assert sum(one["ours"] for one in results["laws"]) == 3
    assert all(one["source"] and one["purpose"] for one in results["laws"])


def test_results_hold_their_conclusions(results):
    assert {key: results[key] for key in ("targets", "not_leading")} == conclusions(results)


def test_the_same_seed_gives_the_same_results(benchmarked):
    outcomes = benchmarked[1]
    for one in LAWS[::4]:
        again = run_batch(case_of(one), Starts(arena_starts()), 1, 0, 17)
        np.testing.assert_array_equal(again, outcomes[one.name])


def test_all_laws_meet_the_same_noise():
    estimates = []
    for one in LAWS:
        history = run_histories(case_of(one), Starts(arena_starts()), 1, 0, 3)
        estimates.append(history[:, 0, 3:6])  # the first estimate is the first fix
        np.testing.assert_array_equal(estimates[-1], estimates[0])
    assert np.abs(estimates[0] - arena_starts()[:3]).max() > 0.01


def test_the_starts():
    starts = arena_starts()
    assert starts.shape == (17, 3)
    np.testing.assert_allclose(np.hypot(starts[:16, 0], starts[:16, 1]), 12.0)
    np.testing.assert_allclose(starts[:8, 2], 0.0)
    np.testing.assert_allclose(starts[8:16, 2], math.radians(220.0 - 360.0))
    np.testing.assert_allclose(starts[16], (-2.0, -5.5, math.radians(30.0)))


def test_figures_by_hand():
    outcomes = np.zeros((4, len(COLUMNS)))
    column = {name: outcomes[:, index] for index, name in enumerate(COLUMNS)}
    column["x"][:] = (0.03, 0.06, 0.0, 0.3)
    column["y"][:] = (0.04, 0.08, 0.0, 0.4)
    column["theta"][:] = (-0.2, 0.1, 0.0, 0.3)
    column["settling_time"][:] = (117 * 0.1, 20.0, 10.0, math.nan)
    column["path_length"][:] = (13.0, 26.0, 13.0, 39.0)
    column["switches"][:] = (1.0, 1.0, 1.0, 3.0)
    column["effort"][:] = 2.0
    figures = figures_of(outcomes, np.full(4, 13.0))
    assert (figures["runs"], figures["settled"]) == (4, 3)
    assert figures["settling_time"]["median"] == 11.7  # not 11.700000000000001
    assert figures["settling_time"]["max"] == 20.0
    assert figures["bound"] == pytest.approx(10.0)
    assert figures["over_bound"]["median"] == pytest.approx(1.17)
    assert figures["position"]["median"] == pytest.approx(0.075)
    assert figures["position"]["max"] == pytest.approx(0.5)
    assert figures["heading"]["max"] == pytest.approx(0.3)
    assert figures["path_ratio"]["median"] == pytest.approx(1.5)
    assert figures["one_switch"] == 0.75
    outcomes[:, 3] = math.nan
    assert figures_of(outcomes, np.full(4, 13.0))["settling_time"] == dict.fromkeys(("median", "p95", "p99", "max"))


def test_still_moving_looks_at_the_last_second():
    histories = np.zeros((4, 101, 8))
    histories[0, 95, 6] = -0.06
    histories[1, 85, 6] = 1.0  # earlier
    histories[2, 95, 6] = 0.04  # slower
    histories[3, 95, 7] = 1.0  # turns in place
    assert still_moving(histories, 0.1) == 1
    assert still_moving(histories, 0.05) == 2


def test_the_row_of_a_recording_is_that_of_the_batch():
    start = arena_starts()[3]
    case = case_of(Challenge("now", "", DELAYED.controller, filter=CALIBRATING))  # the default, as simulate has it
    expected = run_batch(case, Starts(start[np.newaxis]), 5, 2, 1)[0]
    world = WorldConfig(start=StartPose(*start.tolist()), seed=5, run=2)
    row = simulate(world, DELAYED.controller, ORIGIN, case.steps).outcome(ORIGIN, case.xy_tolerance, case.yaw_tolerance)
    np.testing.assert_allclose(row, expected, rtol=1e-6, atol=1e-6)


def test_random_runs_fill_the_disc(monkeypatch):
    calls = []

    def spy(case, starts, seed, first, count, threads):
        calls.append((first, *case.goal, *starts.poses[0]))
        return np.zeros((count, len(COLUMNS)))

    monkeypatch.setattr(benchmark, "run_batch", spy)
    figures = benchmark._random(CHALLENGES[0], 15.0, 2000, 3)
    run, goal_x, goal_y, turn, x, y, heading = np.array(calls).T
    distance = np.hypot(x - goal_x, y - goal_y)
    assert distance.max() <= 15.0
    assert np.median(distance) == pytest.approx(15.0 / math.sqrt(2.0), rel=0.03)  # even by area
    assert figures["bound"] == pytest.approx(np.median(distance) / 1.3)
    np.testing.assert_array_equal(run, np.arange(2000))
    for angle in (turn, heading, np.arctan2(y - goal_y, x - goal_x)):
        assert np.abs(angle).max() <= math.pi
        assert abs(np.exp(1j * angle).mean()) < 0.06
    assert np.unique(goal_x).size == 2000


def test_command_writes_results_and_figure(tmp_path, monkeypatch, benchmarked, capsys, here):
    monkeypatch.setattr(benchmark, "run_benchmark", lambda runs, seed: benchmarked)
    out = tmp_path / "deep" / "folder"
    assert cli.main(["benchmark", "--runs", "1", "--out", str(out)]) == 0
    assert json.loads((out / "results.json").read_text()) == benchmarked[0]
    assert (out / "benchmark.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in out.iterdir()) == ["benchmark.png", "results.json"]
    written = capsys.readouterr()
    assert "switching law, tuned" in written.out
    assert "Targets:" in written.out


def test_command_passes_its_flags_on(tmp_path, monkeypatch, benchmarked, here):
    asked = []

    def fake(runs, seed):
        asked.append((runs, seed))
        return benchmarked

    monkeypatch.setattr(benchmark, "run_benchmark", fake)
    flags = ["--runs", "3", "--seed", "9", "--out", str(tmp_path), "--no-figures"]
    assert cli.main(["benchmark", "switching", *flags]) == 0
    assert asked == [(3, 9)]
    assert [path.name for path in tmp_path.iterdir()] == ["results.json"]


@pytest.mark.parametrize("arguments", [["dancing"], ["--runs", "0"], ["--seed", "-1"], ["--runs", "many"]])
def test_wrong_usage_is_status_2(arguments, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(["benchmark", *arguments])
    assert ended.value.code == 2
    assert capsys.readouterr().err.startswith("usage: diffbot")


def test_a_folder_that_is_a_file_is_refused_before_the_runs(tmp_path, monkeypatch, capsys, here):
    monkeypatch.setattr(benchmark, "run_benchmark", lambda runs, seed: pytest.fail("ran"))
    (tmp_path / "file").write_text("")
    assert cli.main(["benchmark", "--out", str(tmp_path / "file")]) == 1
    assert "cannot write to" in capsys.readouterr().err


def test_interrupted_leaves_nothing_behind(tmp_path, monkeypatch, here):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(benchmark, "run_batch", interrupted)
    assert cli.main(["benchmark", "--runs", "1", "--out", str(tmp_path)]) == 130
    assert list(tmp_path.iterdir()) == []


def test_no_runs_are_refused(tmp_path):
    with pytest.raises(InvalidValueError, match="runs = 0"):
        run_and_report(0, 1, tmp_path, False)
    assert issubclass(InvalidValueError, DiffbotError)
