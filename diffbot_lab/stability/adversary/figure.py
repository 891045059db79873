"""Figure of a certificate: the certified core, the adversary's trajectory and the observed states, and the times."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_lab.stability.file import Certificate, first_cells
from diffbot_tools.plotting import BLUE, GREY, ORANGE, RED, new_figure, save

Array = NDArray[np.float64]


def alpha_of(poses: Array) -> Array:
    """Return the goal's bearing [rad] in the frame of robots at poses (n, 3), wrapped."""
    alpha = np.arctan2(-poses[:, 1], -poses[:, 0]) - poses[:, 2]
    return np.asarray(alpha - 2.0 * math.pi * np.round(alpha / (2.0 * math.pi)))


class NearField(NamedTuple):
    """What is drawn of a certificate."""

    radius: float
    """[m] r*"""
    alpha: Array
    """(columns + 1,) edges [rad]"""
    outer: Array
    """(columns,) the core's farthest distance [m] with these alpha"""
    rho: Array
    """(rows,) distances [m] ..."""
    slowest: Array
    """... and the certified times [s] to the core from there, with the worst heading ..."""
    fastest: Array
    """... and with the best one"""


def field_of(certificate: Certificate) -> NearField:
    """Return what is drawn of a certificate; its alpha is that of the end that leads."""
    rho, claims, t_s = certificate.rho, certificate.claims, certificate.plan.period
    first = first_cells(certificate.alphas, certificate.betas)
    columns = int(certificate.alphas[0])
    half = np.full(columns // 2, rho[0])
    slowest, fastest = [], []
    for row, (alphas, betas) in enumerate(zip(certificate.alphas, certificate.betas, strict=True)):
        ranks = certificate.ranks[first[row] : first[row + 1]].reshape(alphas // 2, betas)
        slowest.append(ranks.max())
        fastest.append(ranks.min())
        core = np.flatnonzero((ranks == 0).any(axis=1))
        for column in core:
            low, high = column * columns // alphas, -(-(column + 1) * columns // alphas)
            half[low:high] = rho[row + 1]
    outer = np.concatenate((half[::-1], half))
    middle = 0.5 * (rho[:-1] + rho[1:])
    shown = middle <= claims.start
    alpha = np.linspace(-math.pi, math.pi, columns + 1)
    return NearField(
        claims.radius, alpha, outer, middle[shown], t_s * np.array(slowest)[shown], t_s * np.array(fastest)[shown]
    )


def draw_near_field(field: NearField, attack: Array, cloud: Array, path: Path) -> None:
    """Draw both panels.

    Args:
        field: the certificate's core and times.
        attack: (n, 3) poses of the adversary's trajectory.
        cloud: (m, 3) observed poses.
        path: of the PNG.

    Raises:
        OSError: if the file cannot be written.
    """
    figure, (near, far) = new_figure(2, (7.5, 8.0), sharex=False)
    near.stairs(field.outer, field.alpha, color=BLUE, label=f"certified: within {field.radius:.2f} m", baseline=None)
    near.plot(alpha_of(cloud), np.hypot(cloud[:, 0], cloud[:, 1]), ",", color=GREY, rasterized=True)
    near.plot([], [], "s", color=GREY, label="observed, random noise")
    distance = np.hypot(attack[:, 0], attack[:, 1])
    near.plot(alpha_of(attack), distance, ".", markersize=3, color=RED, label="adversary")
    near.set_xlabel("alpha [rad]")
    near.set_ylabel("rho [m]")
    near.set_ylim(0.0, None)
    near.legend(fontsize="small")
    far.plot(field.rho, field.slowest, color=BLUE, label="the worst heading")
    far.plot(field.rho, field.fastest, color=ORANGE, label="the best heading")
    far.set_xlabel("rho [m]")
    far.set_ylabel("certified time to the core [s]")
    far.legend(fontsize="small")
    save(figure, path)
