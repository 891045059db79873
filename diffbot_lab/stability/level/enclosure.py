"""``diffbot stability level``: encloses the level of V above which it decreases in each step, for every noise.

From above by branch and bound over cells (level/branching.py), from below by a witness (level/witness.py).
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_core.errors import DiffbotError
from diffbot_core.files import output_folder
from diffbot_lab.cases import configure
from diffbot_lab.stability.interval.compiled import compile_bounds
from diffbot_lab.stability.level import branching
from diffbot_lab.stability.level.file import LevelCertificate, save_level
from diffbot_lab.stability.level.problem import LevelProblem, Witness
from diffbot_lab.stability.level.report import leaves, report
from diffbot_lab.stability.level.step import levels
from diffbot_lab.stability.level.witness import climb, farthest, witness_at
from diffbot_lab.stability.settings import PAPER_NOISE, noise_box, refuse_others

KNOWN = (
    *("gamma", "k", "h", "sampling_time", "exact_arc"),
    *("eps_x_max", "eps_y_max", "eps_theta_max", "eps_v_max", "eps_omega_max"),
)
"""Parameters that the certificate covers: law (13) without limits, noise that is added."""
ROUNDING = "outward: every operation to the next float, library functions by 4 ulp"
_NODES_AT_A_TIME, _MAX_NODES = 100_000, 20_000_000
_STARTS, _TRIES, _POLISHED, _LONG = 200, 500, 10, 5000
"""climbs from random choices, their steps, how many of the best go on, and their steps"""
_WIDER = 1.5
"""factor on the gap after a walk that failed"""


def problem_of(values: Mapping[str, Any]) -> LevelProblem:
    """Return law (13) with the paper's gains and noise, and other values of parameters out of KNOWN.

    Raises:
        InvalidValueError: for an unknown name or a value that is not allowed.
    """
    refuse_others(values, KNOWN, "the certificate")
    plant, sensors, controller, _ = configure({**PAPER_NOISE, **values})
    box, gains = noise_box(plant, sensors, controller), controller.gains
    law = {"gamma": gains.gamma, "k": gains.k, "h": gains.h, "t_s": plant.sampling_time}
    numbers = {name: float(value) for name, value in (law | box._asdict()).items()}
    return LevelProblem(**numbers, exact_arc=plant.exact_arc)


def run(values: Mapping[str, Any], rho_max: float, tolerance: float, seed: int, out: Path) -> int:
    """Enclose the level and write the certificate to the file ``out``.

    Args:
        values: parameters out of KNOWN.
        rho_max: [m] the largest distance of the states that are covered.
        tolerance: gap between the bounds to aim at, as a share of the level.
        seed: of the search for a witness.
        out: file.

    Raises:
        DiffbotError: for a bad value, an unwritable file, or if no level is found below the top of V.
    """
    problem = problem_of(values)
    with output_folder(out.parent):
        began = time.monotonic()
        witness = find_witness(problem, rho_max, np.random.default_rng(seed))
        level, tree = find_level(problem, rho_max, tolerance, witness)
        certificate = LevelCertificate(problem, rho_max, level, tree, witness)
        seconds = time.monotonic() - began
        save_level(out, certificate, {"rounding": ROUNDING, "seconds": round(seconds, 1), "seed": seed})
    print(report(certificate))
    print(f"{leaves(tree)} cells, {seconds:.1f} s\n{out}")
    return 0


def find_witness(problem: LevelProblem, rho_max: float, rng: np.random.Generator) -> Witness | None:
    """Search a state of high V, and a noise with which V does not decrease there; None if none is found."""
    kernel = compile_bounds(climb)

    def climbed(choice: NDArray[np.float64], steps: int) -> tuple[float, NDArray[np.float64]]:
        # Few numbers change at a time: most lie at a bound and stay there.
        normal = rng.standard_normal((steps, 7)) * (rng.random((steps, 7)) < 0.35)
        return kernel(choice, normal, rho_max, problem), choice

    with tqdm(desc="witness", total=_STARTS + _POLISHED, unit="climb", disable=None) as bar:
        found = []
        for _ in range(_STARTS):
            found.append(climbed(rng.uniform(-1.0, 1.0, 7), _TRIES))
            bar.update()
        found.sort(key=lambda one: -one[0])
        for i in range(_POLISHED):
            found[i] = climbed(found[i][1], _LONG)
            bar.update()
    best, choice = max(found, key=lambda one: one[0])
    return witness_at(choice, farthest(choice, rho_max, problem), problem) if best > 0.0 else None


def find_level(
    problem: LevelProblem, rho_max: float, tolerance: float, witness: Witness | None
) -> tuple[float, NDArray[np.uint8]]:
    """Return a certified level and the tree that shows it; the gap to the witness grows until one is found.

    Raises:
        DiffbotError: if there is none below V at ``rho_max``.
    """
    top = branching.top_level(problem, rho_max)
    below = levels(witness, problem)[0] if witness else 0.0
    gap = tolerance * max(below, 0.01 * top)
    while below + gap < 0.5 * rho_max * rho_max:
        tree = walk(problem, below + gap, top)
        if tree is not None:
            return below + gap, tree
        gap *= _WIDER
    raise DiffbotError(f"no level is shown within {rho_max:g} m: the noise may be too large, or the circle too small")


def walk(problem: LevelProblem, level: float, top: float) -> NDArray[np.uint8] | None:
    """Return a tree that shows the claim for a level, None if that takes too many or too small cells."""
    kernel = compile_bounds(branching.search)
    stack = np.zeros((branching.DEPTH + 2, 12))
    stack[0] = branching.root_cell(problem, top)
    depths = np.zeros(branching.DEPTH + 2, np.int64)
    state = np.array([1.0, level, top, 0.0])
    parts: list[NDArray[np.uint8]] = []
    with tqdm(desc=f"V > {level:.4f}", total=1.0, disable=None, bar_format="{l_bar}{bar}| {elapsed}") as bar:
        while state[0] > 0.0 and len(parts) * _NODES_AT_A_TIME < _MAX_NODES:
            tree = np.empty(_NODES_AT_A_TIME, np.uint8)
            parts.append(tree[: kernel(stack, depths, state, tree, problem)])
            bar.update(state[3] - bar.n)
    return np.concatenate(parts) if state[0] == 0.0 else None
