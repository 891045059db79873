"""Figure of a certificate: the certified core, the adversary's trajectory and the observed states, and the times."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from diffbot_lab.plotting import BLUE, GREY, ORANGE, RED, new_figure, save
from diffbot_lab.stability.paper.file import Certificate

Array = NDArray[np.float64]


def alpha_of(poses: Array) -> Array:
    """Return the goal's bearing [rad] in the frame of robots at poses (n, 3), wrapped."""
    alpha = np.arctan2(-poses[:, 1], -poses[:, 0]) - poses[:, 2]
    return np.asarray(alpha - 2.0 * math.pi * np.round(alpha / (2.0 * math.pi)))


def draw_near_field(certificate: Certificate, attack: Array, cloud: Array, path: Path) -> None:
    """Draw both panels.

    Args:
        certificate: whose core and ranks are shown.
        attack: (n, 3) poses of the adversary's trajectory.
        cloud: (m, 3) observed poses.
        path: of the PNG.

    Raises:
        OSError: if the file cannot be written.
    """
    figure, (near, far) = new_figure(2, (7.5, 8.0), sharex=False)
    rho, alpha, ranks, loop, claims = (*certificate[1:4], certificate.loop, certificate.claims)
    outer = np.where(ranks == 0, rho[1:, None], rho[0]).max(axis=0)
    near.stairs(outer, alpha, color=BLUE, label=f"certified: within {claims.radius:.2f} m", baseline=None)
    near.plot(alpha_of(cloud), np.hypot(cloud[:, 0], cloud[:, 1]), ",", color=GREY, rasterized=True)
    near.plot([], [], "s", color=GREY, label="observed, random noise")
    distance = np.hypot(attack[:, 0], attack[:, 1])
    near.plot(alpha_of(attack), distance, ".", markersize=3, color=RED, label="adversary")
    near.set_xlabel("alpha [rad]")
    near.set_ylabel("rho [m]")
    near.set_ylim(0.0, None)
    near.legend(fontsize="small")
    middle = 0.5 * (rho[:-1] + rho[1:])
    shown = middle <= claims.start
    times = loop.t_s * ranks[shown]
    far.plot(middle[shown], times.max(axis=1), color=BLUE, label="the worst heading")
    far.plot(middle[shown], times.min(axis=1), color=ORANGE, label="the best heading")
    far.set_xlabel("rho [m]")
    far.set_ylabel("certified time to the core [s]")
    far.legend(fontsize="small")
    save(figure, path)
