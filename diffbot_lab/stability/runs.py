"""The whole loop against a certificate: the library's own step with errors within the contract, from any memory.

The law is the one that requests (:func:`requesting`); estimate and base have errors that are drawn here. In Omega_G the
rank of the state has to fall in every step, in Omega_L the state has to stay in the core.
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
from diffbot_control.law.steering import BACK, FRONT, Course
from diffbot_control.law.switching import SwitchingMemory, new_memory, step, with_motion
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist, WheelSpeeds, body_twist, wheel_speeds
from diffbot_core.uncertainty import Estimate, Uncertainty
from diffbot_lab.stability.checker import TOO_HIGH, Cells, cells_of, rank_at
from diffbot_lab.stability.checker_bounds import farthest_local, longest_step, numbers_of
from diffbot_lab.stability.compiled import compile_bounds
from diffbot_lab.stability.file import Certificate
from diffbot_lab.stability.plan import Contract, Requests, request, requesting
from diffbot_sim.plant import integrate

Array = NDArray[np.float64]

SIGMA_THETA = 0.01
"""[rad] what the estimate reports of its heading: known well enough for the goal"""
ERRORS = 8
"""errors of x, y, theta, of the left and the right wheel, of the base in x and y, and of its rotation"""
_RUNS_AT_A_TIME = 2000
_SHORT = 20
"""steps of a run from a memory that is drawn"""
_ALIGNED = 0.03
"""share of pi of the headings of half of the runs that start near the goal: rest is counted with a small error"""


class ContractLoop(NamedTuple):
    """The closed loop that a certificate is about: the law and the errors that it may meet."""

    law: Requests
    contract: Contract
    period: float
    """[s]"""


class Counts(NamedTuple):
    """What runs did."""

    steps: int
    from_core: int
    """steps that began in the core"""
    left_core: int
    """of these, the ones that ended outside of it"""
    departures: int
    """times that a rest without an answer ended Omega_L"""
    broken: int
    """runs with a step whose rank did not fall, or that left the core"""
    longest: int
    """steps until a run was in the core for good"""


def loop_of(certificate: Certificate) -> ContractLoop:
    """Return the loop that a certificate is about."""
    plan = certificate.plan
    return ContractLoop(requesting(certificate.config, plan), plan.contract, plan.period)


def next_pose(
    loop: ContractLoop, pose: Pose, memory: SwitchingMemory, sigma: float, errors: Any
) -> tuple[Pose, SwitchingMemory, float]:
    """Return pose and memory after one step towards the origin, and the distance [m] that was measured.

    Args:
        loop: law, contract and period.
        pose: true one.
        memory: of the controller.
        sigma: [m] that the estimate reports.
        errors: (ERRORS,) shares of their bounds.
    """
    law, contract, period = loop
    # The corners of the square are drawn into the disc.
    rho = math.hypot(pose.x, pose.y)
    share = (contract.eps_position + contract.position_slope * rho) / max(1.0, math.hypot(errors[0], errors[1]))
    seen = Pose(
        pose.x + share * errors[0],
        pose.y + share * errors[1],
        wrap_angle(pose.theta + (contract.eps_theta + contract.theta_slope * rho) * errors[2]),
    )
    estimate = Estimate(seen, Uncertainty(sigma, SIGMA_THETA))
    observation = Observation(estimate, period, period, CONTACT_UNKNOWN)
    memory, _, report = step(memory, observation, Pose(0.0, 0.0, 0.0), law.config)
    command = request(law, memory, estimate)
    wheels = wheel_speeds(command, law.config.data_sheet.wheels)
    left = wheels.left * (1.0 + contract.wheel_error * errors[3])
    right = wheels.right * (1.0 + contract.wheel_error * errors[4])
    driven = body_twist(WheelSpeeds(left, right), law.config.data_sheet.wheels)
    after = integrate(pose, Twist(driven.v, driven.omega + contract.eps_omega * errors[7]), period, True)
    beside = contract.eps_v * period / max(1.0, math.hypot(errors[5], errors[6]))
    after = Pose(after.x + beside * errors[5], after.y + beside * errors[6], after.theta)
    return after, with_motion(memory, command, memory.actuation), report.rho


def sigma_at(loop: ContractLoop, pose: Pose) -> float:
    """Largest standard deviation [m] that the estimate may report at a true pose."""
    contract = loop.contract
    return float(contract.sigma_max + contract.sigma_slope * math.hypot(pose.x, pose.y))


def rank_of(cells: Cells, pose: Pose, leading: int) -> int:
    """Rank of a pose with this end of the robot leading."""
    turned = math.pi if leading == BACK else 0.0
    beta = math.atan2(-pose.y, -pose.x)
    return rank_at(cells, math.hypot(pose.x, pose.y), wrap_angle(beta - pose.theta - turned), wrap_angle(beta - turned))


def drawn_memory(loop: ContractLoop, rng: Any) -> SwitchingMemory:
    """Draw a memory that the law may have when a contract begins to hold, or later."""
    new, sheet = new_memory(), loop.law.config.data_sheet
    command = Twist(sheet.v_max * (2.0 * rng.random() - 1.0), sheet.omega_max * (2.0 * rng.random() - 1.0))
    switching = Switching(OMEGA_G, 0, 0.0)
    if rng.random() < 0.5:
        switching = Switching(OMEGA_L, 1, 0.0)
        if rng.random() < 0.5:
            command, switching = Twist(0.0, 0.0), Switching(OMEGA_L, 1, 2.0 * REST * rng.random())
    course = Course(FRONT if rng.random() < 0.5 else BACK, False)
    return SwitchingMemory(switching, command, new.settling, course, new.actuation, rng.random() < 0.3)


def moved_anyhow(pose: Pose, way: float, rng: Any) -> Pose:
    """Return the pose after a motion of the base that the law did not request, over a way [m]."""
    direction = 2.0 * math.pi * rng.random()
    return Pose(
        pose.x + way * math.cos(direction),
        pose.y + way * math.sin(direction),
        wrap_angle(pose.theta + math.pi * (2.0 * rng.random() - 1.0)),
    )


def _runs(loop: ContractLoop, cells: Cells, starts: Any, near: Any, steps: int, rng: Any, out: Any) -> None:
    """Drive from each start with random errors, half of them at their bounds.

    Args:
        loop: law, contract and period.
        cells: with ranks.
        starts: (n, 3) poses.
        near: 1 if the memory is drawn, 0 for that of a new goal; and the way [m] of a step near the goal that the
            contract allows in any direction.
        steps: of each run.
        rng: random generator.
        out: (n, 3) array for the last poses, and (n, 6) for the fields of :class:`Counts`.
    """
    ends, counts = out
    errors, tolerance = np.empty(ERRORS), loop.law.config.tolerance
    for index in range(len(starts)):
        pose = Pose(starts[index, 0], starts[index, 1], starts[index, 2])
        memory = drawn_memory(loop, rng) if near[0] > 0.0 else new_memory()
        for number in range(steps):
            extreme = rng.random() < 0.5
            for at in range(ERRORS):
                error = 2.0 * rng.random() - 1.0
                errors[at] = math.copysign(1.0, error) if extreme else error
            sigma, region = sigma_at(loop, pose) * rng.random(), memory.switching.region
            after, memory, measured = next_pose(loop, pose, memory, sigma, errors)
            is_near = measured <= leaving_radius(sigma, tolerance)
            if is_near and rng.random() < 0.2:
                after = moved_anyhow(pose, near[1], rng)
            before = rank_of(cells, pose, memory.course.leading)
            rank = rank_of(cells, after, memory.course.leading)
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


_runs_kernel = compile_bounds(_runs)


def uniform_starts(rng: np.random.Generator, number: int, radius: float) -> Array:
    """Return poses (number, 3) all over a disc of this radius [m], with any heading."""
    rho, angle = radius * np.sqrt(rng.random(number)), rng.uniform(-math.pi, math.pi, number)
    return np.stack([rho * np.cos(angle), rho * np.sin(angle), rng.uniform(-math.pi, math.pi, number)], axis=1)


def drive(
    certificate: Certificate, runs: int, radius: float, steps: int, seed: int, *, any_memory: bool
) -> tuple[Counts, Array]:
    """Drive runs with a progress bar; return what they did, and their last poses (runs, 3).

    Args:
        certificate: to compare with.
        runs: how many.
        radius: [m] starts are all over the disc; if the memory is drawn, half of them near the goal.
        steps: of each.
        seed: part i of the runs has the generator (seed, i).
        any_memory: the memory at the start is drawn, too; otherwise that of a new goal.
    """
    loop, cells = loop_of(certificate), cells_of(certificate)
    numbers = numbers_of(loop.law, certificate.plan)
    reach, near = farthest_local(numbers), (float(any_memory), 0.999 * longest_step(numbers, numbers.leaving))

    def part(first: int) -> tuple[Array, NDArray[np.int64]]:
        rng, many = np.random.default_rng((seed, first)), min(_RUNS_AT_A_TIME, runs - first)
        starts = uniform_starts(rng, many, radius)
        if any_memory:
            starts[: many // 2] = uniform_starts(rng, many // 2, reach)
            starts[: many // 4, 2] *= _ALIGNED
        ends, counts = np.empty((many, 3)), np.zeros((many, len(Counts._fields)), np.int64)
        _runs_kernel(loop, cells, starts, near, steps, rng, (ends, counts))
        return ends, counts

    firsts, found = range(0, runs, _RUNS_AT_A_TIME), []
    with ThreadPoolExecutor() as pool, tqdm(desc="runs", total=runs, unit="run", disable=None) as bar:
        for one in pool.map(part, firsts):
            found.append(one)
            bar.update(len(one[0]))
    ends, counts = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return Counts(*(int(one) for one in (*counts[:, :-1].sum(axis=0), counts[:, -1].max()))), ends


def sample(certificate: Certificate, steps: int, seed: int) -> Counts:
    """Drive short runs from drawn memories, ``steps`` steps in all."""
    runs = -(-steps // _SHORT)
    return drive(certificate, runs, float(certificate.rho[-1]), _SHORT, seed, any_memory=True)[0]
