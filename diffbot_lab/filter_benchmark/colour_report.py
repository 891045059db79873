"""Conclusions of the benchmark of coloured fixes: targets, and a table for a terminal."""

from __future__ import annotations

from typing import Any

from diffbot_lab.campaign.statistics import wilson
from diffbot_lab.targets import Target, evaluate_targets, number, summary

Results = dict[str, Any]

MAX_NEES = {"on": 6.0, "given": 4.0}
"""Largest mean NEES with coloured fixes, by mode."""
MIN_ALARMS, MAX_FALSE_ALARMS = 0.99, 0.01
"""Share of runs with an alarm: coloured fixes whose correlation nobody gave, and white ones."""


def targets(results: Results) -> list[Target]:
    """Pair each promised figure with its bound."""
    found = []
    for one in results["cells"]:
        name, share = f"c = {one['c']:g}, {one['mode']}", one["alarms"] / one["runs"]
        if one["c"] > 0.0 and one["mode"] in MAX_NEES:
            found.append(Target(name, "mean NEES", one["nees"], MAX_NEES[one["mode"]]))
        if one["c"] == 0.0:
            found.append(Target(name, "share of runs with a false alarm", share, MAX_FALSE_ALARMS))
        elif one["mode"] != "given":
            found.append(Target(name, "share of runs with an alarm", share, MIN_ALARMS, True))
    return found


def conclusions(results: Results) -> Results:
    """Return what follows from the figures, for results.json."""
    return {"targets": evaluate_targets(targets(results))}


def table(results: Results) -> str:
    """Lay out the figures and the targets for a terminal."""
    lines = [f"{'c':>5}{'mode':>7}{'RMSE [m]':>10}{'NEES':>8}{'alarm in':>10}{'95 % interval':>19}{'first [s]':>11}"]
    for one in results["cells"]:
        share, interval = _alarms(one)
        lines.append(
            f"{one['c']:>5g}{one['mode']:>7}{number(one['rmse'], 4):>10}{number(one['nees'], 2):>8}{share:>10}"
            f"{interval:>19}{number(one['alarm_median'], 0):>11}"
        )
    return "\n".join([*lines, "", *summary(targets(results))])


def _alarms(one: Results) -> tuple[str, str]:
    low, high = wilson(one["alarms"], one["runs"])
    return f"{100.0 * one['alarms'] / one['runs']:.1f} %", f"{100.0 * low:.1f} .. {100.0 * high:.1f} %"
