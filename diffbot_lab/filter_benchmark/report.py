"""Conclusions of the filter's benchmark: targets, and a table for a terminal."""

from __future__ import annotations

from typing import Any

from diffbot_control.filter.options import EKF, FNN
from diffbot_lab.filter_benchmark.cases import RATES, name_of
from diffbot_lab.targets import Target, evaluate_targets, number, summary

Results = dict[str, Any]

_POSITION = (0.15, 0.075, 0.050)
_HEADING = (0.055, 0.040, 0.022)
_RADIUS = (0.115, 0.058, 0.040)
"""[m], [rad], [m] at each of RATES"""
_FAULTS_AT = RATES[1]
_ADAPTED = 1.05
"""Largest ratio of the adaptive filter's error with a wrong R to the plain filter's with the right one."""


def targets(results: Results) -> list[Target]:
    """Pair each promised figure of this project's filter with its bound."""
    default = results["default_filter"]
    cases = {one["name"]: one["filters"] for one in results["cases"]}
    return [
        *_accuracy(cases, default),
        *_faults(cases, default),
        *_adaptation(cases),
        *_consistency(cases, default),
    ]


def _accuracy(cases: Results, default: str) -> list[Target]:
    found = []
    for rates, position, heading in zip(RATES, _POSITION, _HEADING, strict=True):
        name = name_of("nominal", *rates)
        one = cases[name][default]
        found += [
            Target(name, "RMSE of a run's position, 95 % [m]", one["position"]["p95"], position),
            Target(name, "RMSE of a run's heading, 95 % [rad]", one["heading"]["p95"], heading),
        ]
    for rates, position in zip(RATES, _RADIUS, strict=True):
        name = name_of("radius", *rates)
        found.append(Target(name, "RMSE of position [m]", cases[name][default]["position"]["rmse"], position))
    return found


def _faults(cases: Results, default: str) -> list[Target]:
    outliers, slip, kidnapped, everything = (
        name_of(one, *_FAULTS_AT) for one in ("outliers", "slip", "kidnapped", "all")
    )
    return [
        Target(outliers, "RMSE of position [m]", cases[outliers][default]["position"]["rmse"], 0.060),
        Target(slip, "RMSE of position [m]", cases[slip][default]["position"]["rmse"], 0.12),
        Target(slip, "runs lost", cases[slip][default]["lost"], 0.0),
        Target(kidnapped, "back after, median [s]", cases[kidnapped][default]["back_median"], 1.0),
        Target(kidnapped, "back after, longest [s]", cases[kidnapped][default]["back_max"], 3.0),
        Target(everything, "runs lost", cases[everything][default]["lost"], 0.0),
    ]


def _adaptation(cases: Results) -> list[Target]:
    found = []
    for scenario in ("r_10", "r_01"):
        for rates in RATES:
            name = name_of(scenario, *rates)
            right = cases[name_of("nominal", *rates)][EKF]["position"]["rmse"]
            ratio = cases[name][FNN]["position"]["rmse"] / right
            found.append(Target(name, f"RMSE of position: {FNN} over {EKF} with the right R", ratio, _ADAPTED))
    return found


def _consistency(cases: Results, default: str) -> list[Target]:
    found = []
    for filter_name in dict.fromkeys((EKF, default)):
        for rates in RATES:
            name = name_of("nominal", *rates)
            one = cases[name][filter_name]
            found += [
                Target(name, f"mean NIS of {filter_name}, lower bound", one["nis"], one["nis_low"], True),
                Target(name, f"mean NIS of {filter_name}, upper bound", one["nis"], one["nis_high"]),
            ]
    for scenario in ("nominal", "radius"):
        for rates in RATES:
            name = name_of(scenario, *rates)
            one = cases[name][default]
            found.append(Target(name, "mean NEES, upper bound", one["nees"], one["nees_high"]))
    return found


def conclusions(results: Results) -> Results:
    """Return what follows from the figures, for results.json."""
    return {"targets": evaluate_targets(targets(results))}


def table(results: Results) -> str:
    """Lay out all cases and the targets for a terminal."""
    head = f"{'':<20}{'|pos| [m]: RMSE':>15}{'95 %':>7}{'max':>8}{'|theta| [rad]: RMSE':>21}{'95 %':>8}{'lost':>6}"
    head += f"{'back [s]: median':>18}{'max':>7}{'NIS':>9}{'NEES':>10}{'rejected':>10}{'relocations':>13}"
    rows = [head]
    for case in results["cases"]:
        rows += ["-" * len(head), f"{case['odometry_rate']}/{case['fix_rate']} Hz: {case['text']}"]
        rows += [_terminal_row(name, one) for name, one in case["filters"].items()]
    return "\n".join([*rows, "", *summary(targets(results))])


def _terminal_row(name: str, one: Results) -> str:
    position, heading = one["position"], one["heading"]
    return (
        f"{name:<20}{number(position['rmse']):>15}{number(position['p95']):>7}{number(one['largest'], 2):>8}"
        f"{number(heading['rmse'], 4):>21}{number(heading['p95'], 4):>8}{one['lost']:>6}"
        f"{number(one['back_median'], 1):>18}{number(one['back_max'], 1):>7}{number(one['nis'], 2):>9}"
        f"{number(one['nees'], 2):>10}{100.0 * one['rejected']:>8.2f} %{number(one['relocations'], 2):>13}"
    )
