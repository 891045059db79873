"""No simulated step lifts V by more than the bound of a cell that holds it; in small cells the bound is the step."""

import math

import numpy as np
import pytest
from level_steps import PAPER, PROBLEMS, random_choice, sides_around

from diffbot_lab.stability.interval.compiled import compile_bounds
from diffbot_lab.stability.level import bounds
from diffbot_lab.stability.level.bounds import Cell, rise
from diffbot_lab.stability.level.problem import Witness
from diffbot_lab.stability.level.step import levels
from diffbot_lab.stability.level.witness import witness_at


def excesses(number, rng, problem, largest, out):
    """Simulated rise of V less its bound, for random states and noises in random cells."""
    choice = np.zeros(7)
    for i in range(number):
        random_choice(rng, choice)
        step = witness_at(choice, 12.0 * rng.random() ** 2, problem)
        before, after = levels(step, problem)
        cell = Cell(*sides_around(rng, step, problem, largest))
        out[i] = after - before - rise(cell, problem, before * (2.0 * rng.random() - 1.0))


@pytest.mark.parametrize("name", PROBLEMS)
def test_no_step_breaks_the_bound(name):
    out = np.full(300_000, np.nan)
    compile_bounds(excesses)(len(out), np.random.default_rng(1), PROBLEMS[name], 3.0, out)
    assert out.max() <= 1e-10  # rounding of the simulation
    assert np.isfinite(out).all()


def test_a_wrong_sign_in_the_bound_would_be_found(monkeypatch):
    right = bounds.motion

    def wrong(*arguments):
        u0, u1, w0, w1 = right(*arguments)
        return u0, u1, -w1, -w0

    out = np.zeros(500)
    monkeypatch.setattr(bounds, "motion", wrong)
    excesses(len(out), np.random.default_rng(1), PAPER, 0.1, out)
    assert (out > 1e-3).mean() > 0.1


@pytest.mark.parametrize("exact_arc", [False, True])
def test_without_noise_a_point_is_the_step(exact_arc):
    problem = PROBLEMS["no noise"]._replace(exact_arc=exact_arc)
    rng = np.random.default_rng(2)
    for _ in range(300):
        rho, alpha, beta = rng.uniform(0.5, 10.0), rng.uniform(-3.0, 3.0), rng.uniform(0.0, 3.0)
        cell = Cell(rho, rho, alpha, alpha, beta, beta, alpha - 1e-12, alpha + 1e-12, 0.0, 0.0, 0.0, 0.0)
        before, after = levels(Witness(rho, alpha, beta, 0.0, 0.0, 0.0, 0.0, 0.0), problem)
        assert rise(cell, problem, -1.0) == pytest.approx(after - before, abs=1e-9)


@pytest.mark.parametrize("exact_arc", [False, True])
def test_the_simulated_step_is_the_textbook_one(exact_arc):
    rng = np.random.default_rng(3)
    problem = PAPER._replace(exact_arc=exact_arc)
    for _ in range(200):
        noise = rng.uniform(-1.0, 1.0, 5) * [0.3, 0.3, 0.17, 0.065, 0.2167]
        rho, alpha, beta = rng.uniform(0.6, 10.0), rng.uniform(-3.0, 3.0), rng.uniform(-3.0, 3.0)
        x, y, theta = -rho * math.cos(beta), -rho * math.sin(beta), beta - alpha
        mx, my, mt = x + noise[0], y + noise[1], theta + noise[2]
        b = math.atan2(-my, -mx)
        r, a = math.hypot(mx, my), math.remainder(b - mt, 2.0 * math.pi)
        v = 1.3 * math.tanh(r) * math.cos(a) + noise[3]
        omega = a + 1.3 * math.sin(a) / a * math.tanh(r) / r * math.cos(a) * (a + 0.17 * b) + noise[4]
        if exact_arc:
            radius = v / omega
            x += radius * (math.sin(theta + 0.1 * omega) - math.sin(theta))
            y -= radius * (math.cos(theta + 0.1 * omega) - math.cos(theta))
        else:
            x, y = x + 0.1 * v * math.cos(theta), y + 0.1 * v * math.sin(theta)
        b = math.atan2(-y, -x)
        a = math.remainder(b - theta - 0.1 * omega, 2.0 * math.pi)
        expected = (0.5 * (rho**2 + alpha**2 + 0.17 * beta**2), 0.5 * (x * x + y * y + a * a + 0.17 * b * b))
        assert levels(Witness(rho, alpha, beta, *noise), problem) == pytest.approx(expected, abs=1e-9)


def test_a_cell_that_no_noise_can_measure_is_left_out():
    near = Cell(5.0, 5.1, 1.0, 1.1, 0.0, 0.1, 1.36, 1.4, 0.0, 0.0, 0.0, 0.0)
    assert rise(near, PAPER, -1.0) == -math.inf
    assert rise(near._replace(measured0=1.3), PAPER, -1.0) > -math.inf
    assert rise(near._replace(measured0=1.3), PAPER, 15.0) == -math.inf  # V <= 13.9 in the whole cell
