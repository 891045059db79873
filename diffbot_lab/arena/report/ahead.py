"""The figures in which a peer is ahead of this project's law."""

from __future__ import annotations

from typing import Any

from diffbot_lab.arena.entries import OWN_NAME

Results = dict[str, Any]

FIGURES = (
    ("reached_time", "median", "time of the answer, median", "s"),
    ("reached_time", "p99", "time of the answer, 99 %", "s"),
    ("settling_time", "median", "settling time, median", "s"),
    ("settling_time", "p99", "settling time, 99 %", "s"),
    ("position", "p95", "final position error, 95 %", "m"),
)
"""Figures that are compared beside the shares answered and settled."""


def share(one: Results) -> float:
    """Return the share of runs that settled."""
    return float(one["settled"] / one["runs"])


def answered(one: Results, time: int = 60) -> float:
    """Return the share of all runs that were answered by ``time`` [s], one of ANSWER_TIMES."""
    return float(one["answered_by"][str(time)] / one["runs"])


def false_share(one: Results) -> float:
    """Return the share of all runs whose answer was false."""
    return float(one["false_reached"] / one["runs"])


def better(ours: Results, peer: Results) -> list[tuple[str, str, float, float, bool]]:
    """List the figures in which a peer is better: text, unit, its value, ours, and whether the intervals are apart.

    A law of which no run settles, or is answered, has no such time, and leads in none.
    """
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


def peers_ahead(results: Results) -> list[dict[str, Any]]:
    """List every figure of every case in which a peer is better than this project's law."""
    labels = {one["name"]: one["label"] for one in results["laws"] if not one["ours"] and not one["bound"]}
    found = []
    for row in results["cases"]:
        (ours,) = (one for one in row["laws"] if one["name"] == OWN_NAME)
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
