"""Promised figures of this project's law, and the figures in which a peer is ahead of it."""

from __future__ import annotations

from typing import Any, NamedTuple

from diffbot_lab.arena.entries import OWN_NAME
from diffbot_lab.targets import Target

Results = dict[str, Any]

ROBUSTNESS = ("ts_005", "ts_02", "fixes_2_hz", "noise_half", "noise_double", "calibrating", "radius_error")
"""Cases of its own in which 99.5 % of the runs have to settle."""
FIGURES = (
    ("reached_time", "median", "time of the answer, median", "s"),
    ("reached_time", "p99", "time of the answer, 99 %", "s"),
    ("settling_time", "median", "settling time, median", "s"),
    ("settling_time", "p99", "settling time, 99 %", "s"),
    ("position", "p95", "final position error, 95 %", "m"),
)
"""Figures that are compared beside the shares answered and settled."""


class Promise(NamedTuple):
    """Bounds of a case; None where nothing is promised."""

    case: str
    answered: float
    """least share answered by 60 s"""
    median: float | None
    """[s] of the answer"""
    p99: float | None
    """[s] of the answer"""
    settled: float
    settled_p99: float | None
    """[s]"""
    position: float | None = None
    """[m] 95 %"""
    false: float = 0.01
    """largest share answered falsely, by the upper end of its interval"""


PROMISES = (
    Promise("nominal", 0.9999, 12.6, 15.0, 1.0, 13.0, 0.047, 0.001),
    Promise("dead_time_03", 0.999, 13.5, 20.0, 1.0, 14.0),
    Promise("dead_time_02_unknown", 0.999, 13.5, 20.0, 1.0, 14.0),
    Promise("lag_030", 0.999, 13.5, 20.0, 1.0, 14.0),
    Promise("mix", 0.995, 18.5, 40.0, 0.9995, 19.5, 0.062),
    Promise("random_mix", 0.995, 16.0, 38.0, 0.9995, 20.5),
    Promise("late_fixes", 0.995, None, None, 1.0, 17.0),
    Promise("slip", 0.995, None, None, 0.999, 19.5),
    Promise("forward_mix", 0.99, None, None, 0.998, None, 0.068),
    Promise("short_mix", 0.995, 6.0, None, 0.995, None),
    Promise("position_fixes", 0.98, 30.0, None, 0.995, None),
    Promise("coloured_09_wide", 0.97, None, None, 0.995, None),
    Promise("precise", 0.99, 34.0, None, 1.0, None),
)


def figures_of_law(results: Results, case: str, law: str = OWN_NAME) -> Results | None:
    """Return the figures of a law in a case; None if it was not run."""
    for row in results["cases"]:
        if row["name"] == case:
            return next((one for one in row["laws"] if one["name"] == law), None)
    return None


def share(one: Results) -> float:
    """Return the share of runs that settled."""
    return float(one["settled"] / one["runs"])


def answered(one: Results, time: int = 60) -> float:
    """Return the share of all runs that were answered by ``time`` [s], one of ANSWER_TIMES."""
    return float(one["answered_by"][str(time)] / one["runs"])


def false_share(one: Results) -> float:
    """Return the share of all runs whose answer was false."""
    return float(one["false_reached"] / one["runs"])


def targets(results: Results) -> list[Target]:
    """Pair each promised figure with its bound, of the cases that were run."""
    found: list[Target] = []
    for promise in PROMISES:
        one = figures_of_law(results, promise.case)
        found += [] if one is None else _of_promise(promise, one)
    for name in ROBUSTNESS:
        one = figures_of_law(results, name)
        found += [] if one is None else [Target(name, "share settled", share(one), 0.995, True)]
    ours = [one for row in results["cases"] for one in row["laws"] if one["name"] == OWN_NAME]
    most = max((one["revolutions"] for one in ours), default=None)
    return [*found, Target("every case", "most revolutions within 1 m of the goal", most, 1.5)]


def _of_promise(promise: Promise, one: Results) -> list[Target]:
    name, answer, settling = promise.case, one["reached_time"], one["settling_time"]
    false = one["false_reached_interval"][1]
    bounds = (
        ("time of the answer, median [s]", answer["median"], promise.median),
        ("time of the answer, 99 % [s]", answer["p99"], promise.p99),
        ("share answered falsely, upper bound", false, promise.false),
        ("settling time, 99 % [s]", settling["p99"], promise.settled_p99),
        ("final position error, 95 % [m]", one["position"]["p95"], promise.position),
    )
    return [
        Target(name, "share answered by 60 s", answered(one), promise.answered, True),
        Target(name, "share settled", share(one), promise.settled, True),
        *(Target(name, text, value, bound) for text, value, bound in bounds if bound is not None),
    ]


def better(ours: Results | None, peer: Results) -> list[tuple[str, str, float, float, bool]]:
    """List the figures in which a peer is better: text, unit, its value, ours, and whether the intervals are apart.

    A law of which no run settles, or is answered, has no such time, and leads in none.
    """
    if ours is None:
        return []
    found = []
    shares = (
        ("share answered by 60 s", answered, "answered_interval"),
        ("share settled", share, "settled_interval"),
    )
    for text, of, interval in shares:
        if of(peer) > of(ours):
            found.append((text, "", of(peer), of(ours), peer[interval][0] > ours[interval][1]))
    for part, key, text, unit in FIGURES:
        own, other = ours[part][key], peer[part][key]
        if other is not None and (own is None or other < own):
            apart = own is None or peer[part][f"{key}_interval"][1] < ours[part][f"{key}_interval"][0]
            found.append((text, unit, other, own, apart))
    return found


def peers_ahead(results: Results, law: str = OWN_NAME) -> list[dict[str, Any]]:
    """List every figure of every case in which a peer is better than this project's law of the name ``law``."""
    labels = {one["name"]: one["label"] for one in results["laws"] if not one["ours"] and not one["bound"]}
    found = []
    for row in results["cases"]:
        ours = figures_of_law(results, row["name"], law)
        for peer in (one for one in row["laws"] if one["name"] in labels):
            found += [
                {
                    "case": row["name"],
                    "peer": labels[peer["name"]],
                    "figure": text,
                    "unit": unit,
                    "peers": value,
                    "ours": own,
                    "apart": apart,
                }
                for text, unit, value, own, apart in better(ours, peer)
            ]
    return found
