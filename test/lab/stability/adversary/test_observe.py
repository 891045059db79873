"""Random runs respect a certificate, and a wrong one is noticed."""

import math

import numpy as np
from certificates import LAW_17, coarse_certificate

from diffbot_lab.stability.adversary import observe
from diffbot_lab.stability.adversary.observe import rank_of


def test_ranks_of_poses():
    certificate = coarse_certificate(LAW_17)
    ranks = certificate.ranks.copy()
    ranks[:] = np.arange(80)
    certificate = certificate._replace(ranks=ranks)
    # The goal 1 m ahead, on the left, behind; inside; beyond.
    poses = np.array([(-1, 0, -0.01), (-1, 0, -math.pi / 2 - 0.01), (1, 0, 0.01), (0.1, 0, 0), (9, 0, 0)], float)
    assert rank_of(certificate, poses).tolist() == [40, 60, 79, 0, -1]


def test_random_runs_respect_a_certificate_and_a_wrong_one_is_noticed(monkeypatch):
    monkeypatch.setattr(observe, "_STATES_AT_A_TIME", 20_000)
    good = coarse_certificate(LAW_17)
    found = observe.observe(good, 30_000, 500, 1)
    assert found.steps_from_core >= 30_000
    assert (found.left_core, found.late, found.trajectories) == (0, 0, 500)
    assert 3 < found.longest <= good.claims.steps
    assert 0.0 < found.farthest < good.claims.radius
    assert found.cloud.shape[1] == 3
    assert len(found.cloud) > 1000
    small_core = good.ranks.copy()
    small_core[:, 10:] = -1
    assert observe.observe(good._replace(ranks=small_core), 20_000, 1, 1).left_core > 0
    small_ranks = np.where(good.ranks > 0, (good.ranks + 3) // 4, good.ranks).astype(np.int16)
    assert observe.observe(good._replace(ranks=small_ranks), 1, 300, 1).late > 0
