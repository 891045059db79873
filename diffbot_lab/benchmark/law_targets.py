"""Promised figures of this project's law, and the figures in which a peer is ahead of it."""

from __future__ import annotations

from typing import Any, NamedTuple

from diffbot_lab.benchmark.law_entries import OWN_NAME
from diffbot_lab.benchmark.targets import Target

Results = dict[str, Any]

ROBUSTNESS = ("ts_005", "ts_02", "fixes_2_hz", "noise_half", "noise_double", "calibrating", "radius_error")
"""Cases of its own in which 99.5 % of the runs have to settle."""
FIGURES = (
    ("settling_time", "p99", "settling time, 99 %", "s"),
    ("position", "p95", "final position error, 95 %", "m"),
    ("settling_time", "median", "settling time, median", "s"),
)
"""Figures that are compared beside the share settled; the first two count for the comparison of a case."""
MIN_BEHIND = 2
"""In so many of share settled, settling 99 % and position 95 % a peer has to be behind in every case."""


class Ratio(NamedTuple):
    """Bounds of a case as multiples of the nominal one's figures."""

    case: str
    settled: float
    median: float
    p99: float
    position: float


_RATIOS = (
    Ratio("dead_time_03", 1.0, 1.1, 1.25, 1.1),
    Ratio("dead_time_02_unknown", 0.999, 1.25, 1.6, 1.2),
    Ratio("acceleration", 1.0, 1.25, 1.4, 1.1),
    Ratio("mix", 1.0, 1.4, 1.7, 1.35),
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


def targets(results: Results) -> list[Target]:
    """Pair each promised figure with its bound, of the cases that were run."""
    found: list[Target] = []
    nominal = figures_of_law(results, "nominal")
    if nominal is not None:
        found += [
            Target("nominal", "share settled", share(nominal), 16_995 / 17_000, True),
            Target("nominal", "settling time, median [s]", nominal["settling_time"]["median"], 11.5),
            Target("nominal", "settling time, 99 % [s]", nominal["settling_time"]["p99"], 13.2),
            Target("nominal", "final position error, 95 % [m]", nominal["position"]["p95"], 0.050),
            Target("nominal", "final position error, largest [m]", nominal["position"]["max"], 0.085),
        ]
        for ratio in _RATIOS:
            found += _relative(results, ratio, nominal)
    precise = figures_of_law(results, "precise")
    if precise is not None:
        found += [
            Target("precise", "share settled", share(precise), 1.0, True),
            Target("precise", "settling time, median [s]", precise["settling_time"]["median"], 20.0),
            Target("precise", "final position error, 95 % [m]", precise["position"]["p95"], 0.024),
            Target("precise", "the same over the filter's", _over(precise["position"], precise["filter"], "p95"), 1.3),
        ]
    mix = figures_of_law(results, "random_mix")
    if mix is not None:
        found += [
            Target("random_mix", "settling time, median [s]", mix["settling_time"]["median"], 9.0),
            Target("random_mix", "settling time, 99 % [s]", mix["settling_time"]["p99"], 20.0),
        ]
    for name in ROBUSTNESS:
        one = figures_of_law(results, name)
        found += [] if one is None else [Target(name, "share settled", share(one), 0.995, True)]
    ours = [one for row in results["cases"] for one in row["laws"] if one["name"] == OWN_NAME]
    most = max((one["revolutions"] for one in ours), default=None)
    return [*found, Target("every case", "most revolutions within 1 m of the goal", most, 1.5), *_standing(results)]


def _relative(results: Results, ratio: Ratio, nominal: Results) -> list[Target]:
    one = figures_of_law(results, ratio.case)
    if one is None:
        return []
    time, base = one["settling_time"], nominal["settling_time"]
    return [
        Target(ratio.case, "share settled", share(one), ratio.settled, True),
        Target(ratio.case, "settling time, median / nominal", _over(time, base, "median"), ratio.median),
        Target(ratio.case, "settling time, 99 % / nominal", _over(time, base, "p99"), ratio.p99),
        Target(
            ratio.case,
            "final position error, 95 % / nominal",
            _over(one["position"], nominal["position"], "p95"),
            ratio.position,
        ),
    ]


def _over(one: Results, other: Results, key: str) -> float | None:
    # Times are whole sampling periods: 16.1 s over 11.5 s are 1.4, without the rounding error of the quotient.
    return round(one[key] / other[key], 9) if one[key] is not None and other[key] else None


def _standing(results: Results) -> list[Target]:
    """Count what the comparison with the peers promises, over all cases."""
    peers = {one["name"] for one in results["laws"] if not one["ours"] and not one["bound"]}
    few = settled = 0
    for row in results["cases"]:
        ours = figures_of_law(results, row["name"])
        for peer in (one for one in row["laws"] if one["name"] in peers and ours is not None):
            ahead = [text for text, *_ in better(ours, peer) if text != FIGURES[2][2]]
            settled += "share settled" in ahead
            few += 3 - len(ahead) < MIN_BEHIND
    return [
        Target("every case", "peers ahead in share settled", float(settled), 0.0),
        Target("every case", "peers behind in fewer than two of three figures", float(few), 0.0),
    ]


def better(ours: Results | None, peer: Results) -> list[tuple[str, str, float, float, bool]]:
    """List the figures in which a peer is better: text, unit, its value, ours, and whether the intervals are apart.

    A law of which no run settles has no settling time, and leads in none.
    """
    if ours is None:
        return []
    found = []
    if share(peer) > share(ours):
        apart = peer["settled_interval"][0] > ours["settled_interval"][1]
        found.append(("share settled", "", share(peer), share(ours), apart))
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
