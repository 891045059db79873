"""What random noise does in the compiled loop, against a certificate: does it hold, and how near do the robots stay?"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_control.law.presets import PAPER
from diffbot_lab.cases import configure, make_case
from diffbot_lab.stability.paper.file import EXACT_ARC, Certificate, Loop
from diffbot_lab.stability.tuned.runs import uniform_starts
from diffbot_sim.compiled.batch import Starts, run_histories
from diffbot_sim.compiled.closed_loop import Case

Array = NDArray[np.float64]

_STATES_AT_A_TIME = 1_000_000
_KEPT = 40_000
"""states of the cloud"""


class Observed(NamedTuple):
    """Counts and distances."""

    steps_from_core: int
    """steps that began in the core ..."""
    left_core: int
    """... and ended outside of it"""
    trajectories: int
    """from all over the start ..."""
    late: int
    """... and of these, the ones outside the core after the rank of their first cell"""
    longest: int
    """steps until a trajectory was in the core for good"""
    farthest: float
    """[m] distance from the goal at the end: second half of the runs from the core, or end of the trajectories"""
    cloud: Array
    """(n, 3) poses of these"""


def case_of(loop: Loop, steps: int) -> Case:
    """Return the loop of a certificate as a case of the compiled loop with raw measurements."""
    values: dict[str, Any] = {
        "preset": PAPER,
        **{name: getattr(loop, name) for name in ("gamma", "k", "h", "k_2", "eps_P", "eps_P_leave")},
        **{f"{name}_max": getattr(loop, name) for name in ("eps_x", "eps_y", "eps_theta", "eps_v", "eps_omega")},
        "sampling_time": loop.t_s,
        "exact_arc": loop.plant == EXACT_ARC,
        "drive_noise": 0.0,
        "fix_rate": 1.0 / loop.t_s,
        "linear.x.max_velocity": math.inf,
    }
    return make_case(configure(values), steps * loop.t_s, feedback="raw")


def rank_of(certificate: Certificate, poses: Array) -> NDArray[np.int16]:
    """Return the rank of poses (..., 3) in the goal's frame: 0 in the core, -1 without one."""
    x, y, theta = poses[..., 0], poses[..., 1], poses[..., 2]
    rho = np.hypot(x, y)
    alpha = np.arctan2(-y, -x) - theta
    alpha = alpha - 2.0 * math.pi * np.round(alpha / (2.0 * math.pi))
    rows, columns = certificate.ranks.shape
    row = np.searchsorted(certificate.rho, rho, side="right") - 1
    column = np.clip(np.searchsorted(certificate.alpha, alpha, side="right") - 1, 0, columns - 1)
    ranks = certificate.ranks[np.clip(row, 0, rows - 1), column]
    return np.where(row < 0, 0, np.where(row >= rows, -1, ranks)).astype(np.int16)


def observe(certificate: Certificate, steps: int, trajectories: int, seed: int) -> Observed:
    """Simulate with uniform noise.

    Args:
        certificate: to compare with.
        steps: to be done from starts in the core.
        trajectories: from starts within ``claims.start``.
        seed: of starts and noise.
    """
    rng = np.random.default_rng(seed)
    done, left, farthest, cloud = _from_core(certificate, steps, seed, rng)
    late, longest = _from_afar(certificate, trajectories, seed + 1, rng)
    return Observed(done, left, trajectories, late, longest, farthest, cloud)


def _from_core(
    certificate: Certificate, steps: int, seed: int, rng: np.random.Generator
) -> tuple[int, int, float, Array]:
    """Return the steps done, those that left the core, the farthest distance, and the cloud."""
    length = 500
    runs = max(1, _STATES_AT_A_TIME // length)
    case, radius = case_of(certificate.loop, length), certificate.claims.radius
    done = left = first = 0
    farthest, clouds = 0.0, []
    with tqdm(desc="steps from the core", total=steps, unit="step", unit_scale=True, disable=None) as bar:
        while done < steps:
            poses = uniform_starts(rng, 4 * runs, radius)
            poses = poses[rank_of(certificate, poses) == 0][:runs]
            histories = run_histories(case, Starts(poses), seed, first, len(poses))[..., :3]
            # Run i starts at row i modulo the number of rows, so that each start is in the core.
            inside = rank_of(certificate, histories) == 0
            left += int((inside[:, :-1] & ~inside[:, 1:]).sum())
            done += int(inside[:, :-1].sum())
            first += len(poses)
            late = histories[:, length // 2 :].reshape(-1, 3)
            farthest = max(farthest, float(np.hypot(late[:, 0], late[:, 1]).max()))
            clouds.append(late[:: max(1, len(late) * (1 + steps // _STATES_AT_A_TIME) // _KEPT)])
            bar.update(histories.shape[0] * length)
    return done, left, farthest, np.concatenate(clouds)


def _from_afar(certificate: Certificate, trajectories: int, seed: int, rng: np.random.Generator) -> tuple[int, int]:
    """Return how many trajectories came too late, and the longest time to the core in steps."""
    length = certificate.claims.steps + 20
    at_a_time = max(1, _STATES_AT_A_TIME // length)
    case = case_of(certificate.loop, length)
    late = longest = 0
    with tqdm(desc="trajectories", total=trajectories, unit="run", unit_scale=True, disable=None) as bar:
        for first in range(0, trajectories, at_a_time):
            number = min(at_a_time, trajectories - first)
            poses = uniform_starts(rng, number, certificate.claims.start)
            histories = run_histories(case, Starts(poses), seed, first, number)[..., :3]
            ranks = rank_of(certificate, histories)
            outside = ranks != 0
            last = np.where(outside.any(axis=1), length - np.argmax(outside[:, ::-1], axis=1), -1)
            # Step n of a history is after n steps: in the core from step rank(start) on.
            late += int((last >= ranks[:, 0]).sum())
            longest = max(longest, int(last.max()) + 1)
            bar.update(number)
    return late, longest
