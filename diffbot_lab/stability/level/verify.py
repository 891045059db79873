"""Checks the file of ``diffbot stability level`` again: each cell, the witness, and random states and noises.

The root box and the top level are computed here from the claim, not read from the file. The tree covers the root by
its form; each leaf is checked with the bounds of level/leaf.py, which share no code with the search. A leaf that does
not pass is halved in the dimension that matters most, and its halves are checked, some times over. Against an error in
the bounds themselves, the project's own law and plant are simulated from random states above and below the level, with
random noise.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.interval.compiled import compile_bounds
from diffbot_lab.stability.level.file import LevelCertificate, load_level
from diffbot_lab.stability.level.leaf import Boxes, root_of, settled, top_of
from diffbot_lab.stability.level.problem import LevelProblem, Witness
from diffbot_lab.stability.level.report import leaves, report
from diffbot_lab.stability.level.step import MARGIN, levels

Array = NDArray[np.float64]

_NODES_AT_A_TIME = 20_000
_STACK = 256
"""boxes that wait in a walk; more than any tree of the search needs"""
_HALVINGS = 24
"""A leaf that does not pass is halved so many times ..."""
_HOPELESS = 2_000
"""... unless more boxes of a part than that do not pass."""
_WEIGHTS = np.array([0.1, 1.0, 0.1, 1.0, 0.1, 0.1])
"""How much a dimension's width matters for the bound; the one with the largest product is halved."""
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
        halved = verify_level(certificate)
    except DiffbotError as error:
        raise DiffbotError(f"{path}: {error}") from None
    print(report(certificate))
    print(
        f"Verified: {leaves(certificate.tree)} cells, {halved} of them in parts; {_SAMPLES} random steps, "
        f"{time.monotonic() - began:.1f} s."
    )
    return 0


def verify_level(certificate: LevelCertificate) -> int:
    """Check a certificate; return the number of cells that were halved to show it.

    Raises:
        DiffbotError: naming what is not shown.
    """
    problem, rho_max, level, tree, witness = certificate
    top = top_of(problem, rho_max)
    if not level < 0.5 * rho_max * rho_max:
        raise DiffbotError(f"level = {level!r}: must be < rho_max^2 / 2 = {0.5 * rho_max * rho_max!r}")
    if witness is not None:
        _check_witness(witness, problem, rho_max, level)
    halved = _check_tree(problem, tree, level, top)
    _check_samples(problem, rho_max, level)
    return halved


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


def _check_tree(problem: LevelProblem, tree: NDArray[np.uint8], level: float, top: float) -> int:
    """Check each leaf; return how many did not pass at once."""
    number = 0
    for boxes, nodes in _leaves_of(tree, root_of(problem, top)):
        failing = np.flatnonzero(~settled(Boxes.of(boxes), problem, level, top))
        number += len(failing)
        part, owner = boxes[failing], failing
        for _ in range(_HALVINGS):
            if not 0 < len(part) <= _HOPELESS:
                break
            part, owner = _halves(part), np.concatenate([owner, owner])
            left = ~settled(Boxes.of(part), problem, level, top)
            part, owner = part[left], owner[left]
        if len(part):
            row = boxes[owner[0]]
            sides = ", ".join(
                f"{name} {row[2 * i]:.6g} to {row[2 * i + 1]:.6g}" for i, name in enumerate(Boxes._fields)
            )
            raise DiffbotError(f"tree: node {nodes[owner[0]]} is not shown: {sides}")
    return number


def _halves(boxes: Array) -> Array:
    """Return the lower halves of boxes (n, 12), and then the upper ones."""
    dimension = (_WEIGHTS * (boxes[:, 1::2] - boxes[:, ::2])).argmax(axis=1)
    every = np.arange(len(boxes))
    middle = 0.5 * (boxes[every, 2 * dimension] + boxes[every, 2 * dimension + 1])
    lower, upper = boxes.copy(), boxes.copy()
    lower[every, 2 * dimension + 1] = middle
    upper[every, 2 * dimension] = middle
    return np.concatenate([lower, upper])


def _leaves_of(tree: NDArray[np.uint8], root: Array) -> Iterator[tuple[Array, NDArray[np.int64]]]:
    """Walk a tree from its root box (12,); give the boxes (n, 12) of its leaves and their nodes, part by part.

    Raises:
        DiffbotError: if the tree does not cover the root.
    """
    kernel = compile_bounds(walk)
    stack, size = np.zeros((_STACK, 12)), 1
    stack[0] = root
    with tqdm(desc="cells", total=len(tree), unit="cell", disable=None) as bar:
        for at in range(0, len(tree), _NODES_AT_A_TIME):
            part = tree[at : at + _NODES_AT_A_TIME]
            boxes, nodes = np.empty((len(part), 12)), np.empty(len(part), np.int64)
            done, size, found = kernel(part, stack, size, boxes, nodes)
            if done < len(part):
                raise DiffbotError(f"tree: node {at + done} is wrong: byte {part[done]}, {size} cells are open")
            yield boxes[:found], at + nodes[:found]
            bar.update(len(part))
    if size:
        raise DiffbotError(f"tree: ends with {size} cells left out")


def walk(
    tree: NDArray[np.uint8], stack: Array, size: int, boxes: Array, nodes: NDArray[np.int64]
) -> tuple[int, int, int]:
    """Walk a part of a tree.

    Args:
        tree: (n,) its bytes.
        stack: (m, 12) boxes that the next nodes stand for, the next one at ``size`` - 1.
        size: number of them.
        boxes: (n, 12) to be filled with those of the leaves.
        nodes: (n,) to be filled with their indices in the part.

    Returns:
        The number of nodes walked, less than n if one is wrong: an unknown byte, a node after the last leaf, or one
        halved too often; the number of boxes that wait; the number of leaves.
    """
    found = 0
    for node in range(len(tree)):
        byte = tree[node]
        if size == 0 or byte > 6 or (byte > 0 and size == len(stack)):
            return node, size, found
        last = size - 1
        if byte == 0:
            boxes[found], nodes[found] = stack[last], node
            found += 1
            size -= 1
        else:
            low, high = 2 * (byte - 1), 2 * (byte - 1) + 1
            middle = 0.5 * (stack[last, low] + stack[last, high])
            stack[size] = stack[last]
            # The lower half comes first.
            stack[size, high] = middle
            stack[last, low] = middle
            size += 1
    return len(tree), size, found


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
