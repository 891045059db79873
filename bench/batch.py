"""Compare the throughput of the compiled closed loop with plain Python, a hand-written kernel, and one thread.

Each run is simulation A of the paper without ROS, with 300 steps. Calls in one thread are measured in CPU time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from numba import njit
from rounds import Table, is_quick
from tqdm import tqdm

from diffbot_control.law.paper import PaperLaw
from diffbot_core.geometry import Pose
from diffbot_lab.gym import GOAL
from diffbot_lab.paper.experiment import SETTINGS, case_of, starts_of
from diffbot_sim import batch
from diffbot_sim.fusion import new_recent
from diffbot_sim.noise import FIX, MOTION, NoiseSource
from diffbot_sim.robot_step import HISTORY_COLUMNS, make_loop
from diffbot_sim.sensors import purposes_of

ROUNDS, RUNS = 9, 4000
STEPS = 300
CASE = case_of("law 17", SETTINGS[0])
FILTERED = case_of("law 17", SETTINGS[1])
START = starts_of("a")
run_batch = partial(batch.run_batch, law=PaperLaw)
ENVIRONMENTS = 1024
ENVS = gymnasium.make(GOAL), gymnasium.make_vec(GOAL, ENVIRONMENTS)


@njit(nogil=True, error_model="numpy", cache=True)
def _wrap(angle):
    if -math.pi < angle <= math.pi:
        return angle
    angle = angle % (2.0 * math.pi)
    return angle - 2.0 * math.pi if angle > math.pi else angle


@njit(nogil=True, error_model="numpy", cache=True)
def _drive_one(start, noise, steps, row):
    gamma, k, h, k_2, t_s, radius = 1.3, 1.0, 0.17, 2.7, 0.1, 0.5
    x, y, theta = start[0], start[1], start[2]
    last_outside, path, effort, local_time, switches, region = -1, 0.0, 0.0, math.nan, 0, 0
    turning = 0.0
    measured_x = measured_y = 0.0
    for step in range(steps + 1):
        measured_x = x + 0.3 * (2.0 * noise[FIX, step, 0] - 1.0)
        measured_y = y + 0.3 * (2.0 * noise[FIX, step, 1] - 1.0)
        measured_theta = _wrap(theta + 0.17 * (2.0 * noise[FIX, step, 2] - 1.0))
        rho = math.hypot(measured_x, measured_y)
        beta = math.atan2(0.0 - measured_y, 0.0 - measured_x)
        alpha = _wrap(beta - measured_theta)
        near = 1 if (rho <= radius if region == 1 else rho < radius) else 0
        switches += near != region
        region = near
        cosine, tangent = math.cos(alpha), math.tanh(rho)
        v = gamma * tangent * cosine
        if region == 1:
            omega = -k_2 * measured_theta
        else:
            sinc = math.sin(alpha) / alpha if abs(alpha) >= 1e-4 else 1.0 - alpha * alpha / 6.0
            slope = tangent / rho if rho >= 1e-4 else 1.0 - rho * rho / 3.0
            omega = k * alpha + gamma * sinc * slope * cosine * (alpha + h * beta)
        if math.hypot(x, y) > 0.4 or abs(theta) > 0.1:
            last_outside = step
        if region == 1 and math.isnan(local_time):
            local_time = step * t_s
        if step < steps:
            effort += (v * v + omega * omega) * t_s
            forward = t_s * (v + 0.065 * (2.0 * noise[MOTION, step, 0] - 1.0))
            dx, dy = forward * math.cos(theta), forward * math.sin(theta)
            turned = _wrap(theta + t_s * (omega + 0.2167 * (2.0 * noise[MOTION, step, 1] - 1.0)))
            turning += abs(_wrap(turned - theta)) if math.hypot(x, y) <= 1.0 else 0.0
            x, y, theta = x + dx, y + dy, turned
            path += math.hypot(dx, dy)
    row[0], row[1], row[2] = x, y, theta
    row[3] = (last_outside + 1) * t_s if last_outside < steps else math.nan
    row[4], row[5], row[6], row[7] = path, effort, switches, local_time
    row[8], row[9] = math.hypot(measured_x - x, measured_y - y), turning


def drive_by_hand(runs: int) -> Any:
    """Drive simulation A under law (17) with the paper's noise, with a kernel that is written by hand for this case.

    Returns:
        (runs, 10) columns of Outcome up to ``turning``; the kernel does not compute the last two columns.
    """
    source, noise, outcomes = NoiseSource(), np.empty((FIX + 1, STEPS + 1, 4)), np.empty((runs, 10))
    for run, row in enumerate(outcomes):
        source.rows(1, run, 0, noise, (MOTION, FIX))
        _drive_one(START.poses[0], noise, STEPS, row)
    return outcomes


def rate(runs: int, call: Callable[[], Any], clock: Callable[[], float] = time.perf_counter) -> float:
    """Return the throughput [million steps/s] of a call that simulates ``runs`` runs."""
    begin = clock()
    call()
    return 1e-6 * runs * STEPS / (clock() - begin)


def measure_round(table: Table, runs: int) -> None:
    """Measure each pair once, one right after the other."""
    run_loop, recent = make_loop(PaperLaw, CASE.feedback), new_recent(CASE.robot)
    noise = NoiseSource().run(1, 0, STEPS + 1, purposes_of(CASE.robot.sensors, 0, 0.0))
    nothing, cpu = np.empty((0, len(HISTORY_COLUMNS))), time.process_time
    table.add(
        "all threads; reference: same loop in plain Python [M steps/s]",
        rate(runs, lambda: run_batch(CASE, START, 1, 0, runs)),
        rate(1, lambda: run_loop(CASE, recent, noise, Pose(*START.poses[0]), nothing)),
    )
    table.add(
        "one thread; reference: hand-written kernel for this case [M steps/s]",
        rate(runs, lambda: run_batch(CASE, START, 1, 0, runs, threads=1), cpu),
        rate(runs, lambda: drive_by_hand(runs), cpu),
    )
    two, one = (rate(runs, lambda n=n: run_batch(CASE, START, 1, 0, runs, threads=n)) for n in (2, 1))
    table.add("two threads; reference: one thread [M steps/s]", two, one)
    table.add(
        "all threads, with the filter in the loop [M steps/s]",
        rate(runs, lambda: run_batch(FILTERED, START, 1, 0, runs)),
    )
    table.add(
        "one thread, 1024 environments for learning; reference: one environment [M steps/s]",
        rate(ENVIRONMENTS, lambda: step_randomly(1), cpu),
        rate(1, lambda: step_randomly(0), cpu),
    )


def step_randomly(which: int) -> None:
    """Step a single environment (0) or the vectorised environment (1) with random actions, STEPS times."""
    generator, env = np.random.default_rng(1), ENVS[which]
    env.reset(seed=1)
    for _ in range(STEPS):
        env.step(generator.uniform(-1.0, 1.0, env.action_space.shape))


def main() -> None:
    """Compile, compare the results of both kernels, measure, and print the table."""
    quick, table = is_quick(__doc__.splitlines()[0]), Table()
    run_batch(FILTERED, START, 1, 0, 2)
    np.testing.assert_allclose(drive_by_hand(20), run_batch(CASE, START, 1, 0, 20)[:, :10], rtol=1e-9, atol=1e-9)
    for _ in tqdm(range(1 if quick else ROUNDS), "batch", unit=" rounds", leave=False, disable=None):
        measure_round(table, 100 if quick else RUNS)
    table.show()


if __name__ == "__main__":
    main()
