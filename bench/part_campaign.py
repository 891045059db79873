"""Campaigns from the command line: what a second worker gives, and memory of very many runs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from costs import DIFFBOT, Cost, cost_of
from measures import OURS, Measure, Pair

MEASURES = (
    Measure("workers", "runs of 60 s: two workers, beside one; start and end included", "runs/s"),
    Measure("memory", "10 million runs of 0.1 s, two workers: memory", "MB", OURS, at_most=1000.0),
    Measure("short_runs", "the same: runs a second", "runs/s"),
)
ROUNDS, RUNS, SHORT_RUNS = 3, 20_000, 10_000_000
QUICK_RUNS = 20


def campaign(folder: Path, runs: int, workers: int, duration: float) -> Cost:
    """Run a campaign with the default law and filter in a new folder."""
    flags = ("--runs", runs, "--workers", workers, "--duration", duration, "--out", folder)
    return cost_of(*DIFFBOT, "campaign", *flags)


def measure(quick: bool, folder: Path) -> Iterator[dict[str, Pair]]:
    """Yield the rounds with one and two workers, and then the very many runs."""
    runs, many = (QUICK_RUNS, QUICK_RUNS) if quick else (RUNS, SHORT_RUNS)
    for number in range(1 if quick else ROUNDS):
        two, one = (campaign(folder / f"{number}_{workers}", runs, workers, 60.0) for workers in (2, 1))
        yield {"workers": Pair(runs / two.wall, runs / one.wall)}
    cost = two if quick else campaign(folder / "short", many, 2, 0.1)
    yield {"memory": Pair(cost.memory), "short_runs": Pair(many / cost.wall)}
