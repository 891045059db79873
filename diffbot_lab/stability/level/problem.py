"""What a level is claimed for, law (13) with bounded noise, and what shows that a lower one would be too low."""

from __future__ import annotations

from typing import NamedTuple


class LevelProblem(NamedTuple):
    """The loop: law (13), plant and bounds of the noise, as floats that stand for themselves."""

    gamma: float
    k: float
    h: float
    t_s: float
    """[s]"""
    eps_x: float
    """[m]"""
    eps_y: float
    """[m]"""
    eps_theta: float
    """[rad]"""
    eps_v: float
    """[m/s]"""
    eps_omega: float
    """[rad/s]"""
    exact_arc: bool
    """or Euler"""


class Witness(NamedTuple):
    """A state, rho [m], alpha and beta [rad], and the noise of one step."""

    rho: float
    alpha: float
    beta: float
    eps_x: float
    eps_y: float
    eps_theta: float
    eps_v: float
    eps_omega: float
