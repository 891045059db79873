"""The library's own step from drawn memories against a certificate, and what its statement leaves out."""

import math

import numpy as np

from diffbot_control.law.configuration import ControllerConfig, new_memory
from diffbot_control.law.finish import V_LEG, Finish
from diffbot_control.law.regions import OMEGA_G, OMEGA_L, Switching
from diffbot_core.geometry import Pose
from diffbot_lab.stability.plan import Contract
from diffbot_lab.stability.runs import ContractLoop, memory_at, next_pose, sample

LOOP = ContractLoop(ControllerConfig(), Contract(), 0.1)
CERTIFIED = 0.57
"""[m] r* of the default law under the default contract"""


def test_a_leg_that_was_begun_before_the_contract_held_leaves_the_certified_core():
    """So the statement is about states without one: the estimate is exact here, in every step."""
    leg = Finish(V_LEG, -1.0, 1.0, 2, 0.0)
    pose = Pose(0.0, 0.1, 0.0)
    memory = new_memory()._replace(switching=Switching(OMEGA_L, 1, 0), finish=leg)
    farthest = 0.0
    for _ in range(100):
        pose, memory = next_pose(LOOP, pose, memory, 0.01, (0.0,) * 8)
        farthest = max(farthest, math.hypot(pose.x, pose.y))
    assert farthest > 1.5 * CERTIFIED


def test_random_steps_from_drawn_memories_keep_to_the_ranks_and_find_wrong_ones(certificate):
    found = sample(certificate, 40_000, 5)
    assert (found.left_core, found.broken) == (0, 0)
    assert found.steps > 30_000
    assert found.from_core > 10_000
    short = np.where(certificate.ranks > 3, 3, certificate.ranks).astype(np.int16)
    assert sample(certificate._replace(ranks=short), 40_000, 5).broken > 0


def test_memories_are_drawn_in_all_states_of_the_law_but_legs_only_where_they_begin():
    rng = np.random.default_rng(1)
    near = [memory_at(LOOP, 0.05, 0.1, 0.25, rng) for _ in range(300)]
    far = [memory_at(LOOP, 0.4, 0.1, 0.25, rng) for _ in range(300)]
    assert {one.switching.region for one in near} == {one.switching.region for one in far} == {OMEGA_G, OMEGA_L}
    assert {one.finish.kind for one in near} == {0, 1, 2}
    assert {one.finish.kind for one in far} == {0}
    assert {one.switching.steps_outside for one in far} == {0, 1, 2}
    assert max(one.finish.reach for one in near) <= 0.25
    assert {one.course.leading for one in near} == {-1, 1}
    assert {one.reached for one in near} == {False, True}
