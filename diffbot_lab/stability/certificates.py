"""``diffbot stability certify`` and ``verify``: make and check a certificate."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tqdm import tqdm

from diffbot_control.law.configuration import SwitchingConfig
from diffbot_control.law.switching import SwitchingLaw
from diffbot_core.errors import DiffbotError
from diffbot_core.files import output_folder
from diffbot_lab.stability.checker import verify
from diffbot_lab.stability.contract import (
    fit_bounds,
    is_kept,
    kept_share,
    measure_deviations,
    runs_of_robot,
    start_radius,
)
from diffbot_lab.stability.file import Certificate, load_certificate, save_certificate
from diffbot_lab.stability.maker import certify
from diffbot_lab.stability.plan import SLOPES, Contract, Plan
from diffbot_lab.stability.runs import sample
from diffbot_sim.jit import law_version
from diffbot_tools.robot import read_robot

_RUNS = 200
"""number of runs to which the bounds are fitted; also the number of other runs with which the bounds are tested"""
_SEED = 9017
_RANDOM_STEPS = 1_000_000
"""approximate number of random steps in which ``verify`` compares the ranks with the law"""
_END = 45.0
"""[s] end of the part of a run in which the contract is measured. Afterwards, the robots rest at their goals"""


def report(certificate: Certificate) -> str:
    """Return the claims of a certificate as text."""
    claims, plan = certificate.claims, certificate.plan
    contract, steps = plan.contract, claims.steps
    position, theta, sigma = (getattr(contract, name) for name in SLOPES)
    slopes = f"  (each bound grows by {position:g} m, {theta:g} rad and {sigma:g} m per metre from the goal)\n"
    return (
        f"Law {SwitchingLaw.name}, one pose every {plan.period:g} s. Assumptions:\n"
        f"  the errors of the estimate are at most {contract.eps_position:g} m and {contract.eps_theta:g} rad,\n"
        f"  its standard deviation is at most {contract.sigma_max:g} m,\n"
        f"{slopes if max(position, theta, sigma) > 0.0 else ''}"
        f"  the speed of each wheel is off by at most {100.0 * contract.wheel_error:g} %,\n"
        f"  and the base is off the request by at most {contract.eps_v:g} m/s and {contract.eps_omega:g} rad/s.\n"
        f"Every trajectory that starts within {claims.start:g} m is in the core after at most "
        f"{steps * plan.period:g} s ({steps} steps), and stays in the core.\n"
        f"The core is within r* = {math.ceil(1e4 * claims.radius) / 1e4:.4f} m of the goal."
    )


def certify_and_save(config: SwitchingConfig, plan: Plan, out: Path, threads: int | None) -> None:
    """Make a certificate of the default law, write it to a file, and print its claims.

    Args:
        config: configuration of the controller.
        plan: contract, period, start and cells.
        out: file of the certificate.
        threads: number of threads; None means one per core.

    Raises:
        DiffbotError: if the configuration is not covered, no certificate is found, or the file cannot be written.
    """
    began = time.monotonic()
    with output_folder(out.parent):
        certificate = certify(config, plan, threads)
        save_certificate(out, certificate)
    print(report(certificate))
    print(f"Made {len(certificate.ranks)} cells in {time.monotonic() - began:.0f} s.")
    print(f"The certificate is not verified yet: run diffbot stability verify {out}")


def certify_robot(
    name: str, bounds: Mapping[str, float], since: float, cells: Mapping[str, Any], out: Path, threads: int | None
) -> None:
    """Certify a robot, and print the share of other simulated runs that keep the contract.

    Bounds that are not given are fitted to simulated runs that start at rest.

    Args:
        name: parameter file or preset.
        bounds: given bounds of the contract by name.
        since: [s] start of the part of each run in which the contract is measured.
        cells: ``margin`` and ``fineness``, if they are given.
        out: file of the certificate.
        threads: number of threads; None means one per core.

    Raises:
        DiffbotError: if the robot is not covered, or no certificate is found.
    """
    robot = read_robot(name)
    runs = runs_of_robot(robot, _RUNS, _SEED)
    t_s = runs.case.robot.plant.sampling_time
    part = slice(round(since / t_s), round(_END / t_s) + 1)
    slopes = {name: value for name, value in bounds.items() if name in SLOPES}
    contract = Contract(wheel_error=runs.case.robot.plant.drive_noise, **slopes)
    with tqdm(total=2 * _RUNS, desc="contract", unit="run", disable=None) as bar:
        fitted = fit_bounds(measure_deviations(runs, contract, _SEED, bar)[:, part], contract)
        unbounded = [one for one, value in fitted.items() if not value < 1.0 and one not in bounds]
        if unbounded:
            raise DiffbotError(
                f"no contract: {', '.join(unbounded)} is not below 1 in all simulated runs after {since:g} s; "
                "choose a later --since"
            )
        contract = Contract(**{**contract._asdict(), **fitted, **bounds})
        others = measure_deviations(runs_of_robot(robot, _RUNS, _SEED + 1), contract, _SEED + 1, bar)
    share = kept_share(is_kept(others[:, part], contract))
    plan = Plan(contract, t_s, start_radius(robot), **cells)
    try:
        certify_and_save(runs.case.controller, plan, out, threads)
    except DiffbotError as error:
        measured = ", ".join(f"{name} {value:g}" for name, value in contract._asdict().items())
        raise DiffbotError(f"{error}; the contract, measured after {since:g} s, is {measured}") from None
    print(
        f"{100.0 * share.runs:.1f} % [{100.0 * share.low:.1f}, {100.0 * share.high:.1f}] of {_RUNS} other runs keep "
        f"the contract from {since:g} s to {_END:g} s."
    )


def run_verify(path: Path) -> int:
    """Check a certificate, then compare its ranks with random steps of the law itself.

    Raises:
        DiffbotError: naming the first claim that is not proved, or if the rank does not decrease in a step.
    """
    certificate, began = load_certificate(path), time.monotonic()
    try:
        verify(certificate)
    except DiffbotError as error:
        raise DiffbotError(f"{path}: {error}") from None
    cells = int((certificate.ranks >= 0).sum())
    print(f"{report(certificate)}\nVerified {cells} cells in {time.monotonic() - began:.0f} s.")
    if certificate.law != law_version(SwitchingLaw):
        print("The law's code has changed since the certificate was made. The certificate is verified for this code.")
    counts = sample(certificate, _RANDOM_STEPS, seed=1)
    if counts.broken:
        raise DiffbotError(
            f"{path}: the certificate is refuted: {counts.broken} runs (of {counts.steps} random steps in total) have "
            "a step in which the rank does not decrease"
        )
    print(f"The rank decreases as certified in {counts.steps} random steps.")
    return 0
