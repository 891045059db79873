"""Each target of the filter's benchmark follows its own figure of its own variant, and no other."""

import copy
import json
from pathlib import Path

import pytest

from diffbot_control.filter.options import CALIBRATING, EKF, FILTERS, FNN
from diffbot_lab.benchmark.filter_report import targets

ROOT = Path(__file__).resolve().parents[3]
RATES = ("10_1", "10_5", "50_10")
P95, RMSE, HEADING = ("position", "p95"), ("position", "rmse"), ("heading", "p95")
# Case, target, path of the figure of the default filter, upper bound.
OF_THE_DEFAULT = [
    ("nominal_10_1", "RMSE of a run's position, 95 % [m]", P95, 0.15),
    ("nominal_10_5", "RMSE of a run's position, 95 % [m]", P95, 0.075),
    ("nominal_50_10", "RMSE of a run's position, 95 % [m]", P95, 0.050),
    ("nominal_10_1", "RMSE of a run's heading, 95 % [rad]", HEADING, 0.055),
    ("nominal_10_5", "RMSE of a run's heading, 95 % [rad]", HEADING, 0.040),
    ("nominal_50_10", "RMSE of a run's heading, 95 % [rad]", HEADING, 0.022),
    ("radius_10_1", "RMSE of position [m]", RMSE, 0.115),
    ("radius_10_5", "RMSE of position [m]", RMSE, 0.058),
    ("radius_50_10", "RMSE of position [m]", RMSE, 0.040),
    ("outliers_10_5", "RMSE of position [m]", RMSE, 0.060),
    ("slip_10_5", "RMSE of position [m]", RMSE, 0.12),
    ("slip_10_5", "runs lost", ("lost",), 0.0),
    ("kidnapped_10_5", "back after, median [s]", ("back_median",), 1.0),
    ("kidnapped_10_5", "back after, longest [s]", ("back_max",), 3.0),
    ("all_10_5", "runs lost", ("lost",), 0.0),
    *(
        (f"{case}_{rates}", "mean NEES, upper bound", ("nees",), 3.3)
        for case in ("nominal", "radius")
        for rates in RATES
    ),
]
NIS = [(f"nominal_{rates}", variant) for rates in RATES for variant in (EKF, CALIBRATING)]
ADAPTED = [(f"{case}_{rates}", f"nominal_{rates}") for case in ("r_10", "r_01") for rates in RATES]


def figures(results, case, variant):
    return next(one for one in results["cases"] if one["name"] == case)["filters"][variant]


def put(row, path, value):
    for key in path[:-1]:
        row = row[key]
    row[path[-1]] = value


@pytest.fixture(scope="module")
def kept():
    return json.loads((ROOT / "docs/results/data/localization.json").read_text())


@pytest.fixture
def good(kept):
    """Results in which every figure of every variant is well within its bound."""
    results = copy.deepcopy(kept)
    results["default_filter"] = CALIBRATING
    for case in results["cases"]:
        for one in case["filters"].values():
            one["position"] = dict.fromkeys(one["position"], 0.001)
            one["heading"] = dict.fromkeys(one["heading"], 0.001)
            one |= {"lost": 0, "back_median": 0.4, "back_max": 0.4, "nees": 3.0, "nees_high": 3.3}
            one |= {"nis_low": 2.9, "nis": 3.0, "nis_high": 3.1}
    return results


def missed(results):
    return [(one.case, one.text) for one in targets(results) if not one.met]


def ratio(case):
    return case, f"RMSE of position: {FNN} over {EKF} with the right R"


def test_the_targets_are_these(good):
    expected = [one[:2] for one in OF_THE_DEFAULT] + [ratio(case) for case, _ in ADAPTED]
    expected += [(case, f"mean NIS of {variant}, {side} bound") for case, variant in NIS for side in ("lower", "upper")]
    assert sorted((one.case, one.text) for one in targets(good)) == sorted(expected)
    assert missed(good) == []


def test_a_figure_of_the_default_decides_its_own_target_alone(good):
    for case, text, path, bound in OF_THE_DEFAULT:
        for variant in FILTERS:
            results = copy.deepcopy(good)
            put(figures(results, case, variant), path, bound)
            # The plain filter's RMSE is also what the adaptive one is compared with, which a larger value only helps.
            assert missed(results) == []
            put(figures(results, case, variant), path, bound + 1e-6)
            assert missed(results) == ([(case, text)] if variant == CALIBRATING else [])


@pytest.mark.parametrize(("case", "variant"), NIS)
def test_the_mean_nis_has_two_bounds(good, case, variant):
    for side, bound, beyond in (("lower", 2.9, 2.899), ("upper", 3.1, 3.101)):
        figures(good, case, variant)["nis"] = bound
        assert missed(good) == []
        figures(good, case, variant)["nis"] = beyond
        assert missed(good) == [(case, f"mean NIS of {variant}, {side} bound")]


def test_the_adaptive_filter_is_compared_with_the_plain_one_with_the_right_r(good):
    for case, right in ADAPTED:
        results = copy.deepcopy(good)
        figures(results, right, EKF)["position"]["rmse"] = 0.01
        figures(results, case, FNN)["position"]["rmse"] = 0.010499
        assert missed(results) == []
        figures(results, case, FNN)["position"]["rmse"] = 0.010501
        assert missed(results) == [ratio(case)]
