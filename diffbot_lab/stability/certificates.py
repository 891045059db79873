"""``diffbot stability certify`` and ``verify``: what they do and say."""

from __future__ import annotations

import math
import time
from pathlib import Path

from diffbot_control.law.configuration import ControllerConfig
from diffbot_control.law.controller import SwitchingLaw
from diffbot_core.errors import DiffbotError
from diffbot_core.files import output_folder
from diffbot_lab.stability.check.verify import verify
from diffbot_lab.stability.file import Certificate, load_certificate, save_certificate
from diffbot_lab.stability.maker.certify import certify
from diffbot_lab.stability.plan import SLOPES, Contract, Plan
from diffbot_lab.stability.runs import sample
from diffbot_sim.compiled.jit import law_version


def certify_and_save(config: ControllerConfig, plan: Plan, out: Path, threads: int | None = None) -> Certificate:
    """Make a certificate of the default law, write it to a file, and say what it claims.

    Args:
        config: of the controller.
        plan: contract, period, start and cells.
        out: the file.
        threads: at a time; None: one per core.

    Raises:
        DiffbotError: for a configuration that is not covered, without a certificate, or for an unwritable file.
    """
    began = time.monotonic()
    with output_folder(out.parent):
        certificate = certify(config, plan, threads)
        save_certificate(out, certificate)
    cells = f"{len(certificate.ranks)} cells, {time.monotonic() - began:.0f} s"
    print(f"{report(certificate)}\n{cells}; not verified yet: diffbot stability verify {out}")
    return certificate


def steps_to_core(certificate: Certificate) -> int:
    """Return the most steps to the core, with those that an Omega_L entered before the contract held may still last."""
    return certificate.claims.steps + certificate.config.region_policy.covariance.eps_P_leave_steps


def report(certificate: Certificate) -> str:
    """Say in words what a certificate claims."""
    claims, plan = certificate.claims, certificate.plan
    contract, steps = plan.contract, steps_to_core(certificate)
    base = f"{contract.eps_v:g} m/s and {contract.eps_omega:g} rad/s"
    return (
        f"Law with braking profiles, a pose each {plan.period:g} s. As long as\n"
        f"  the estimate is within {contract.eps_position:g} m and {contract.eps_theta:g} rad,\n"
        f"  its standard deviation at most {contract.sigma_max:g} m,\n"
        f"{_slopes(contract)}"
        f"  the wheels off by at most {100.0 * contract.wheel_error:g} %,\n"
        f"  and the base at most {base} off what is requested,\n"
        f"every trajectory from within {claims.start:g} m without a leg of the finish is in the core after "
        f"{steps * plan.period:g} s ({steps} steps) at most and stays;\n"
        f"the core is within r* = {math.ceil(1e4 * claims.radius) / 1e4:.4f} m."
    )


def _slopes(contract: Contract) -> str:
    """Say how the bounds grow, in a line; empty if they do not."""
    if not any(getattr(contract, name) > 0.0 for name in SLOPES):
        return ""
    position, theta, sigma = (getattr(contract, name) for name in SLOPES)
    return f"  each plus {position:g} m, {theta:g} rad and {sigma:g} m per metre from the goal,\n"


def run_verify(path: Path, steps: int = 1_000_000, seed: int = 1) -> int:
    """Check a certificate, and compare it with ``steps`` steps of the robot's own law from drawn memories.

    Raises:
        DiffbotError: naming what is not proved, or if a step breaks a rank.
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
