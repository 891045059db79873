"""Compare a certificate with simulated runs of the law itself, with random errors within the contract.

The runs use the ideal law (:func:`ideal_law`). In Omega_G the rank of the state has to decrease in every step. In
Omega_L the state has to stay in the core.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_control.law.law import CONTACT_UNKNOWN, Observation
from diffbot_control.law.regions import OMEGA_G, OMEGA_L, REST, Switching, leaving_radius
from diffbot_control.law.steering import BACKWARD, FORWARD, Approach
from diffbot_control.law.switching import SwitchingMemory, new_memory, step, with_motion
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist, WheelSpeeds, body_twist, wheel_speeds
from diffbot_core.uncertainty import Estimate, Uncertainty
from diffbot_lab.stability.checker import TOO_HIGH, Cells, cells_of, rank_at
from diffbot_lab.stability.checker_bounds import checker_loop, local_reach, longest_step
from diffbot_lab.stability.compiled import compile_bounds
from diffbot_lab.stability.file import Certificate
from diffbot_lab.stability.plan import Contract, IdealLaw, ideal_law, requested_command
from diffbot_sim.plant import integrate

Array = NDArray[np.float64]

SIGMA_THETA = 0.01
"""[rad] reported standard deviation of the heading. It is small enough for the goal to count as reached"""
ERRORS = 8
"""number of errors: x, y and theta of the estimate; left and right wheel; x, y and rotation of the base"""
_CHUNK = 2000
"""number of runs that share a random generator"""
_SHORT = 20
"""number of steps of a run from a random memory"""
_ALIGNED = 0.03
"""largest heading, as a share of pi, of half of the runs that start near the goal, so that some robots come to rest"""


class ContractLoop(NamedTuple):
    """The closed loop of a certificate: law, contract and period."""

    law: IdealLaw
    contract: Contract
    period: float
    """[s]"""


class Counts(NamedTuple):
    """Counts of steps and runs."""

    steps: int
    from_core: int
    """steps that began in the core"""
    left_core: int
    """steps that began in the core and ended outside it"""
    departures: int
    """departures from Omega_L of a robot that rested without reaching the goal"""
    broken: int
    """runs in which a rank did not decrease, or which left the core"""
    longest: int
    """largest number of steps after which a run stayed in the core"""


def loop_of(certificate: Certificate) -> ContractLoop:
    """Return the loop of a certificate."""
    plan = certificate.plan
    return ContractLoop(ideal_law(certificate.config, plan), plan.contract, plan.period)


def next_pose(
    loop: ContractLoop, pose: Pose, memory: SwitchingMemory, sigma: float, errors: Any
) -> tuple[Pose, SwitchingMemory, float]:
    """Return pose and memory after one step towards a goal at the origin, and the measured distance [m].

    Args:
        loop: law, contract and period.
        pose: true pose.
        memory: memory of the controller.
        sigma: [m] reported standard deviation of the position.
        errors: (ERRORS,) errors in units of their bounds.
    """
    law, contract, period = loop
    # The bound of the position error is a disc, so pairs outside the disc are scaled to its edge.
    rho = math.hypot(pose.x, pose.y)
    share = (contract.eps_position + contract.position_slope * rho) / max(1.0, math.hypot(errors[0], errors[1]))
    measured = Pose(
        pose.x + share * errors[0],
        pose.y + share * errors[1],
        wrap_angle(pose.theta + (contract.eps_theta + contract.theta_slope * rho) * errors[2]),
    )
    estimate = Estimate(measured, Uncertainty(sigma, SIGMA_THETA))
    observation = Observation(estimate, period, period, CONTACT_UNKNOWN)
    memory, _, report = step(memory, observation, Pose(0.0, 0.0, 0.0), law.config)
    command = requested_command(law, memory, estimate)
    wheels = wheel_speeds(command, law.config.data_sheet.wheels)
    left = wheels.left * (1.0 + contract.wheel_error * errors[3])
    right = wheels.right * (1.0 + contract.wheel_error * errors[4])
    driven = body_twist(WheelSpeeds(left, right), law.config.data_sheet.wheels)
    after = integrate(pose, Twist(driven.v, driven.omega + contract.eps_omega * errors[7]), period, True)
    offset = contract.eps_v * period / max(1.0, math.hypot(errors[5], errors[6]))
    after = Pose(after.x + offset * errors[5], after.y + offset * errors[6], after.theta)
    return after, with_motion(memory, command, memory.actuation), report.rho


def sigma_at(loop: ContractLoop, pose: Pose) -> float:
    """Return the largest standard deviation [m] that the estimate may report at a true pose."""
    contract = loop.contract
    return float(contract.sigma_max + contract.sigma_slope * math.hypot(pose.x, pose.y))


def rank_of(cells: Cells, pose: Pose, direction: int) -> int:
    """Return the rank of a pose for a direction of travel, FORWARD or BACKWARD."""
    turned = math.pi if direction == BACKWARD else 0.0
    beta = math.atan2(-pose.y, -pose.x)
    return rank_at(cells, math.hypot(pose.x, pose.y), wrap_angle(beta - pose.theta - turned), wrap_angle(beta - turned))


def random_memory(loop: ContractLoop, rng: Any) -> SwitchingMemory:
    """Return a random memory that the law may have when the contract begins to hold."""
    new, sheet = new_memory(), loop.law.config.data_sheet
    command = Twist(sheet.v_max * (2.0 * rng.random() - 1.0), sheet.omega_max * (2.0 * rng.random() - 1.0))
    switching = Switching(OMEGA_G, 0, 0.0)
    if rng.random() < 0.5:
        switching = Switching(OMEGA_L, 1, 0.0)
        if rng.random() < 0.5:
            command, switching = Twist(0.0, 0.0), Switching(OMEGA_L, 1, 2.0 * REST * rng.random())
    approach = Approach(FORWARD if rng.random() < 0.5 else BACKWARD, False)
    return SwitchingMemory(switching, command, new.settling, approach, new.actuation, rng.random() < 0.3)


def random_motion(pose: Pose, distance: float, rng: Any) -> Pose:
    """Return the pose after a motion by a distance [m] in a random direction, with a random rotation."""
    direction = 2.0 * math.pi * rng.random()
    return Pose(
        pose.x + distance * math.cos(direction),
        pose.y + distance * math.sin(direction),
        wrap_angle(pose.theta + math.pi * (2.0 * rng.random() - 1.0)),
    )


def _drive(loop: ContractLoop, cells: Cells, starts: Any, near: Any, steps: int, rng: Any, out: Any) -> None:
    """Drive from each start with random errors. In half of the steps, all errors are at their bounds.

    Args:
        loop: law, contract and period.
        cells: cells with ranks.
        starts: (n, 3) poses.
        near: two numbers. The first is 1 for a random memory, 0 for the memory of a new goal. The second is the length
            [m] of random motions near the goal, where the contract allows any direction.
        steps: number of steps of each run.
        rng: random generator.
        out: two arrays to fill: (n, 3) last poses, and (n, 6) fields of :class:`Counts`.
    """
    ends, counts = out
    errors, tolerance = np.empty(ERRORS), loop.law.config.tolerance
    for index in range(len(starts)):
        pose = Pose(starts[index, 0], starts[index, 1], starts[index, 2])
        memory = random_memory(loop, rng) if near[0] > 0.0 else new_memory()
        for number in range(steps):
            at_bounds = rng.random() < 0.5
            for at in range(ERRORS):
                error = 2.0 * rng.random() - 1.0
                errors[at] = math.copysign(1.0, error) if at_bounds else error
            sigma, region = sigma_at(loop, pose) * rng.random(), memory.switching.region
            after, memory, measured = next_pose(loop, pose, memory, sigma, errors)
            is_near = measured <= leaving_radius(sigma, tolerance)
            if is_near and rng.random() < 0.2:
                after = random_motion(pose, near[1], rng)
            before = rank_of(cells, pose, memory.approach.direction)
            rank = rank_of(cells, after, memory.approach.direction)
            if before == TOO_HIGH:
                break
            is_far = memory.switching.region == OMEGA_G
            counts[index, 0] += 1
            if before == 0:
                counts[index, 1] += 1
                counts[index, 2] += rank > 0
            counts[index, 3] += is_near and is_far and region == OMEGA_L
            if rank > (max(before - 1, 0) if is_far else 0):
                counts[index, 4] = 1
            if rank > 0:
                counts[index, 5] = number + 1
            pose = after
        ends[index, 0], ends[index, 1], ends[index, 2] = pose.x, pose.y, pose.theta


_drive_kernel = compile_bounds(_drive)


def uniform_starts(rng: np.random.Generator, number: int, radius: float) -> Array:
    """Return poses (number, 3), uniformly distributed in a disc of this radius [m], with random headings."""
    rho, angle = radius * np.sqrt(rng.random(number)), rng.uniform(-math.pi, math.pi, number)
    return np.stack([rho * np.cos(angle), rho * np.sin(angle), rng.uniform(-math.pi, math.pi, number)], axis=1)


def drive(
    certificate: Certificate, runs: int, radius: float, steps: int, seed: int, *, any_memory: bool
) -> tuple[Counts, Array]:
    """Simulate runs with random errors. Return the counts and the last poses (runs, 3).

    Args:
        certificate: certificate with the ranks.
        runs: number of runs.
        radius: [m] radius of the disc of the starts. With random memories, half of the runs start near the goal.
        steps: number of steps of each run.
        seed: seed of starts, memories and errors.
        any_memory: True to start with random memories; False to start with the memory of a new goal.
    """
    loop, cells = loop_of(certificate), cells_of(certificate)
    bounds = checker_loop(loop.law, certificate.plan)
    reach, near = local_reach(bounds), (float(any_memory), 0.999 * longest_step(bounds, bounds.leaving))

    def drive_chunk(first: int) -> tuple[Array, NDArray[np.int64]]:
        rng, count = np.random.default_rng((seed, first)), min(_CHUNK, runs - first)
        starts = uniform_starts(rng, count, radius)
        if any_memory:
            starts[: count // 2] = uniform_starts(rng, count // 2, reach)
            starts[: count // 4, 2] *= _ALIGNED
        ends, counts = np.empty((count, 3)), np.zeros((count, len(Counts._fields)), np.int64)
        _drive_kernel(loop, cells, starts, near, steps, rng, (ends, counts))
        return ends, counts

    chunks = []
    with ThreadPoolExecutor() as pool, tqdm(desc="runs", total=runs, unit="run", disable=None) as bar:
        for chunk in pool.map(drive_chunk, range(0, runs, _CHUNK)):
            chunks.append(chunk)
            bar.update(len(chunk[0]))
    ends, counts = (np.concatenate(parts) for parts in zip(*chunks, strict=True))
    return Counts(*(int(one) for one in (*counts[:, :-1].sum(axis=0), counts[:, -1].max()))), ends


def sample(certificate: Certificate, steps: int, seed: int) -> Counts:
    """Drive short runs from random memories, with about ``steps`` steps in total."""
    runs = -(-steps // _SHORT)
    return drive(certificate, runs, float(certificate.rho[-1]), _SHORT, seed, any_memory=True)[0]
