"""``diffbot stability certify --law tuned`` and ``verify`` of its files."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from diffbot_control.law.configuration import ControllerConfig
from diffbot_core.errors import DiffbotError
from diffbot_core.files import output_folder
from diffbot_core.schema import build
from diffbot_lab.stability.tuned.certify import certify
from diffbot_lab.stability.tuned.contract import PLANT, Plan
from diffbot_lab.stability.tuned.file import Certificate, load_tuned, save_tuned
from diffbot_lab.stability.tuned.sample import sample
from diffbot_lab.stability.tuned.verify import verify


def run_certify(values: Mapping[str, Any], plan: Plan, out: Path, threads: int | None = None) -> int:
    """Make a certificate of the tuned law and write it to a file.

    Args:
        values: parameters of the controller that differ from the preset ``tuned``.
        plan: contract, start and cells.
        out: the file.
        threads: at a time; None: one per core.

    Raises:
        DiffbotError: for a configuration that is not covered, without a certificate, or for an unwritable file.
    """
    config, began = build(ControllerConfig, values), time.monotonic()
    with output_folder(out.parent):
        certificate = certify(config, plan, threads)
        save_tuned(out, certificate)
    print(f"{len(certificate.ranks)} cells, {time.monotonic() - began:.0f} s; not verified yet\n{out}")
    return 0


def report(certificate: Certificate) -> str:
    """Say in words what a certificate claims."""
    claims, contract = certificate.claims, certificate.plan.contract
    return (
        f"Law with braking profiles, errors within {contract.eps_position:g} m and {contract.eps_theta:g} rad, "
        f"sigma up to {contract.sigma_max:g} m:\n"
        f"  every trajectory from within {claims.start:g} m is in the core after "
        f"{claims.steps * PLANT.sampling_time:g} s ({claims.steps} steps) at most and stays;\n"
        f"  the core is within r* = {math.ceil(1e4 * claims.radius) / 1e4:.4f} m."
    )


def run_verify(path: Path, steps: int = 1_000_000, seed: int = 1) -> int:
    """Check a certificate, and compare it with ``steps`` random steps of the robot's own law.

    Raises:
        DiffbotError: naming what is not proved, or if a random step breaks a rank.
    """
    certificate, began = load_tuned(path), time.monotonic()
    try:
        verify(certificate)
    except DiffbotError as error:
        raise DiffbotError(f"{path}: {error}") from None
    cells = int((certificate.ranks >= 0).sum())
    print(f"{report(certificate)}\nVerified: {cells} cells, {time.monotonic() - began:.0f} s.")
    broken = sample(certificate, steps, seed).broken
    if broken:
        raise DiffbotError(f"{path}: refuted, {broken} of {steps} random steps break a rank")
    print(f"{steps} random steps keep to the ranks.")
    return 0
