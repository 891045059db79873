"""Each target of the filter's benchmark follows its own figure of its own case and variant, and no other."""

import copy
import json
from pathlib import Path

import pytest

from diffbot_control.filter.options import CALIBRATING, EKF, FILTERS, FNN
from diffbot_lab.filter_benchmark.report import targets

ROOT = Path(__file__).resolve().parents[3]
FIGURES = {
    "RMSE of a run's position, 95 % [m]": ("position", "p95"),
    "RMSE of a run's heading, 95 % [rad]": ("heading", "p95"),
    "RMSE of position [m]": ("position", "rmse"),
    "runs lost": ("lost",),
    "back after, median [s]": ("back_median",),
    "back after, longest [s]": ("back_max",),
    "mean NEES, upper bound": ("nees",),
}


def put(results, case, variant, path, value):
    row = next(one for one in results["cases"] if one["name"] == case)["filters"][variant]
    for key in path[:-1]:
        row = row[key]
    row[path[-1]] = value


@pytest.fixture
def good():
    """Results in which every figure of every variant is well within its bound."""
    results = json.loads((ROOT / "docs/results/data/localization.json").read_text())
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


def test_a_figure_of_the_default_decides_its_own_target_alone(good):
    assert missed(good) == []
    own = [one for one in targets(good) if one.text in FIGURES]
    assert {one.text for one in own} == set(FIGURES)
    for target in own:
        for variant in FILTERS:
            results = copy.deepcopy(good)
            put(results, target.case, variant, FIGURES[target.text], target.bound)
            # The plain filter's RMSE is also what the adaptive one is compared with, which a larger value only helps.
            assert missed(results) == []
            put(results, target.case, variant, FIGURES[target.text], target.bound + 1e-6)
            assert missed(results) == ([(target.case, target.text)] if variant == CALIBRATING else [])


@pytest.mark.parametrize("variant", [EKF, CALIBRATING])
def test_the_mean_nis_has_two_bounds(good, variant):
    for case in ("nominal_10_1", "nominal_10_5", "nominal_50_10"):
        for side, bound, beyond in (("lower", 2.9, 2.899), ("upper", 3.1, 3.101)):
            results = copy.deepcopy(good)
            put(results, case, variant, ("nis",), bound)
            assert missed(results) == []
            put(results, case, variant, ("nis",), beyond)
            assert missed(results) == [(case, f"mean NIS of {variant}, {side} bound")]


def test_the_adaptive_filter_is_compared_with_the_plain_one_with_the_right_r(good):
    for case in ("r_10", "r_01"):
        put(good, "nominal_10_5", EKF, ("position", "rmse"), 0.01)
        put(good, f"{case}_10_5", FNN, ("position", "rmse"), 0.010499)
        assert missed(good) == []
        put(good, f"{case}_10_5", FNN, ("position", "rmse"), 0.010501)
        assert missed(good) == [(f"{case}_10_5", f"RMSE of position: {FNN} over {EKF} with the right R")]
        put(good, f"{case}_10_5", FNN, ("position", "rmse"), 0.001)
