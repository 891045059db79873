"""At a point of the grid no admissible noise lifts V by more than the picture says."""

import math

import numpy as np
import pytest

from diffbot_control.law.lyapunov_law import PAPER_GAINS
from diffbot_lab.stability.picture.grid import Grid, worst_rate
from diffbot_lab.stability.settings import NoiseBox


def wrapped(angles):
    return math.pi - np.remainder(math.pi - np.asarray(angles), 2.0 * math.pi)


def textbook_rate(state, noise, gains, t_s):
    """Change of V of Eq. (8) in one step of (6), (7) under law (13), over Ts, with a measured pose that is wrong."""
    rho, alpha, beta = state
    eps_x, eps_y, eps_theta, eps_v, eps_omega = noise
    x, y, theta = -rho * np.cos(beta) + eps_x, -rho * np.sin(beta) + eps_y, beta - alpha + eps_theta
    seen_rho, bearing = np.hypot(x, y), wrapped(np.arctan2(0.0 - y, 0.0 - x))
    seen_alpha = wrapped(bearing - theta)
    v = gains.gamma * np.tanh(seen_rho) * np.cos(seen_alpha)
    slope = np.where(seen_rho > 1e-9, np.tanh(seen_rho) / np.maximum(seen_rho, 1e-9), 1.0)
    turn = gains.gamma * np.sinc(seen_alpha / math.pi) * slope * np.cos(seen_alpha)
    omega = gains.k * seen_alpha + turn * (seen_alpha + gains.h * bearing)
    v, omega = v + eps_v, omega + eps_omega
    after = (
        rho - v * t_s * np.cos(alpha),
        wrapped(alpha + v * t_s * np.sin(alpha) / rho - omega * t_s),
        wrapped(beta + v * t_s * np.sin(alpha) / rho),
    )
    before, then = (0.5 * (r**2 + a**2 + gains.h * b**2) for r, a, b in (state, after))
    return (then - before) / t_s


@pytest.mark.parametrize("box", [NoiseBox(0.3, 0.3, 0.17, 0.065, 0.2167), NoiseBox(3.0, 1.0, 2.0, 1.0, 4.0)])
def test_no_admissible_noise_does_worse(box):
    rng, number = np.random.default_rng(1), 4000
    rho = np.exp(rng.uniform(math.log(1e-3), math.log(20.0), number))
    state = (rho, *rng.uniform(-math.pi, math.pi, (2, number)))
    noise = np.concatenate([rng.uniform(-1.0, 1.0, (5, 30, number)), rng.choice([-1.0, 1.0], (5, 30, number))], axis=1)
    rates = textbook_rate(state, noise * np.array(box)[:, None, None], PAPER_GAINS, 0.1).max(axis=0)
    bound = worst_rate(Grid(*state), PAPER_GAINS, box, 0.1)
    assert (rates <= bound + 1e-11 * (100.0 + rho**2)).all()
    assert (rates > 0.0).any()
