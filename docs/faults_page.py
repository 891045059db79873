"""The page docs/results/faults.md from its data/faults.json, which ``make faults`` and ``make soak`` write."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from typing import Any

from diffbot_lab.campaign.statistics import wilson
from diffbot_lab.targets import markdown_table

QUESTION = """\
# Faults

Does the robot stop in time when a process dies, a clock stops, the network loses messages or the input is hostile?"""
METHOD = """\
    make faults        # all trials, half an hour
    make soak          # ten minutes of goals and faults
    make docs          # this page, from what both have measured

Each row is measured on real processes over DDS, from a seed. `make test` makes a few trials of each, with ten times
the bound. The promises and bounds stand in test/support/promises.py, the tests in test/faults. All figures:
[faults.json](data/faults.json)."""
READING = """\
## How to read it

- A time runs from the fault to the receipt by an observer in a process of its own.
- Where the controller has to stop the robot, the base's own cmd_vel_timeout is switched off. Where the controller
  itself is lost, the base has to stop.
- *pose_timeout*, *cmd_vel_timeout* and *flush_period* are 0.5 s, a period is 0.1 s.
- *Kept* counts the trials within the bound itself; the interval is Wilson's of their share.
- The tests fail beyond the bound and what the scheduler may have added: the longest wait for a processor of a thread,
  by the kernel's count (/proc/PID/task/TID/schedstat), summed over the processes that live on. *Scheduler* is this time
  for the worst trial, *kept with it* the number of trials that were kept with it."""
STOPPED = ("zero on cmd_vel within pose_timeout", "the base's own cmd_vel_timeout stops it")
"""Beginnings of the promises that the robot is stopped."""
HEAD = ("fault", "promised", "kept [95 %]", "median", "worst", "scheduler (kept with it)")


def page(content: dict[str, Any]) -> str:
    """Return the page; ``content`` is what the JSON file holds."""
    machine = content["machine"]
    suite = sum((Counter(one) for one in content["suite"].values()), Counter())
    rows = [_row(one) for one in content["faults"].values()]
    parts = [
        QUESTION,
        _answer(content["faults"].values()),
        METHOD,
        "## Each fault",
        "\n".join(markdown_table(HEAD, rows)),
        f"In the tests that ran to their end: {suite['processes']} processes, {suite['deaths']} deaths, "
        f"{suite['tracebacks']} tracebacks in their logs; {suite['messages']} messages checked, "
        f"{suite['non_finite']} of them with a number that is not finite. Measured with {machine['processors']} "
        f"processors under a load of {machine['load']} (15 minutes), Python {machine['python']}.",
        READING,
    ]
    if "note" in content:
        parts.insert(3, content["note"])
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


def _row(one: dict[str, Any]) -> list[str]:
    low, high = wilson(one["kept"], one["trials"])
    unit = f" {one['unit']}" if one["bound"] is not None else ""
    numbers = [f"{one[key]:.3f}{unit}" if one[key] is not None else "" for key in ("median", "worst")]
    allowed = f"{one['allowance_of_worst']:.3f}{unit}" if one["worst"] is not None else ""
    interval = f"[{100 * low:.1f} to {100 * high:.1f} %]"
    bound = f" (<= {one['bound']:g}{unit})" if one["bound"] is not None else ""
    kept = f"{one['kept']} of {one['trials']} {interval}"
    return [one["fault"], one["promise"] + bound, kept, *numbers, f"{allowed} ({one['kept_with_allowance']})".strip()]


def _soak(soak: dict[str, Any]) -> list[str]:
    goals = [[one, str(count["sent"]), str(count["reached"])] for one, count in soak["goals"].items()]
    nodes = [
        [
            name,
            f"{one['minutes']:.1f}",
            f"{one['rss']:.1f}",
            f"{one['slope']:.3f}",
            f"{one['threads'][0]} to {one['threads'][1]}",
            f"{one['descriptors'][0]} to {one['descriptors'][1]}",
        ]
        for name, one in soak["nodes"].items()
    ]
    return [
        "## Soak",
        f"`make soak`: {soak['minutes']:.1f} minutes of goals, one after the other, seed {soak['seed']}; a fault "
        "strikes during every other goal. Nodes are killed in the first third only, so that the memory of each can be "
        f"followed afterwards; the first {soak['warm_up']:g} s of a process are its warm-up.",
        "\n".join(markdown_table(("during the goal", "goals", "reached"), goals)),
        f"Promised: every goal is reached; the memory (RSS) grows by at most {soak['max_slope']:g} MB/min (Theil and "
        "Sen's slope); threads and descriptors do not grow.",
        "\n".join(markdown_table(("node", "minutes", "RSS [MB]", "slope [MB/min]", "threads", "descriptors"), nodes)),
    ]
