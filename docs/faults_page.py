"""The page docs/results/faults.md from its data/faults.json, which ``make faults`` and ``make soak`` write."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from typing import Any

QUESTION = """\
# Faults

Does the robot stop in time when a process dies, a clock stops, the network loses messages or the input is hostile?"""
METHOD = """\
    make faults soak   # twenty minutes, and ten
    make docs          # this page, from what both have measured

All is measured on real processes over DDS, from a seed. Times run from the fault to the receipt by an observer.
*pose_timeout*, *cmd_vel_timeout* and *flush_period* are 0.5 s, a period is 0.1 s. Where the controller has to stop the
robot, the base's own cmd_vel_timeout is switched off. *Kept* counts the trials within the bound itself. Intervals,
medians and what the scheduler added: [faults.json](data/faults.json). The tests are in test/faults."""
STOPPED = ("zero on cmd_vel within pose_timeout", "the base's own cmd_vel_timeout stops it")
"""Beginnings of the promises that the robot is stopped."""


def page(content: dict[str, Any]) -> str:
    """Return the page; ``content`` is what the JSON file holds."""
    machine = content["machine"]
    suite = sum((Counter(one) for one in content["suite"].values()), Counter())
    groups: dict[str, list[dict[str, Any]]] = {}
    for one in content["faults"].values():
        groups.setdefault(one["promise"], []).append(one)
    rows = [f"- *{promise}*: {'; '.join(map(_trials, ones))}" for promise, ones in groups.items()]
    parts = [
        QUESTION,
        _answer(content["faults"].values()),
        METHOD,
        "## Each fault",
        "In italics the promise; then each fault, its trials kept (20/20: 84 to 100 %, 95 % interval), the worst.",
        "\n".join(rows),
        f"In the tests that ran to their end: {suite['processes']} processes, {suite['deaths']} deaths, "
        f"{suite['tracebacks']} tracebacks in their logs; {suite['messages']} messages checked, "
        f"{suite['non_finite']} of them with a number that is not finite. Measured with {machine['processors']} "
        f"processors under a load of {machine['load']} (15 minutes), Python {machine['python']}.",
    ]
    if minutes := content.get("minutes"):
        parts[-1] += f" All rows are of one run of {minutes} minutes."
    if "soak" in content:
        parts += _soak(content["soak"])
    return "\n\n".join(parts) + "\n"


def _answer(faults: Collection[dict[str, Any]]) -> str:
    trials, kept = (sum(one[key] for one in faults) for key in ("trials", "kept"))
    whole = len([one for one in faults if one["kept"] == one["trials"]])
    stops = [one["worst"] for one in faults if one["promise"].startswith(STOPPED)]
    return (
        f"**In short:** {whole} of {len(faults)} promises were kept in every trial, {kept} of {trials} trials in all "
        "(messages and calls are counted one by one). "
        f"Where poses, clock or controller are lost, the robot was stopped after {max(stops):.2f} s at the latest."
    )


def _trials(one: dict[str, Any]) -> str:
    worst = f", {one['worst']:.2f} {one['unit']}" if one["worst"] is not None else ""
    return f"{one['fault']} ({one['kept']}/{one['trials']}{worst})"


def _soak(soak: dict[str, Any]) -> list[str]:
    sent, reached = (sum(count[key] for count in soak["goals"].values()) for key in ("sent", "reached"))
    nodes = "; ".join(f"{name}: {one['rss']:.1f} MB, {one['slope']:.3f} MB/min" for name, one in soak["nodes"].items())
    growing = [
        name for name, one in soak["nodes"].items() if any(a < b for a, b in (one["threads"], one["descriptors"]))
    ]
    return [
        "## Soak",
        f"`make soak`: {soak['minutes']:.1f} minutes of goals, one after the other, seed {soak['seed']}; a fault "
        f"strikes during every other goal. {reached} of {sent} goals were reached (with: {', '.join(soak['goals'])}).",
        f"Memory (RSS) and its slope, at most {soak['max_slope']:g} MB/min after a warm-up of {soak['warm_up']:g} s: "
        f"{nodes}. Nodes whose threads or descriptors grew: {', '.join(growing) or 'none'}.",
    ]
