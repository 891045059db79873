"""Runs of one law in one case."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diffbot_control.goals.registry import resolve_law
from diffbot_control.law.controller import ControllerConfig
from diffbot_lab.arena.cases import DURATION, YAW_TOLERANCE, ArenaCase, Values, starts_named, world_of
from diffbot_lab.arena.entries import Entry, config_of
from diffbot_lab.cases import Configuration, make_case
from diffbot_sim.compiled.batch import Starts, run_batch, run_histories
from diffbot_sim.compiled.closed_loop import Case

Array = NDArray[np.float64]


def case_of(entry: Entry, case: ArenaCase, tuned: Values) -> Case:
    """Return what all runs of a law in a case share."""
    plant, sensors, filter_config = world_of(case)
    shared = make_case(
        Configuration(plant, sensors, ControllerConfig(), filter_config),
        DURATION,
        feedback=entry.feedback,
        tolerance=(case.xy_tolerance, YAW_TOLERANCE),
    )
    return shared._replace(controller=config_of(entry, case, tuned))


def run_case(entry: Entry, case: ArenaCase, tuned: Values, count: int, seed: int, most: int = 0) -> Array:
    """Return the outcomes (count, 12) of ``count`` runs; run i has the same start and noise under every law.

    Args:
        entry: the law.
        case: what is run.
        tuned: its parameters that are not the entry's.
        count: number of runs.
        seed: of noise and random starts.
        most: runs of the law that has most of them, if these are more: random starts are drawn for all at once.
    """
    starts = Starts(starts_named(case.starts, max(count, most), seed)[:count])
    return run_batch(case_of(entry, case, tuned), starts, seed, 0, count, law=resolve_law(entry.law))


def run_paths(entry: Entry, case: ArenaCase, tuned: Values, start: Array, count: int, seed: int) -> Array:
    """Return histories (count, steps + 1, 10) of runs from one start (3,)."""
    starts = Starts(start[np.newaxis])
    return run_histories(case_of(entry, case, tuned), starts, seed, 0, count, law=resolve_law(entry.law))
