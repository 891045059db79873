"""Loops for certificates, one with few cells, and random steps of the project's own law and plant."""

import functools
import math

import numpy as np

from diffbot_control.law.lyapunov_law import Gains, global_law, local_law
from diffbot_control.law.polar_coordinates import navigation_variables
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_lab.stability.paper.certify import Resolution, certify
from diffbot_lab.stability.paper.file import EULER, EXACT_ARC, Loop
from diffbot_lab.stability.rank.cells import Cell
from diffbot_sim.model.plant import integrate

LAW_13 = Loop(1.3, 1.5, 0.17, 2.0, 0.0, 0.0, 0.05, 0.05, 0.05, 0.02, 0.05, 0.2, EULER)
LAW_17 = LAW_13._replace(eps_P=0.35, eps_P_leave=0.4)
PAPER_13 = Loop(1.3, 1.0, 0.17, 2.7, 0.0, 0.0, 0.3, 0.3, 0.17, 0.065, 0.2167, 0.1, EULER)
PAPER_17 = PAPER_13._replace(eps_P=0.5, eps_P_leave=0.5)
COARSE = Resolution(width=0.05, columns=80, growth=0.0, slice_width=0.1, fine_to=9.0)
START = 2.0
# Near, where Omega_L may be in force; at the cut; sideways; far.
CELLS = [
    Cell(0.62, 0.63, 0.5, 0.51),
    Cell(0.75, 0.76, 3.13, math.pi),
    Cell(0.9, 0.92, -1.6, -1.58),
    Cell(1.5, 1.52, -0.01, 0.01),
    Cell(11.0, 11.03, -math.pi, -3.13),
]


@functools.cache
def coarse_certificate(loop):
    """Return the certificate of such a loop."""
    return certify(loop, START, COARSE, threads=1)[0]


def noises(rng, number):
    """Shares of the noise bounds, half of them corners."""
    inside = rng.uniform(-1.0, 1.0, (number, 5))
    return np.where(rng.random((number, 1)) < 0.5, inside, np.sign(inside))


def step(loop, pose, noise, local_to):
    """One step of the law with Omega_L in force within ``local_to`` of the measured goal."""
    seen = Pose(
        pose.x + noise[0] * loop.eps_x,
        pose.y + noise[1] * loop.eps_y,
        wrap_angle(pose.theta + noise[2] * loop.eps_theta),
    )
    navigation, gains = navigation_variables(seen), Gains(loop.gamma, loop.k, loop.h, loop.k_2)
    local = navigation.rho < local_to
    command = local_law(navigation, seen.theta, gains) if local else global_law(navigation, gains)
    twist = Twist(command.v + noise[3] * loop.eps_v, command.omega + noise[4] * loop.eps_omega)
    return integrate(pose, twist, loop.t_s, loop.plant == EXACT_ARC)


def steps_from(loop, cell, number, rng):
    """Random states of a cell with any beta and noise; return rho and alpha after a step."""
    found = np.empty((number, 2))
    for index, noise in enumerate(noises(rng, number)):
        rho, alpha = rng.uniform(cell.rho_low, cell.rho_high), rng.uniform(cell.alpha_low, cell.alpha_high)
        beta = rng.uniform(-math.pi, math.pi)
        pose = Pose(-rho * math.cos(beta), -rho * math.sin(beta), wrap_angle(beta - alpha))
        after = navigation_variables(step(loop, pose, noise, rng.choice([loop.eps_P, loop.eps_P_leave])))
        found[index] = after.rho, after.alpha
    return found


def assert_held(steps, rho_low, rho_high, alpha_low, alpha_high):
    """Check that each (rho, alpha), or alpha a full turn away, is in one of the boxes (n,)."""
    rho, alpha = steps.T[:, :, None]
    held = np.zeros(len(steps), bool)
    for angle in (alpha - 2.0 * math.pi, alpha, alpha + 2.0 * math.pi):
        held |= ((rho_low <= rho) & (rho <= rho_high) & (alpha_low <= angle) & (angle <= alpha_high)).any(axis=1)
    assert held.all()
