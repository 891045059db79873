"""``diffbot stability certify`` and ``verify``: guaranteed bounds of the paper's loop near the goal."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from diffbot_control.law.presets import PAPER
from diffbot_core.errors import DiffbotError
from diffbot_core.files import output_folder
from diffbot_lab.cases import configure
from diffbot_lab.stability.paper.certify import Resolution, certify
from diffbot_lab.stability.paper.file import (
    EULER,
    EXACT_ARC,
    Certificate,
    Loop,
    load_certificate,
    save_certificate,
)
from diffbot_lab.stability.paper.verify import verify
from diffbot_lab.stability.settings import PAPER_NOISE, noise_box, refuse_others

LAWS = ("13", "17")
KNOWN = (
    *("gamma", "k", "h", "k_2", "eps_P", "eps_P_leave", "sampling_time", "exact_arc"),
    *("eps_x_max", "eps_y_max", "eps_theta_max", "eps_v_max", "eps_omega_max"),
)
"""Parameters that a certificate covers."""


def loop_of(law: str, values: Mapping[str, Any]) -> Loop:
    """Return the paper's loop with other parameter values out of KNOWN.

    Law (17) has no hysteresis in the paper: without ``eps_P_leave`` it is ``eps_P``.

    Raises:
        InvalidValueError: for an unknown name or a value that is not allowed.
    """
    refuse_others(values, KNOWN, "the certificate")
    radius = values.get("eps_P", 0.5)
    if law == "13":
        values = {**values, "eps_P": 0.0}
    plant, sensors, controller, _ = configure({"preset": PAPER, **PAPER_NOISE, "eps_P_leave": radius, **values})
    box, fixed, gains = noise_box(plant, sensors, controller), controller.region_policy.fixed, controller.gains
    region = (0.0, 0.0) if law == "13" else (fixed.eps_P, fixed.eps_P_leave)
    bounds = (*box, plant.sampling_time)
    return Loop._make((*gains, *region, *bounds, EXACT_ARC if plant.exact_arc else EULER))


def run_certify(loop: Loop, start: float, resolution: Resolution, out: Path, threads: int | None = None) -> int:
    """Make a certificate and write it to the file ``out``.

    Raises:
        DiffbotError: if there is none with these cells, or the file cannot be written.
    """
    with output_folder(out.parent):
        certificate, notes = certify(loop, start, resolution, threads)
        save_certificate(out, certificate, notes)
    print(f"{notes['cells']} cells, {notes['seconds']:.0f} s")
    print(report(certificate))
    print(out)
    return 0


def report(certificate: Certificate) -> str:
    """Say in words what a certificate claims."""
    loop, claims = certificate.loop, certificate.claims
    law = f"(17), eps_P {loop.eps_P:g} m, eps_P_leave {loop.eps_P_leave:g} m" if loop.eps_P_leave > 0.0 else "(13)"
    return (
        f"Law {law}, {loop.plant}, Ts {loop.t_s:g} s; noise within eps_x {loop.eps_x:g} m, eps_y {loop.eps_y:g} m, "
        f"eps_theta {loop.eps_theta:g} rad, eps_v {loop.eps_v:g} m/s, eps_omega {loop.eps_omega:g} rad/s:\n"
        f"  every trajectory from within {claims.start:g} m is in the core after {claims.steps * loop.t_s:g} s "
        f"({claims.steps} steps) at most and stays;\n"
        f"  the core is within r* = {math.ceil(1e4 * claims.radius) / 1e4:.4f} m."
    )


def run_verify(path: Path, threads: int | None = None) -> int:
    """Check the certificate in a file again.

    Raises:
        DiffbotError: naming what is not proved.
    """
    certificate = load_certificate(path)
    began = time.monotonic()
    try:
        verify(certificate, threads)
    except DiffbotError as error:
        raise DiffbotError(f"{path}: {error}") from None
    print(report(certificate))
    print(f"Verified: {int((certificate.ranks >= 0).sum())} cells, {time.monotonic() - began:.0f} s.")
    return 0
