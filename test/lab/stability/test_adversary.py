"""Adversaries and random runs stay within the certified bounds."""

import numpy as np
import pytest
from tuned_steps import CONFIG

from diffbot_lab.stability.adversary import STEPS, WARM_UP, WINDOW, drift_of, recurrent_distance, search
from diffbot_lab.stability.checker_bounds import checker_loop, local_reach
from diffbot_lab.stability.plan import Contract, Plan, ideal_law
from diffbot_lab.stability.runs import ContractLoop, drive, loop_of


def test_a_drift_comes_near_the_bound_of_omega_l_but_not_beyond():
    law = ideal_law(CONFIG, Plan())
    bound = local_reach(checker_loop(law, Plan()))
    farthest = drift_of(ContractLoop(law, Contract(), 0.1))
    assert farthest == pytest.approx(0.136369, abs=1e-6)
    assert 0.7 * bound < farthest < bound


def test_ranks_fall_in_random_runs_from_all_starts(certificate):
    steps = certificate.claims.steps
    runs, ends = drive(certificate, 300, certificate.claims.start, steps + 20, 3, any_memory=False)
    assert (runs.left_core, runs.broken) == (0, 0)
    assert 0 < runs.longest <= steps
    assert 0.0 < np.hypot(ends[:, 0], ends[:, 1]).max() < 0.2


def test_the_recurrent_distance_is_reached_in_every_window():
    path = np.zeros((STEPS, 3))
    path[: WARM_UP - 1, 0] = 9.0
    path[WARM_UP::WINDOW, 1] = 0.5
    path[WARM_UP + WINDOW, 1] = -3.0
    assert recurrent_distance(path) == 0.5
    path[-1, 0] = 7.0
    path[WARM_UP + 2 * WINDOW] = 0.0
    assert recurrent_distance(path) == 0.0


def test_the_search_improves_and_stays_within_the_certified_radius(certificate):
    distances = []
    attack = search(loop_of(certificate), 1, generations=3, population=6, each=distances.append)
    assert distances == sorted(distances)
    assert distances[-1] == attack.distance
    assert 0.03 < attack.distance < certificate.claims.radius
