"""The benchmark of the filter: its drives, its figures, what is concluded from them, its command and its tables."""

import copy
import json
import math
import signal
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from diffbot_control.filter.covariance import uncertainty_of
from diffbot_control.filter.gate import FIX, REJECTED, RELOCATED
from diffbot_control.filter.landmark_map import LandmarkMap
from diffbot_control.filter.localization import Localization, LocalizationConfig
from diffbot_control.filter.options import CALIBRATING, EKF, FILTERS, FNN, FilterConfig
from diffbot_core.errors import InvalidValueError
from diffbot_lab import cli
from diffbot_lab.benchmark import filter as localization_benchmark
from diffbot_lab.benchmark.filter import COLUMNS, figures_of, run_benchmark, run_drives, run_history
from diffbot_lab.benchmark.filter_cases import RATES, SCENARIOS, SECTIONS, drive_of, name_of
from diffbot_lab.benchmark.filter_report import page_part, table, targets
from diffbot_sim.compiled.open_loop import Errors, Tracking, drive, nees_of, start_of, twist_of
from diffbot_sim.compiled.scalar_belief import Covariance
from diffbot_sim.model.simulator import StartPose, World, WorldConfig

ROOT = Path(__file__).resolve().parents[3]
RUNS = 2
NOTHING = np.empty((0, 4))


def scenario(name):
    return next(one for one in SCENARIOS if one.name == name)


def wrapped(angle):
    return np.remainder(angle + math.pi, 2.0 * math.pi) - math.pi


@pytest.fixture(scope="module")
def benchmarked():
    return run_benchmark(RUNS, 1)


@pytest.fixture
def results(benchmarked):
    return copy.deepcopy(benchmarked)


@pytest.fixture
def here():
    """Keep the handlers of the test process: the command sets its own."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)


def driven(case, filter_name, seed, run):
    """The same drive with the world and the filter of the nodes: rows of error, P, NIS, and verdict on the fix."""
    sensors, plant = case.robot.sensors, case.robot.plant
    points = case.robot.landmarks.tolist()
    landmarks = LandmarkMap(tuple(range(len(points))), *(tuple(p[axis] for p in points) for axis in (0, 1)))
    world = World(WorldConfig(plant, sensors, StartPose(*start_of(seed, run)), seed, run, landmarks))
    config = LocalizationConfig(filter=FilterConfig(filter=filter_name))
    localization = Localization(config, plant.wheels.wheel_separation)
    noted = []
    monitor = localization.monitor
    record = monitor.record
    monitor.record = lambda kind, nis, verdict: (noted.append((kind, nis, verdict)), record(kind, nis, verdict))
    errors, covariances, fixes = [], [], []
    for step in range(case.steps + 1):
        arrivals = world.sense()
        sightings = [one.measurement for one in arrivals.landmarks]
        noted.clear()
        for measurement in (*arrivals.fixes, *arrivals.headings, *sightings):
            localization.on_measurement(measurement)
        estimate = localization.on_odometry(world.odometry())
        error = np.subtract(estimate.pose, world.state.pose)
        errors.append([error[0], error[1], wrapped(error[2])])
        covariances.append(estimate.P)
        found = [(nis, verdict) for kind, nis, verdict in noted if kind == FIX]
        assert len(found) == (len(arrivals.fixes) if step else 0)  # the first fix is where it starts
        fixes += [(step, *one, len(noted) == 1) for one in found]
        world.advance(twist_of(seed, run))
    return np.array(errors), np.array(covariances), fixes


@pytest.mark.parametrize("filter_name", FILTERS)
@pytest.mark.parametrize(
    ("name", "rates"),
    [("nominal", (10, 5)), ("r_10", (10, 1)), ("all", (10, 5)), ("all", (50, 10)), ("compass", (10, 1)),
     ("landmarks", (10, 1))],
)  # fmt: skip
def test_the_drive_is_that_of_the_nodes_filter(filter_name, name, rates):
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


def test_compiled_or_not():
    case = drive_of(scenario("all"), 10, 5, FNN)
    np.testing.assert_allclose(run_drives(case, 5, 3)[2], drive(case, 5, 2, NOTHING), rtol=1e-9)


def test_any_number_of_threads_gives_the_same():
    case = drive_of(scenario("all"), 10, 5, FNN)
    alone = run_drives(case, 2, 50, threads=1)
    for threads in (2, 3, 7, None):
        np.testing.assert_array_equal(run_drives(case, 2, 50, threads), alone)
    np.testing.assert_array_equal(run_drives(case, 2, 21), alone[:21])
    assert len(np.unique(alone[:, 0])) == 50
    assert not np.isin(run_drives(case, 3, 50)[:, 0], alone[:, 0]).any()


def test_the_drives_fill_their_ranges():
    v, omega = np.array([twist_of(1, run) for run in range(1000)]).T
    heading = np.array([start_of(1, run).theta for run in range(1000)])
    for values, low, high in ((v, 0.4, 1.0), (omega, -0.3, 0.3), (heading, -math.pi, math.pi)):
        assert stats.kstest(values, stats.uniform(low, high - low).cdf).pvalue > 1e-3


def test_the_scenarios_are_what_they_say():
    for rates in RATES:
        case = drive_of(scenario("kidnapped"), *rates, EKF)
        assert case.steps == 60 * rates[0]
        assert case.skipped == 10 * rates[0]
        errors = run_history(case, 1, 0)[:, 0]
        at = 20 * rates[0]
        assert errors[:at].max() < 0.6
        assert errors[at] == pytest.approx(3.6, abs=0.5)
        assert drive_of(scenario("all"), *rates, EKF).kidnapped == 40 * rates[0]
        assert drive_of(scenario("slip"), *rates, EKF).kidnapped == -1
    plain = drive_of(scenario("nominal"), 10, 5, EKF).robot
    assert plain.plant.drive_noise == plain.plant.encoder_noise == 0.05
    assert (plain.sensors.eps_x_max, plain.sensors.eps_y_max, plain.sensors.eps_theta_max) == (0.3, 0.3, 0.17)
    assert drive_of(scenario("radius"), 10, 5, EKF).robot.plant.right_radius_error == 0.02
    assert drive_of(scenario("r_10"), 10, 5, EKF).robot.sensors.fix_covariance_scale == 10.0
    assert drive_of(scenario("r_01"), 10, 5, EKF).robot.sensors.fix_covariance_scale == 0.1
    compass = drive_of(scenario("compass"), 10, 1, EKF).robot.sensors
    assert (compass.heading_rate, compass.heading_error_max) == (10.0, pytest.approx(5.0 * math.pi / 180.0))
    seen = drive_of(scenario("landmarks"), 10, 1, EKF).robot
    assert (seen.sensors.landmark_rate, seen.sensors.landmark_range, len(seen.landmarks)) == (5.0, 100.0, 2)
    for name in ("slip", "all"):
        plant = drive_of(scenario(name), 10, 5, EKF).robot.plant
        assert (plant.slip_right, plant.slip_start, plant.slip_duration) == (0.6, 20.0, 3.0)
    for name in ("outliers", "all"):
        sensors = drive_of(scenario(name), 10, 5, EKF).robot.sensors
        assert (sensors.fix_outlier, sensors.fix_outlier_distance) == (0.05, 3.0)


def test_nees_is_that_of_the_matrix():
    rng = np.random.default_rng(1)
    for _ in range(50):
        A, error = rng.normal(size=(3, 3)), rng.normal(size=3)
        P = A @ A.T + 1e-3 * np.eye(3)
        z = 0.0
        packed = Covariance(P[0, 0], P[0, 1], P[0, 2], z, z, P[1, 1], P[1, 2], z, z, P[2, 2], z, z, z, z, z)
        assert nees_of(Errors(*error), packed) == pytest.approx(error @ np.linalg.inv(P) @ error, rel=1e-9)


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
    assert found["runs"] == 4
    assert found["position"] == {
        "rmse": pytest.approx(0.25),
        "median": pytest.approx(0.15),
        "p95": pytest.approx(0.385),
    }
    assert found["heading"]["rmse"] == pytest.approx(0.01 * math.sqrt(7.5))
    assert found["largest"] == 4.0
    assert figures_of(rows(back=(28 * 0.1,)))["back_max"] == 2.8  # not 2.8000000000000003
    assert found["lost"] == 2  # one is nowhere
    assert (found["back_median"], found["back_max"]) == (2.4, 9.0)
    assert found["nis"] == pytest.approx((300 + 300 + 100 + 600) / 400)
    assert found["nis_low"] == pytest.approx(stats.chi2.ppf(0.025, 1200) / 400)
    assert found["nis_high"] == pytest.approx(stats.chi2.ppf(0.975, 1200) / 400)
    bounds = [stats.chi2.ppf((0.025, 0.975), 3 * n) / n for n in (100, 50, 50, 200)]
    inside = [low <= nis <= high for nis, (low, high) in zip((3.0, 6.0, 2.0, 3.0), bounds, strict=True)]
    assert inside == [True, False, False, True]
    assert found["nis_inside"] == 0.5
    assert found["nees"] == 3.5
    assert found["nees_low"] == pytest.approx(stats.chi2.ppf(0.025, 12) / 4)
    assert found["nees_high"] == pytest.approx(stats.chi2.ppf(0.975, 12) / 4)
    assert found["rejected"] == pytest.approx(0.01)
    assert found["relocations"] == 0.75


def test_what_there_is_none_of():
    found = figures_of(rows(position=(0.1, 0.1), nis=(math.nan, math.nan)))
    none = {"back_median", "back_max", "nis", "nis_low", "nis_high", "nis_inside"}
    assert {key for key, value in found.items() if value is None} == none
    json.dumps(found, allow_nan=False)


def test_results_have_the_documented_shape(results):
    assert json.loads(json.dumps(results, allow_nan=False)) == results
    expected = [name_of(one.name, *rates) for one in SCENARIOS for rates in one.rates]
    assert [one["name"] for one in results["cases"]] == expected
    assert len(expected) == len(set(expected)) == 8 * 3 + 2
    assert {one["section"] for one in results["cases"]} == set(SECTIONS)
    for case in results["cases"]:
        assert tuple(case["filters"]) == FILTERS
        for one in case["filters"].values():
            assert one["runs"] == RUNS
            assert 0.0 < one["position"]["median"] <= one["position"]["p95"] <= one["largest"]
            assert (one["back_max"] is not None) == (case["scenario"] in ("kidnapped", "all"))
            assert (one["nis"] is None) == (case["scenario"] in ("compass", "landmarks"))


def test_results_are_those_of_the_drives(results):
    case = next(one for one in results["cases"] if one["name"] == "outliers_50_10")
    drives = run_drives(drive_of(scenario("outliers"), 50, 10, CALIBRATING), 1, RUNS)
    assert case["filters"][CALIBRATING] == figures_of(drives)


def test_the_same_seed_gives_the_same_results(results):
    assert run_benchmark(RUNS, 1, threads=1) == results


def doctored(results, good):
    """Put every figure that a target looks at on one side of its bound."""
    for case in results["cases"]:
        for name, one in case["filters"].items():
            if "position" in one:
                value = 0.001 if good else 10.0
                # The ratio of two variants has to be bad, too.
                right = case["scenario"] == "nominal" and name == EKF
                one["position"] = dict.fromkeys(one["position"], 0.001 if right else value)
                one["heading"] = dict.fromkeys(one["heading"], value)
            one["lost"] = 0 if good else 1
            one["back_median"] = one["back_max"] = 0.4 if good else 3.1
            one["nis_low"], one["nis"], one["nis_high"] = (2.9, 3.0, 3.1) if good else (3.1, 3.0, 2.9)
            one["nees_high"], one["nees"] = 3.3, 3.3 if good else 3.4
    return results


def test_targets_are_computed(results):
    assert all(one.met for one in targets(doctored(results, good=True)))
    assert not any(one.met for one in targets(doctored(results, good=False)))
    found = targets(results)
    assert len(found) == 6 + 3 + 6 + 6 + 12 + 6
    assert {one.case for one in found} <= {one["name"] for one in results["cases"]}


WANTED = {
    ("nominal_10_1", "position", "p95"): 0.15,
    ("nominal_10_5", "position", "p95"): 0.075,
    ("nominal_50_10", "position", "p95"): 0.050,
    ("nominal_10_1", "heading", "p95"): 0.055,
    ("nominal_10_5", "heading", "p95"): 0.040,
    ("nominal_50_10", "heading", "p95"): 0.022,
    ("radius_10_1", "position", "rmse"): 0.115,
    ("radius_10_5", "position", "rmse"): 0.058,
    ("radius_50_10", "position", "rmse"): 0.040,
    ("outliers_10_5", "position", "rmse"): 0.060,
    ("slip_10_5", "position", "rmse"): 0.12,
    ("slip_10_5", "lost"): 0.0,
    ("kidnapped_10_5", "back_median"): 1.0,
    ("kidnapped_10_5", "back_max"): 3.0,
    ("all_10_5", "lost"): 0.0,
}


def test_a_target_looks_at_its_own_figure_of_the_default_filter(results):
    results = doctored(results, good=True)
    results["default_filter"] = CALIBRATING
    for (name, *path), bound in WANTED.items():
        for filter_name in FILTERS:
            changed = copy.deepcopy(results)
            one = next(case for case in changed["cases"] if case["name"] == name)["filters"][filter_name]
            for key in path[:-1]:
                one = one[key]
            one[path[-1]] = bound
            assert all(target.met for target in targets(changed) if target.case == name and "over" not in target.text)
            one[path[-1]] = 1.001 * bound + 1e-6
            missed = [target for target in targets(changed) if not target.met and "over" not in target.text]
            assert len(missed) == (filter_name == CALIBRATING)
            assert all((target.case, target.value, target.bound) == (name, one[path[-1]], bound) for target in missed)


def test_the_adaptive_filter_is_held_to_the_plain_one_with_the_right_r(results):
    for wrong, rates in ((one, rates) for one in ("r_10", "r_01") for rates in RATES):
        name, right = name_of(wrong, *rates), name_of("nominal", *rates)
        changed = doctored(copy.deepcopy(results), good=True)
        cases = {one["name"]: one["filters"] for one in changed["cases"]}
        cases[right][EKF]["position"]["rmse"] = 1.0
        cases[name][FNN]["position"]["rmse"] = 1.06
        missed = [one for one in targets(changed) if not one.met]
        assert [(one.case, one.value) for one in missed] == [(name, 1.06)]
        cases[name][FNN]["position"]["rmse"] = 1.04
        assert all(one.met for one in targets(changed))


@pytest.mark.parametrize(("nis", "text"), [(2.89, "lower bound"), (3.11, "upper bound")])
def test_the_mean_nis_has_two_bounds(results, nis, text):
    for filter_name in (EKF, CALIBRATING):
        changed = doctored(copy.deepcopy(results), good=True)
        next(one for one in changed["cases"] if one["name"] == "nominal_10_5")["filters"][filter_name]["nis"] = nis
        missed = [one for one in targets(changed) if not one.met]
        assert [(one.case, one.text) for one in missed] == [("nominal_10_5", f"mean NIS of {filter_name}, {text}")]


def test_results_hold_what_is_concluded(results):
    assert results["targets"] == [one._asdict() | {"met": one.met} for one in targets(results)]


def test_tables_name_everything(results):
    shown, page = table(results), page_part(results)
    for one in results["cases"]:
        assert one["text"] in shown
        assert one["text"] in page
    assert f"{sum(not one.met for one in targets(results))} missed" in shown
    body = [line for line in page.splitlines() if line.startswith("| 10/") or line.startswith("| 50/")]
    assert len(body) == 26 * 4
    missed = doctored(results, good=False)
    assert page_part(missed).count("**no**") == len(targets(missed))
    tables = [block.splitlines() for block in page.split("\n\n") if block.startswith("|")]
    assert len(tables) == 1 + len(SECTIONS)
    for lines in tables:
        assert len({line.replace("\\|", "").count("|") for line in lines}) == 1


def test_the_page_holds_the_kept_results():
    kept = json.loads((ROOT / "docs" / "localization.json").read_text())
    assert page_part(kept) in (ROOT / "docs" / "localization.md").read_text()
    assert [one["name"] for one in kept["cases"]] == [name_of(one.name, *r) for one in SCENARIOS for r in one.rates]
    assert kept["default_filter"] == FilterConfig().filter
    assert kept["targets"] == [one._asdict() | {"met": one.met} for one in targets(kept)]


def test_command_writes_results_and_figure(tmp_path, benchmarked, capsys, here):
    out = tmp_path / "deep" / "folder"
    assert cli.main(["benchmark", "localization", "--runs", str(RUNS), "--seed", "1", "--out", str(out)]) == 0
    assert json.loads((out / "results.json").read_text()) == benchmarked
    assert (out / "localization.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in out.iterdir()) == ["localization.png", "results.json"]
    written = capsys.readouterr().out
    assert "ekf_fnn_calibrating" in written
    assert "Targets:" in written


def test_command_passes_its_flags_on(tmp_path, monkeypatch, benchmarked, here):
    asked = []

    def fake(runs, seed):
        asked.append((runs, seed))
        return benchmarked

    monkeypatch.setattr(localization_benchmark, "run_benchmark", fake)
    monkeypatch.chdir(tmp_path)
    assert cli.main(["benchmark", "localization", "--seed", "9", "--no-figures"]) == 0
    assert asked == [(200, 9)]
    assert [path.name for path in (tmp_path / "out" / "localization").iterdir()] == ["results.json"]


def test_a_folder_that_is_a_file_is_told_before_the_runs(tmp_path, monkeypatch, capsys, here):
    monkeypatch.setattr(localization_benchmark, "run_benchmark", lambda runs, seed: pytest.fail("ran"))
    (tmp_path / "file").write_text("")
    assert cli.main(["benchmark", "localization", "--out", str(tmp_path / "file")]) == 1
    assert "cannot write to" in capsys.readouterr().err


def test_no_runs_are_refused():
    with pytest.raises(InvalidValueError, match="runs = 0"):
        run_benchmark(0, 1)
