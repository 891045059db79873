"""Lock-step over DDS: steps a second, beside a number that goes around relays."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from chains import BARE, LOCKSTEP, ONE, OURS, THREE, Chains
from measures import OURS as ABSOLUTE
from measures import Measure, Pair

MEASURES = (
    Measure("one", "one process", "steps/s", at_least=0.75),
    Measure("one_rate", "one process: our rate", "steps/s", ABSOLUTE, at_least=1200.0),
    Measure("three", "three processes", "steps/s"),
)
ROUNDS, SECONDS = 4, 1.0
QUICK_SECONDS = 0.4


def measure(quick: bool, folder: Path) -> Iterator[dict[str, Pair]]:
    """Yield each round."""
    chains, seconds = Chains(folder), QUICK_SECONDS if quick else SECONDS
    for number in range(1 if quick else ROUNDS):
        turns = chains.turns(number, LOCKSTEP, (OURS, BARE), ONE, seconds)
        ours, bare = turns[OURS]["rate"], turns[BARE]["rate"]
        yield {"one": Pair(ours, bare), "one_rate": Pair(ours)}
        turns = chains.turns(number, LOCKSTEP, (OURS, BARE), THREE, seconds)
        yield {"three": Pair(turns[OURS]["rate"], turns[BARE]["rate"])}
