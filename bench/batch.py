"""Throughput of the compiled closed loop, compared with plain Python and with one thread.

The runs are simulation A of the paper, 300 steps each. Measurements in one thread use CPU time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from rounds import Table, is_quick
from tqdm import tqdm

from diffbot_control.law.paper import PaperLaw
from diffbot_core.geometry import Pose
from diffbot_lab.gym import GOAL
from diffbot_lab.paper.experiment import SETTINGS, case_of, starts_of
from diffbot_sim.batch import run_batch
from diffbot_sim.fusion import new_buffers
from diffbot_sim.noise import NoiseSource
from diffbot_sim.robot_step import HISTORY_COLUMNS, make_loop
from diffbot_sim.sensors import purposes_of

ROUNDS, RUNS = 9, 4000
STEPS = 300
CASE = case_of("law 17", SETTINGS[0])
FILTERED = case_of("law 17", SETTINGS[1])
START = starts_of("a")
ENVIRONMENTS = 1024
ENVS = gymnasium.make(GOAL), gymnasium.make_vec(GOAL, ENVIRONMENTS)


def rate(runs: int, call: Callable[[], Any], clock: Callable[[], float] = time.perf_counter) -> float:
    """Return the throughput of a call that simulates ``runs`` runs, in million steps per second."""
    begin = clock()
    call()
    return 1e-6 * runs * STEPS / (clock() - begin)


def simulate(case: Any, runs: int, threads: int | None = None) -> None:
    """Simulate runs of a case by the compiled loop."""
    run_batch(case, START, 1, 0, runs, threads, PaperLaw)


def measure_round(table: Table, runs: int) -> None:
    """Measure each throughput once, and its reference directly afterwards."""
    run_loop, buffers = make_loop(PaperLaw, CASE.feedback), new_buffers(CASE.robot)
    noise = NoiseSource().run(1, 0, STEPS + 1, purposes_of(CASE.robot.sensors, 0, 0.0))
    nothing, cpu = np.empty((0, len(HISTORY_COLUMNS))), time.process_time
    table.add(
        "all threads, reference: the same loop as plain Python [M steps/s]",
        rate(runs, lambda: simulate(CASE, runs)),
        rate(1, lambda: run_loop(CASE, buffers, noise, Pose(*START.poses[0]), nothing)),
    )
    two, one = (rate(runs, lambda n=n: simulate(CASE, runs, n)) for n in (2, 1))
    table.add("two threads, reference: one [M steps/s]", two, one)
    table.add("all threads, with the filter in the loop [M steps/s]", rate(runs, lambda: simulate(FILTERED, runs)))
    table.add(
        "one thread, 1024 environments for learning, reference: a single one [M steps/s]",
        rate(ENVIRONMENTS, lambda: play(1), cpu),
        rate(1, lambda: play(0), cpu),
    )


def play(which: int) -> None:
    """Run a single environment (0) or all environments (1) with random actions for STEPS steps."""
    generator, env = np.random.default_rng(1), ENVS[which]
    env.reset(seed=1)
    for _ in range(STEPS):
        env.step(generator.uniform(-1.0, 1.0, env.action_space.shape))


def main() -> None:
    """Compile, measure, and print the table."""
    quick, table = is_quick(__doc__.splitlines()[0]), Table()
    simulate(CASE, 2)
    simulate(FILTERED, 2)
    for _ in tqdm(range(1 if quick else ROUNDS), "batch", unit=" rounds", leave=False, disable=None):
        measure_round(table, 100 if quick else RUNS)
    table.show()


if __name__ == "__main__":
    main()
