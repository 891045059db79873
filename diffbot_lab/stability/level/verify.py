"""Checks the file of ``diffbot stability level`` again: each cell, the witness, and random states and noises.

The root cell and the top level are computed here from the claim, not read from the file. The tree covers the root by
its form; each leaf is checked with the interval bound. Against an error in the bound itself, the project's own law
and plant are simulated from random states above and below the level, with random noise.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.interval.compiled import compile_bounds
from diffbot_lab.stability.level import branching
from diffbot_lab.stability.level.bounds import LevelProblem
from diffbot_lab.stability.level.enclosure import leaves, report
from diffbot_lab.stability.level.file import LevelCertificate, load_level
from diffbot_lab.stability.level.witness import MARGIN, Witness, levels

_NODES_AT_A_TIME = 100_000
_SAMPLES = 1_000_000
_NOISES = ("eps_x", "eps_y", "eps_theta", "eps_v", "eps_omega")


def run_verify(path: Path) -> int:
    """Check a file and print what it shows.

    Raises:
        DiffbotError: if it cannot be read, or naming what is not shown.
    """
    certificate = load_level(path)
    began = time.monotonic()
    try:
        verify_level(certificate)
    except DiffbotError as error:
        raise DiffbotError(f"{path}: {error}") from None
    print(report(certificate))
    print(f"Verified: {leaves(certificate.tree)} cells, {_SAMPLES} random steps, {time.monotonic() - began:.1f} s.")
    return 0


def verify_level(certificate: LevelCertificate) -> None:
    """Check a certificate.

    Raises:
        DiffbotError: naming what is not shown.
    """
    problem, rho_max, level, tree, witness = certificate
    top = branching.top_level(problem, rho_max)
    if not level < 0.5 * rho_max * rho_max:
        raise DiffbotError(f"level = {level!r}: must be < rho_max^2 / 2 = {0.5 * rho_max * rho_max!r}")
    if witness is not None:
        _check_witness(witness, problem, rho_max, level)
    _check_tree(problem, tree, level, top)
    _check_samples(problem, rho_max, level)


def _check_witness(witness: Witness, problem: LevelProblem, rho_max: float, level: float) -> None:
    if not 0.0 < witness.rho <= rho_max:
        raise DiffbotError(f"witness: rho = {witness.rho!r}: must be from 0 to rho_max = {rho_max!r}")
    for name in _NOISES:
        value, bound = getattr(witness, name), getattr(problem, name)
        if not abs(value) <= bound:
            raise DiffbotError(f"witness: {name} = {value!r}: must be within {bound!r}")
    before, after = levels(witness, problem)
    if not after - before > 0.5 * MARGIN:
        raise DiffbotError(f"witness: V goes from {before!r} to {after!r}: must increase")
    if not before <= level:
        raise DiffbotError(f"witness: V = {before!r} increases: must be <= level = {level!r}")


def _check_tree(problem: LevelProblem, tree: NDArray[np.uint8], level: float, top: float) -> None:
    kernel = compile_bounds(branching.check)
    stack = np.zeros((branching.STACK, 12))
    stack[0] = branching.root_cell(problem, top)
    state = np.array([1.0, level, top])
    with tqdm(desc="cells", total=len(tree), unit="cell", disable=None) as bar:
        for at in range(0, len(tree), _NODES_AT_A_TIME):
            part = tree[at : at + _NODES_AT_A_TIME]
            done = kernel(stack, state, part, problem)
            if done < len(part):
                cell = branching.cell_at(stack, max(int(state[0]) - 1, 0))
                bounds = ", ".join(f"{name} {value:.6g}" for name, value in cell._asdict().items())
                raise DiffbotError(f"tree: node {at + done} is not shown: {bounds}")
            bar.update(len(part))
    if state[0] > 0.0:
        raise DiffbotError(f"tree: ends with {int(state[0])} cells left out")


def _check_samples(problem: LevelProblem, rho_max: float, level: float) -> None:
    bounds = np.array([getattr(problem, name) for name in _NOISES])
    index = compile_bounds(first_rise)(_SAMPLES, np.random.default_rng(1), bounds, rho_max, level, problem)
    if index is not None:
        raise DiffbotError(f"a simulated step breaks the claim: {index}")


def first_rise(
    number: int,
    rng: np.random.Generator,
    bounds: NDArray[np.float64],
    rho_max: float,
    level: float,
    problem: LevelProblem,
) -> Witness | None:
    """Simulate random steps; return the first that breaks the claim, None if there is none.

    Args:
        number: of steps.
        rng: random generator.
        bounds: (5,) of the noise; each is drawn at its bound or uniformly within, with equal chance.
        rho_max: [m] of the states.
        level: claimed.
        problem: law, plant and noise.
    """
    noise = np.zeros(5)
    for _ in range(number):
        rho, alpha, beta = rho_max * rng.random(), np.pi * (2.0 * rng.random() - 1.0), np.pi * rng.random()
        for i in range(5):
            share = 2.0 * rng.random() - 1.0
            noise[i] = bounds[i] * (share if rng.random() < 0.5 else np.sign(share))
        step = Witness(rho, alpha, beta, noise[0], noise[1], noise[2], noise[3], noise[4])
        before, after = levels(step, problem)
        if after >= before + MARGIN if before > level else after > level + MARGIN:
            return step
    return None
