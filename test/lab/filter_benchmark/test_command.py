"""The benchmark of the filter: its drives, its figures and its command."""

import json
import math

import numpy as np
import pytest

from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.filter.gate import REJECTED, RELOCATED
from diffbot_control.filter.landmark_map import LandmarkMap
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements import FIXES
from diffbot_control.filter.options import CALIBRATING, EKF, FNN, FNN_CALIBRATING, FilterConfig
from diffbot_lab.filter_benchmark import command as localization_benchmark
from diffbot_lab.filter_benchmark.cases import SCENARIOS, drive_of, name_of
from diffbot_lab.filter_benchmark.command import figures_of, run_benchmark, run_drives, run_history
from diffbot_sim.compiled.open_loop import Tracking, drive, start_of, twist_of
from diffbot_sim.model.simulator import StartPose, World, WorldConfig
from diffbot_sim.reference_loop import measurements_of
from diffbot_tools import cli

RUNS = 2


def scenario(name):
    return next(one for one in SCENARIOS if one.name == name)


@pytest.fixture(scope="module")
def benchmarked():
    return run_benchmark(RUNS, 1)


def driven(case, filter_name, seed, run):
    """The same drive with the world and the filter of the nodes: rows of error, P, NIS, and verdict on the fix."""
    sensors, plant = case.robot.sensors, case.robot.plant
    points = case.robot.landmarks.tolist()
    landmarks = LandmarkMap(tuple(range(len(points))), *(tuple(p[axis] for p in points) for axis in (0, 1)))
    world = World(WorldConfig(plant, sensors, StartPose(*start_of(seed, run)), seed, run, landmarks))
    config = LocalizationConfig(filter=FilterConfig(filter=filter_name))
    localization = Localization(config, plant.wheels.wheel_separation, landmarks=bool(points))
    noted = []
    monitor = localization.monitor
    record = monitor.record
    monitor.record = lambda source, nis, verdict, *more: (
        noted.append((source.sensor, nis, verdict)),
        record(source, nis, verdict, *more),
    )
    errors, covariances, fixes = [], [], []
    for step in range(case.steps + 1):
        arrivals = world.sense()
        noted.clear()
        for measurement in measurements_of(arrivals):
            localization.on_measurement(measurement)
        estimate = localization.on_odometry(world.odometry())
        error = np.subtract(estimate.pose, world.state.pose)
        errors.append([error[0], error[1], math.remainder(error[2], math.tau)])
        covariances.append(estimate.P)
        found = [(nis, verdict) for sensor, nis, verdict in noted if sensor == FIXES]
        assert len(found) == (len(arrivals.fixes) if step else 0)  # the first fix is where it starts
        fixes += [(step, *one, len(noted) == 1) for one in found]
        world.advance(twist_of(seed, run))
    return np.array(errors), np.array(covariances), fixes


@pytest.mark.parametrize(
    ("name", "rates", "filter_name"),
    [("all", (50, 10), CALIBRATING), ("landmarks", (10, 1), EKF), ("r_10", (10, 1), FNN_CALIBRATING)],
)
def test_the_drive_is_that_of_the_nodes_filter(name, rates, filter_name):
    case = drive_of(scenario(name), *rates, filter_name)
    seed, run = 3, 7
    errors, covariances, fixes = driven(case, filter_name, seed, run)
    t_s, skipped = 1.0 / rates[0], case.skipped
    counted = errors[skipped + 1 :]
    away = np.hypot(counted[:, 0], counted[:, 1])
    nees = np.einsum("ni,nij,nj->n", counted, np.linalg.inv(covariances[skipped + 1 :]), counted)
    late = [one for one in fixes if one[0] > skipped]
    alone = [nis for _, nis, _, only in late if only]
    verdicts = [verdict for _, _, verdict, _ in late]
    outside = np.flatnonzero(np.hypot(errors[:, 0], errors[:, 1]) > 0.5)
    back = (outside[-1] + 1) * t_s - 40.0 if name == "all" else math.nan
    expected = Tracking(
        math.sqrt((away**2).mean()),
        math.sqrt((counted[:, 2] ** 2).mean()),
        away.max(),
        away[-1],
        back,
        np.mean(alone) if alone else math.nan,
        len(alone),
        nees.mean(),
        len(late),
        verdicts.count(REJECTED),
        verdicts.count(RELOCATED),
    )
    if name == "all":
        assert expected.rejected > 5
        assert expected.relocated > 0
        assert 0.0 < back < 20.0
    row = localization_benchmark.run_drives(case, seed, run + 1)[run]
    np.testing.assert_allclose(row, expected, rtol=1e-9, atol=1e-9)
    history = run_history(case, seed, run)
    deviations = [uncertainty_of(P) for P in covariances]
    np.testing.assert_allclose(history[:, 0], np.hypot(errors[:, 0], errors[:, 1]), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(history[:, 1], errors[:, 2], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(history[:, 2:], deviations, rtol=1e-9, atol=1e-9)


def test_results_are_those_of_the_drives(benchmarked):
    results = benchmarked
    assert json.loads(json.dumps(results, allow_nan=False)) == results
    expected = [name_of(one.name, *rates) for one in SCENARIOS for rates in one.rates]
    assert [one["name"] for one in results["cases"]] == expected
    case = next(one for one in results["cases"] if one["name"] == "outliers_50_10")
    drives = run_drives(drive_of(scenario("outliers"), 50, 10, CALIBRATING), 1, RUNS)
    assert case["filters"][CALIBRATING] == figures_of(drives)


def test_any_number_of_threads_gives_the_same_and_compiled_or_not():
    case = drive_of(scenario("all"), 10, 5, FNN)
    alone = run_drives(case, 2, 20, threads=1)
    for threads in (3, None):
        np.testing.assert_array_equal(run_drives(case, 2, 20, threads), alone)
    np.testing.assert_array_equal(run_drives(case, 2, 7), alone[:7])
    assert len(np.unique(alone[:, 0])) == 20
    assert not np.isin(run_drives(case, 3, 20)[:, 0], alone[:, 0]).any()
    np.testing.assert_allclose(alone[2], drive(case, 2, 2, np.empty((0, 4))), rtol=1e-9)


def test_the_command_passes_its_flags_on_and_writes_results_and_figure(
    tmp_path, monkeypatch, benchmarked, capsys, kept_signal_handlers
):
    asked = []
    monkeypatch.setattr(localization_benchmark, "run_benchmark", lambda *given: asked.append(given) or benchmarked)
    out = tmp_path / "deep" / "folder"
    assert cli.main(["benchmark", "localization", "--runs", "3", "--seed", "9", "--out", str(out)]) == 0
    assert asked == [(3, 9)]
    assert json.loads((out / "results.json").read_text()) == benchmarked
    assert sorted(path.name for path in out.iterdir()) == ["localization.png", "results.json"]
    assert "50/10 Hz: 5 % of the fixes are 3 m off" in capsys.readouterr().out
    assert cli.main(["benchmark", "localization", "--out", str(out / "results.json")]) == 1
    assert "cannot write to" in capsys.readouterr().err
    assert len(asked) == 1
