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

from diffbot_control.law.configuration import ControllerConfig, ControllerMemory, new_memory
from diffbot_control.law.controller import step
from diffbot_control.law.finish import NO_LEG, TO_AND_FRO, V_LEG, Finish, longest_reach
from diffbot_control.law.regions import OMEGA_G, OMEGA_L, Switching
from diffbot_control.law.steering import BACK, FRONT, Course
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist, WheelSpeeds, body_twist, wheel_speeds
from diffbot_core.uncertainty import Estimate, Uncertainty
from diffbot_lab.stability.check.cells import TOO_HIGH, Cells, cells_of, rank_at
from diffbot_lab.stability.check.near import leaving_radius
from diffbot_lab.stability.compiled import compile_bounds
from diffbot_lab.stability.file import Certificate
from diffbot_lab.stability.plan import Contract, requesting
from diffbot_sim.model.plant import integrate

Array = NDArray[np.float64]

SIGMA_THETA = 0.01
"""[rad] what the estimate reports of its heading: known well enough for the goal"""
_RUNS_AT_A_TIME = 2000
_SHORT = 20
"""steps of a run from a memory that is drawn"""


class ContractLoop(NamedTuple):
    """The closed loop that a certificate is about: the law and the errors that it may meet."""

    law: ControllerConfig
    """as it requests"""
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
    broken: int
    """runs with a step whose rank did not fall, or that left the core"""
    longest: int
    """steps until a run was in the core for good"""


def loop_of(certificate: Certificate) -> ContractLoop:
    """Return the loop that a certificate is about."""
    plan = certificate.plan
    return ContractLoop(requesting(certificate.config, plan), plan.contract, plan.period)


def next_pose(loop: ContractLoop, pose: Pose, memory: ControllerMemory, sigma: float, errors: Any) -> Any:
    """Return pose and memory after one step towards the origin.

    Args:
        loop: law, contract and period.
        pose: true one.
        memory: of the controller.
        sigma: [m] that the estimate reports.
        errors: of x, y, theta, of the left and the right wheel, of the base in x and y, and of its rotation, in shares
            of their bounds.
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
    memory, command, _ = step(memory, estimate, Pose(0.0, 0.0, 0.0), period, law)
    wheels = wheel_speeds(command, law.data_sheet.wheels)
    left = wheels.left * (1.0 + contract.wheel_error * errors[3])
    right = wheels.right * (1.0 + contract.wheel_error * errors[4])
    driven = body_twist(WheelSpeeds(left, right), law.data_sheet.wheels)
    after = integrate(pose, Twist(driven.v, driven.omega + contract.eps_omega * errors[7]), period, True)
    beside = contract.eps_v * period / max(1.0, math.hypot(errors[5], errors[6]))
    return Pose(after.x + beside * errors[5], after.y + beside * errors[6], after.theta), memory


def sigma_at(loop: ContractLoop, pose: Pose) -> float:
    """Largest standard deviation [m] that the estimate may report at a true pose."""
    contract = loop.contract
    return float(contract.sigma_max + contract.sigma_slope * math.hypot(pose.x, pose.y))


def rank_of(cells: Cells, pose: Pose, leading: int) -> int:
    """Rank of a pose with this end of the robot leading."""
    turned = math.pi if leading == BACK else 0.0
    beta = math.atan2(-pose.y, -pose.x)
    return rank_at(cells, math.hypot(pose.x, pose.y), wrap_angle(beta - pose.theta - turned), wrap_angle(beta - turned))


def memory_at(loop: ContractLoop, rho: float, within: float, reach: float, rng: Any) -> ControllerMemory:
    """Draw a memory that the law may have at a true distance ``rho`` [m] when a contract begins to hold, or later.

    Args:
        loop: law, contract and period.
        rho: [m]
        within: [m] where no pose can count as outside of Omega_L: only there a leg is drawn, begun within the contract.
        reach: [m] of the longest one.
        rng: random generator.
    """
    new = new_memory()
    course = Course(FRONT if rng.random() < 0.5 else BACK, False)
    sheet, policy = loop.law.data_sheet, loop.law.region_policy.covariance
    command = Twist(sheet.v_max * (2.0 * rng.random() - 1.0), sheet.omega_max * (2.0 * rng.random() - 1.0))
    switching, finish, reached = new.switching, new.finish, rng.random() < 0.5
    if rng.random() < 0.5:
        switching = Switching(OMEGA_L, 1, int(policy.eps_P_leave_steps * rng.random()))
        side, kind = (1.0 if rng.random() < 0.5 else -1.0), rng.random()
        if kind < 0.4:
            command = Twist(0.0, 0.0)
            finish = Finish(NO_LEG, 0.0, 0.0, 0, 2.0 * loop.law.finish.finish_wait * rng.random())
        elif rho < within:
            leg = TO_AND_FRO if kind < 0.6 else V_LEG
            finish = Finish(leg, side, reach * rng.random(), 1 + int(3.0 * rng.random()), 0.0)
    return ControllerMemory(switching, command, new.settling, new.reapproach, finish, course, new.actuation, reached)


def _runs(loop: ContractLoop, cells: Cells, starts: Any, drawn: Any, steps: int, rng: Any, out: Any) -> None:
    """Drive from each start with random errors, half of them at their bounds.

    Args:
        loop: law, contract and period.
        cells: with ranks.
        starts: (n, 3) poses.
        drawn: distance [m] up to which a memory of Omega_L is drawn, and reach [m] of the longest leg; the distance 0:
            the memory is that of a new goal.
        steps: of each run.
        rng: random generator.
        out: (n, 3) array for the last poses, and (n, 5) for the fields of :class:`Counts`.
    """
    ends, counts = out
    errors, grace = np.empty(8), loop.law.region_policy.covariance.eps_P_leave_steps
    for index in range(len(starts)):
        pose = Pose(starts[index, 0], starts[index, 1], starts[index, 2])
        memory = new_memory()
        if drawn[0] > 0.0:
            memory = memory_at(loop, math.hypot(pose.x, pose.y), drawn[0], drawn[1], rng)
        for number in range(steps):
            extreme = rng.random() < 0.5
            for at in range(8):
                error = 2.0 * rng.random() - 1.0
                errors[at] = math.copysign(1.0, error) if extreme else error
            after, memory = next_pose(loop, pose, memory, sigma_at(loop, pose) * rng.random(), errors)
            before = rank_of(cells, pose, memory.course.leading)
            rank = rank_of(cells, after, memory.course.leading)
            if before == TOO_HIGH:
                break
            allowed = max(before - 1, 0) if memory.switching.region == OMEGA_G else 0
            # A region that was entered before the contract held may last for a few steps, anywhere.
            free = number < grace and memory.switching.region != OMEGA_G
            counts[index, 0] += 1
            if before == 0 and not free:
                counts[index, 1] += 1
                counts[index, 2] += rank > 0
            if rank > allowed and not free:
                counts[index, 3] = 1
            if rank > 0:
                counts[index, 4] = number + 1
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
        radius: [m] starts are all over the disc; if the memory is drawn, half of them where legs may be driven.
        steps: of each.
        seed: part i of the runs has the generator (seed, i).
        any_memory: the memory at the start is drawn, too; otherwise that of a new goal.
    """
    loop, cells = loop_of(certificate), cells_of(certificate)
    resting = leaving_radius(loop.law, loop.contract.sigma_max, 0.0)
    surely = max(resting - loop.contract.at(resting).eps_position, 1e-9) if any_memory else 0.0
    drawn = surely, longest_reach(resting, loop.law.tolerance)

    def part(first: int) -> tuple[Array, NDArray[np.int64]]:
        rng, many = np.random.default_rng((seed, first)), min(_RUNS_AT_A_TIME, runs - first)
        starts = uniform_starts(rng, many, radius)
        if any_memory:
            starts[: many // 2] = uniform_starts(rng, many // 2, 2.0 * surely)
        ends, counts = np.empty((many, 3)), np.zeros((many, 5), np.int64)
        _runs_kernel(loop, cells, starts, drawn, steps, rng, (ends, counts))
        return ends, counts

    firsts, found = range(0, runs, _RUNS_AT_A_TIME), []
    with ThreadPoolExecutor() as pool, tqdm(desc="runs", total=runs, unit="run", disable=None) as bar:
        for one in pool.map(part, firsts):
            found.append(one)
            bar.update(len(one[0]))
    ends, counts = (np.concatenate(parts) for parts in zip(*found, strict=True))
    total = [int(one) for one in counts.sum(axis=0)]
    return Counts(total[0], total[1], total[2], total[3], int(counts[:, 4].max())), ends


def sample(certificate: Certificate, steps: int, seed: int) -> Counts:
    """Drive short runs from drawn memories, ``steps`` steps in all."""
    runs = -(-steps // _SHORT)
    return drive(certificate, runs, float(certificate.rho[-1]), _SHORT, seed, any_memory=True)[0]
