"""50 Hz over DDS: latency from odometry to command and CPU time, beside relays that compute nothing."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from chains import BARE, CLOCKED, ONE, OURS, ROBOT, THREE, TWO, Chains, percentile
from measures import Measure, Pair

MEASURES = (
    Measure("one_median", "one process: latency, median", "ms", at_most=1.0),
    Measure("one_p99", "one process: latency, p99", "ms", at_most=1.2),
    Measure("one_cpu", "one process: CPU of one core", "%", at_most=1.0),
    Measure("three_median", "three processes: latency, median", "ms", at_most=1.0),
    Measure("three_p99", "three processes: latency, p99", "ms", at_most=1.2),
    Measure("three_cpu", "three processes: CPU of the two nodes", "%", at_most=1.0),
    Measure("robot_median", "robot_node, driver apart: latency, median", "ms", at_most=1.0),
    Measure("robot_p99", "robot_node, driver apart: latency, p99", "ms", at_most=1.2),
    Measure("robot_cpu", "robot_node, driver apart: CPU of one core", "%", at_most=1.0),
    Measure("robot_inside", "robot_node, odometry's callback to cmd_vel sent, against two nodes", "ms", at_most=0.75),
)
ROUNDS, SECONDS = 5, 3.0
QUICK_SECONDS = 0.6


def measure(quick: bool, folder: Path) -> Iterator[dict[str, Pair]]:
    """Yield each round of each arrangement of processes."""
    chains, seconds = Chains(folder), QUICK_SECONDS if quick else SECONDS
    for number in range(1 if quick else ROUNDS):
        for name, groups in (("one", ONE), ("three", THREE)):
            turns = chains.turns(number, CLOCKED, (OURS, BARE), groups, seconds)
            yield _compared(name, turns[OURS], turns[BARE])
        turns = chains.turns(number, CLOCKED, (ROBOT, BARE, OURS), TWO, seconds)
        inside = [statistics.median(turns[side]["inside"]) for side in (ROBOT, OURS)]
        yield {**_compared("robot", turns[ROBOT], turns[BARE]), "robot_inside": Pair(*inside)}


def _compared(name: str, *turns: dict[str, Any]) -> dict[str, Pair]:
    """Return the figures of two turns: ours, then the reference."""
    return {
        f"{name}_median": Pair(*(statistics.median(turn["latencies"]) for turn in turns)),
        f"{name}_p99": Pair(*(percentile(turn["latencies"], 0.99) for turn in turns)),
        f"{name}_cpu": Pair(*(turn["cpu"] for turn in turns)),
    }
