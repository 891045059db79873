"""``diffbot stability certify`` and ``verify``: make a certificate, also of a robot's own contract, and check it."""

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
from diffbot_lab.stability.contract import KeptShare, farthest_start, fitted, kept, observe, runs_of_robot, share_of
from diffbot_lab.stability.file import Certificate, load_certificate, save_certificate
from diffbot_lab.stability.maker import certify
from diffbot_lab.stability.plan import SLOPES, Contract, Plan
from diffbot_lab.stability.runs import sample
from diffbot_sim.jit import law_version
from diffbot_tools.robot import read_robot

_RUNS = 200
"""runs that bounds are fitted to, and as many others that show how often the bounds are kept"""
_SEED = 9017
_END = 45.0
"""[s] end of the part of a run that counts; later the robots stand at their goals"""


def report(certificate: Certificate) -> str:
    """Return the claims of a certificate in words."""
    claims, plan = certificate.claims, certificate.plan
    contract, steps = plan.contract, claims.steps
    position, theta, sigma = (getattr(contract, name) for name in SLOPES)
    slopes = f"  each plus {position:g} m, {theta:g} rad and {sigma:g} m per metre from the goal,\n"
    base = f"{contract.eps_v:g} m/s and {contract.eps_omega:g} rad/s"
    return (
        f"Law {SwitchingLaw.name}, a pose each {plan.period:g} s. As long as\n"
        f"  the estimate is within {contract.eps_position:g} m and {contract.eps_theta:g} rad,\n"
        f"  its standard deviation at most {contract.sigma_max:g} m,\n"
        f"{slopes if max(position, theta, sigma) > 0.0 else ''}"
        f"  the wheels off by at most {100.0 * contract.wheel_error:g} %,\n"
        f"  and the base at most {base} off what is requested,\n"
        f"every trajectory from within {claims.start:g} m is in the core after "
        f"{steps * plan.period:g} s ({steps} steps) at most and stays;\n"
        f"the core is within r* = {math.ceil(1e4 * claims.radius) / 1e4:.4f} m."
    )


def certify_and_save(config: SwitchingConfig, plan: Plan, out: Path, threads: int | None = None) -> Certificate:
    """Make a certificate of the default law, write it to a file, and print its claims.

    Args:
        config: of the controller.
        plan: contract, period, start and cells.
        out: the file.
        threads: None: one per core.

    Raises:
        DiffbotError: if the configuration is not covered, no certificate is found, or the file cannot be written.
    """
    began = time.monotonic()
    with output_folder(out.parent):
        certificate = certify(config, plan, threads)
        save_certificate(out, certificate)
    cells = f"{len(certificate.ranks)} cells, {time.monotonic() - began:.0f} s"
    print(f"{report(certificate)}\n{cells}; not verified yet: diffbot stability verify {out}")
    return certificate


def certify_robot(
    name: str, bounds: Mapping[str, float], since: float, cells: Mapping[str, Any], out: Path, threads: int | None
) -> tuple[Certificate, KeptShare]:
    """Measure the bounds that are not given, certify, and print how often the contract is kept in other runs.

    Args:
        name: parameter file or preset.
        bounds: of the contract, by their names.
        since: [s] the contract is measured from then on in runs that start at rest.
        cells: ``margin`` and ``fineness`` of the plan, if they are given.
        out: file of the certificate.
        threads: None: one per core.

    Returns:
        The certificate, and the share of the other runs that keep the contract.

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
        found = fitted(observe(runs, contract, _SEED, bar)[:, part], contract, 1.0)
        unbounded = [one for one, value in found.items() if not value < 1.0 and one not in bounds]
        if unbounded:
            raise DiffbotError(
                f"no contract: {', '.join(unbounded)} has no bound from {since:g} s on; take a later --since"
            )
        contract = Contract(**{**contract._asdict(), **found, **bounds})
        others = observe(runs_of_robot(robot, _RUNS, _SEED + 1), contract, _SEED + 1, bar)
    share = share_of(kept(others[:, part], contract))
    plan = Plan(contract, t_s, farthest_start(robot), **cells)
    try:
        certificate = certify_and_save(runs.case.controller, plan, out, threads)
    except DiffbotError as error:
        measured = ", ".join(f"{name} {value:g}" for name, value in contract._asdict().items())
        raise DiffbotError(f"{error}; contract from {since:g} s on: {measured}") from None
    print(
        f"In {100.0 * share.runs:.1f} % [{100.0 * share.low:.1f}, {100.0 * share.high:.1f}] of {_RUNS} other runs the "
        f"contract is kept from {since:g} s to {_END:g} s."
    )
    return certificate, share


def run_verify(path: Path, steps: int = 1_000_000, seed: int = 1) -> int:
    """Check a certificate, and compare it with ``steps`` steps of the robot's own law from drawn memories.

    Raises:
        DiffbotError: naming the first thing that is not proved, or if a step breaks a rank.
    """
    certificate, began = load_certificate(path), time.monotonic()
    try:
        verify(certificate)
    except DiffbotError as error:
        raise DiffbotError(f"{path}: {error}") from None
    cells = int((certificate.ranks >= 0).sum())
    print(f"{report(certificate)}\nVerified: {cells} cells, {time.monotonic() - began:.0f} s.")
    if certificate.law != law_version(SwitchingLaw):
        print("The law's code has changed since the certificate was made; it is verified for the law of today.")
    found = sample(certificate, steps, seed)
    if found.broken:
        raise DiffbotError(f"{path}: refuted, {found.broken} runs in {found.steps} random steps break a rank")
    print(f"{found.steps} random steps keep to the ranks.")
    return 0
