"""The benchmark of the filter: its drives, its figures and its command."""

import json
import math

import numpy as np
import pytest
from scipy import stats

from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.filter.gate import REJECTED, RELOCATED
from diffbot_control.filter.landmark_map import LandmarkMap
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements import FIXES
from diffbot_control.filter.options import CALIBRATING, EKF, FNN, FNN_CALIBRATING, FilterConfig
from diffbot_lab.filter_benchmark import command as localization_benchmark
from diffbot_lab.filter_benchmark.cases import SCENARIOS, drive_of, name_of
from diffbot_lab.filter_benchmark.command import COLUMNS, figures_of, run_benchmark, run_drives, run_history
from diffbot_sim.compiled.open_loop import Tracking, start_of, twist_of
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
        position=math.sqrt((away**2).mean()),
        heading=math.sqrt((counted[:, 2] ** 2).mean()),
        largest=away.max(),
        end=away[-1],
        back=back,
        nis=np.mean(alone) if alone else math.nan,
        innovations=len(alone),
        nees=nees.mean(),
        fixes=len(late),
        rejected=verdicts.count(REJECTED),
        relocated=verdicts.count(RELOCATED),
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


def test_any_number_of_threads_gives_the_same():
    case = drive_of(scenario("all"), 10, 5, FNN)
    alone = run_drives(case, 2, 20, threads=1)
    np.testing.assert_array_equal(run_drives(case, 2, 20, threads=3), alone)
    np.testing.assert_array_equal(run_drives(case, 2, 7), alone[:7])
    assert len(np.unique(alone[:, 0])) == 20
    assert not np.isin(run_drives(case, 3, 20)[:, 0], alone[:, 0]).any()


def test_the_command_passes_its_flags_on_and_writes_results_and_figure(
    tmp_path, monkeypatch, benchmarked, capsys, kept_signal_handlers
):
    asked = []
    monkeypatch.setattr(localization_benchmark, "run_benchmark", lambda *given: asked.append(given) or benchmarked)
    out = tmp_path / "deep" / "folder"
    assert cli.main(["benchmark", "localization", "--runs", "3", "--seed", "9", "--out", str(out)]) == 0
    assert json.loads((out / "results.json").read_text()) == benchmarked
    assert sorted(path.name for path in out.iterdir()) == ["localization.png", "results.json"]
    assert "50/10 Hz: 5 % of the fixes are 3 m off" in capsys.readouterr().out
    assert cli.main(["benchmark", "localization", "--out", str(out / "results.json")]) == 1
    assert "cannot write to" in capsys.readouterr().err
    assert asked == [(3, 9)]


def rows(**columns):
    count = max(len(values) for values in columns.values())
    trackings = np.zeros((count, len(COLUMNS)))
    trackings[:, COLUMNS.index("back")] = math.nan
    trackings[:, COLUMNS.index("fixes")] = 10.0
    for name, values in columns.items():
        trackings[:, COLUMNS.index(name)] = values
    return trackings


def test_figures_by_hand():
    found = figures_of(
        rows(
            position=(0.3, 0.4, 0.0, 0.0),
            heading=(0.01, 0.02, 0.03, 0.04),
            largest=(1.0, 4.0, 2.0, 0.1),
            end=(0.5, 0.51, math.nan, 0.0),
            back=(1.0, 2.0, 28 * 0.1, 9.0),
            nis=(3.0, 6.0, 2.0, 3.0),
            innovations=(100, 50, 50, 200),
            nees=(1.0, 2.0, 3.0, 8.0),
            fixes=(100, 60, 50, 190),
            rejected=(1, 2, 0, 1),
            relocated=(0, 3, 0, 0),
        )
    )
    bounds = [stats.chi2.ppf((0.025, 0.975), 3 * n) / n for n in (100, 50, 50, 200)]
    inside = [low <= nis <= high for nis, (low, high) in zip((3.0, 6.0, 2.0, 3.0), bounds, strict=True)]
    assert inside == [True, False, False, True]
    expected = {
        "runs": 4,
        "largest": 4.0,
        "lost": 2,  # one has no error at all
        "back_median": 2.4,
        "back_max": 9.0,
        "nis": (300 + 300 + 100 + 600) / 400,
        "nis_low": stats.chi2.ppf(0.025, 1200) / 400,
        "nis_high": stats.chi2.ppf(0.975, 1200) / 400,
        "nis_inside": 0.5,
        "nees": 3.5,
        "nees_low": stats.chi2.ppf(0.025, 12) / 4,
        "nees_high": stats.chi2.ppf(0.975, 12) / 4,
        "rejected": 0.01,
        "relocations": 0.75,
    }
    assert {name: found[name] for name in expected} == pytest.approx(expected)
    assert found["position"] == pytest.approx({"rmse": 0.25, "median": 0.15, "p95": 0.385})
    assert found["heading"]["rmse"] == pytest.approx(0.01 * math.sqrt(7.5))
    assert figures_of(rows(back=(28 * 0.1,)))["back_max"] == 2.8  # not 2.8000000000000003


def test_figures_without_samples_are_null():
    found = figures_of(rows(position=(0.1, 0.1), nis=(math.nan, math.nan)))
    none = {"back_median", "back_max", "nis", "nis_low", "nis_high", "nis_inside"}
    assert {key for key, value in found.items() if value is None} == none
    json.dumps(found, allow_nan=False)
