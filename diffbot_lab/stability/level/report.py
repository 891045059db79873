"""What a certificate of the level claims, in words."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from diffbot_lab.stability.level.file import LevelCertificate
from diffbot_lab.stability.level.step import levels


def leaves(tree: NDArray[np.uint8]) -> int:
    """Return the number of cells that cover the root."""
    return int((tree == 0).sum())


def _rounded_up(value: float) -> str:
    return f"{math.ceil(value * 1e4) / 1e4:.4f}"


def report(certificate: LevelCertificate) -> str:
    """Say in words what a certificate claims."""
    problem, rho_max, level, _, witness = certificate
    plant = "exact arc" if problem.exact_arc else "Euler"
    lines = [
        f"Law (13), {plant}, Ts {problem.t_s:g} s; gamma {problem.gamma:g}, k {problem.k:g}, h {problem.h:g}; noise "
        f"within eps_x {problem.eps_x:g} m, eps_y {problem.eps_y:g} m, eps_theta {problem.eps_theta:g} rad, "
        f"eps_v {problem.eps_v:g} m/s, eps_omega {problem.eps_omega:g} rad/s:",
        f"  from every state within {rho_max:g} m, V decreases in each step while V > {_rounded_up(level)};",
        f"  once V <= {_rounded_up(level)} it stays so: distance at most {_rounded_up(math.sqrt(2.0 * level))} m.",
    ]
    if witness is None:
        lines.append("  No state was found at which V does not decrease.")
    else:
        before, after = levels(witness, problem)
        lines.append(
            f"  Not below V = {math.floor(before * 1e4) / 1e4:.4f}: at rho {witness.rho:.4f} m, alpha "
            f"{witness.alpha:.4f}, beta {witness.beta:.4f} a noise raises it by {after - before:.1e} "
            f"(upper / lower = {level / before:.5f})."
        )
    return "\n".join(lines)
