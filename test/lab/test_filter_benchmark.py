"""The benchmark of the filter: drives, figures and command."""

import json
import math

import numpy as np
import pytest
from scipy import stats

from diffbot_control.filter import state
from diffbot_control.filter.config import CALIBRATING, EKF, FNN, FNN_CALIBRATING, FilterConfig, LocalizationConfig
from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.filter.ekf import REJECTED, RELOCATED
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.measurement import FIXES
from diffbot_lab import filter_benchmark
from diffbot_lab.filter_benchmark import (
    COLUMNS,
    SCENARIOS,
    Tracking,
    case_of,
    draw_drive,
    figures_of,
    run_benchmark,
    run_drives,
    run_histories,
)
from diffbot_sim.config import StartPose, WorldConfig
from diffbot_sim.noise import NoiseSource
from diffbot_sim.simulation import measurements_of
from diffbot_sim.world import World
from diffbot_tools import cli

RUNS = 2


def scenario(name):
    return next(one for one in SCENARIOS if one.name == name)


@pytest.fixture(scope="module")
def benchmarked():
    return run_benchmark(RUNS, 1)


def driven(one, rates, filter_name, seed, run):
    """Drive with the filter of the nodes; return errors, P, and step, NIS and outcome of each fix."""
    theta, command = draw_drive(NoiseSource(), seed, run)
    plant = one.plant._replace(sampling_time=1.0 / rates[0])
    sensors = one.sensors._replace(fix_rate=float(rates[1]))
    world = World(WorldConfig(plant, sensors, StartPose(0.0, 0.0, theta), seed, run, one.landmarks))
    config = LocalizationConfig(filter=FilterConfig(filter=filter_name))
    points = tuple(one.landmarks.points().values())
    localization = Localization(config, plant.wheels.wheel_separation, landmarks=points)
    errors, covariances, fixes = [], [], []
    for step in range(60 * rates[0] + 1):
        arrivals, before = world.sense(), localization.outcomes[FIXES].copy()
        for measurement in measurements_of(arrivals):
            localization.on_measurement(measurement)
        estimate = localization.on_odometry(world.odometry())
        error = np.subtract(estimate.pose, world.state.pose)
        errors.append([error[0], error[1], math.remainder(error[2], math.tau)])
        covariances.append(estimate.P)
        outcomes = list((localization.outcomes[FIXES] - before).elements())
        assert len(outcomes) == (len(arrivals.fixes) if step else 0)  # the filter starts with the first fix
        fixes += [(step, localization.filter.last[0, state.NIS], outcome) for outcome in outcomes]
        world.advance(command)
    return np.array(errors), np.array(covariances), fixes


@pytest.mark.parametrize(
    ("name", "rates", "filter_name"),
    [("all", (50, 10), CALIBRATING), ("landmarks", (10, 1), EKF), ("r_10", (10, 1), FNN_CALIBRATING)],
)
def test_a_drive_is_the_same_as_with_the_filter_of_the_nodes(name, rates, filter_name):
    seed, run, skipped = 3, 7, 10 * rates[0]
    errors, covariances, fixes = driven(scenario(name), rates, filter_name, seed, run)
    counted = errors[skipped + 1 :]
    away = np.hypot(counted[:, 0], counted[:, 1])
    nees = np.einsum("ni,nij,nj->n", counted, np.linalg.inv(covariances[skipped + 1 :]), counted)
    late = [one for one in fixes if one[0] > skipped]
    outcomes = [outcome for _, _, outcome in late]
    outside = np.flatnonzero(np.hypot(errors[:, 0], errors[:, 1]) > 0.5)
    back = (outside[-1] + 1) / rates[0] - 40.0 if name == "all" else math.nan
    expected = Tracking(
        position=math.sqrt((away**2).mean()),
        heading=math.sqrt((counted[:, 2] ** 2).mean()),
        largest=away.max(),
        end=away[-1],
        back=back,
        nis=np.mean([nis for _, nis, _ in late]),
        nees=nees.mean(),
        fixes=len(late),
        rejected=outcomes.count(REJECTED),
        relocated=outcomes.count(RELOCATED),
    )
    if name == "all":
        assert expected.rejected > 5
        assert expected.relocated > 0
        assert 0.0 < back < 20.0
    case = case_of(scenario(name), *rates, filter_name)
    np.testing.assert_allclose(run_drives(case, seed, run + 1)[run], expected, rtol=1e-9, atol=1e-9)
    history = run_histories(case, seed, range(run, run + 1))[0]
    deviations = [uncertainty_of(P) for P in covariances]
    np.testing.assert_allclose(history[:, 0], np.hypot(errors[:, 0], errors[:, 1]), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(history[:, 1], errors[:, 2], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(history[:, 2:4], deviations, rtol=1e-9, atol=1e-9)


def test_results_contain_all_cases_and_are_the_figures_of_the_drives(benchmarked):
    results = benchmarked
    assert json.loads(json.dumps(results, allow_nan=False)) == results
    expected = ["_".join(map(str, (one.name, *rates))) for one in SCENARIOS for rates in one.rates]
    assert [one["name"] for one in results["cases"]] == expected
    case = next(one for one in results["cases"] if one["name"] == "outliers_50_10")
    drives = run_drives(case_of(scenario("outliers"), 50, 10, CALIBRATING), 1, RUNS)
    assert case["filters"][CALIBRATING] == figures_of(drives)


def test_runs_do_not_depend_on_threads_and_differ_from_each_other():
    case = case_of(scenario("all"), 10, 5, FNN)
    alone = run_drives(case, 2, 20, threads=1)
    np.testing.assert_array_equal(run_drives(case, 2, 20, threads=3), alone)
    np.testing.assert_array_equal(run_drives(case, 2, 7), alone[:7])
    assert len(np.unique(alone[:, 0])) == 20
    assert not np.isin(run_drives(case, 3, 20)[:, 0], alone[:, 0]).any()


def test_the_command_writes_results_and_figure(tmp_path, monkeypatch, benchmarked, capsys, kept_signal_handlers):
    asked = []
    monkeypatch.setattr(filter_benchmark, "run_benchmark", lambda *given: asked.append(given) or benchmarked)
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


def test_figures_equal_a_calculation_by_hand():
    found = figures_of(
        rows(
            position=(0.3, 0.4, 0.0, 0.0),
            heading=(0.01, 0.02, 0.03, 0.04),
            largest=(1.0, 4.0, 2.0, 0.1),
            end=(0.5, 0.51, math.nan, 0.0),
            back=(1.0, 2.0, 28 * 0.1, 9.0),
            nis=(3.0, 6.0, 2.0, 3.0),
            nees=(1.0, 2.0, 3.0, 8.0),
            fixes=(100, 50, 50, 200),
            rejected=(1, 2, 0, 1),
            relocated=(0, 3, 0, 0),
        )
    )
    expected = {
        "runs": 4,
        "largest": 4.0,
        "lost": 2,  # one error is nan
        "back_median": 2.4,
        "back_max": 9.0,
        "nis": (300 + 300 + 100 + 600) / 400,
        "nis_low": stats.chi2.ppf(0.025, 1200) / 400,
        "nis_high": stats.chi2.ppf(0.975, 1200) / 400,
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
    without_kidnapping = figures_of(rows(position=(0.1, 0.1)))
    assert {key for key, value in without_kidnapping.items() if value is None} == {"back_median", "back_max"}
