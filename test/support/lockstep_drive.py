"""Driving in lock-step and comparing the path with the ROS-free closed loop."""

import numpy as np
from robot import planar, stamp, turned

from diffbot_control.law.registry import PRESETS
from diffbot_core.geometry import Pose
from diffbot_core.schema import build
from diffbot_sim.config import WorldConfig
from diffbot_sim.simulation import simulate

STEPS = 120
START = 1000 * 10**9
PERIOD = 100_000_000


def true_path(messages, start=START):
    """Return the true poses by step."""
    return {(stamp(message) - start) // PERIOD: planar(message.pose.pose) for message in messages}


def go(robot, goal, steps=STEPS):
    """Drive from standstill with a goal that is known before the first step; return the true poses by step."""
    robot.send_goal(*goal)
    first = robot.truths[-1] if robot.truths else None
    robot.truths.clear()
    start = START if first is None else stamp(first) + PERIOD
    robot.pause(False)
    robot.peer.spin_until(lambda: robot.truths and stamp(robot.truths[-1]) >= start + steps * PERIOD, what="the steps")
    robot.pause(True)
    receive_all(robot)
    for process in robot.launched:
        print(process.output)  # for the report of a failed test
    return true_path(robot.truths, start)


def receive_all(robot):
    """Wait until a paused plant has answered three calls in a row without a true pose in between."""
    quiet = 0
    while quiet < 3:
        before = len(robot.truths)
        robot.pause(True)
        quiet = quiet + 1 if len(robot.truths) == before else 0


def assert_same_path(path, goal, world, steps=STEPS, tolerance=1e-9, moved=0.3):
    reference = simulate(build(WorldConfig, world), PRESETS["tuned"].config, Pose(*goal), steps).truth
    seen = sorted(step for step in path if step <= steps)
    # One or two steps at the start may pass before the discovery of the test's node.
    assert min(seen) <= 2
    assert seen == list(range(min(seen), steps + 1))
    here, there = np.array([path[step] for step in seen]), reference[seen]
    turns = np.array([turned(*poses) for poses in zip(here, there, strict=True)])
    apart = np.maximum(np.abs(here[:, :2] - there[:, :2]).max(axis=1), turns) > tolerance
    first = int(apart.argmax())
    assert not apart.any(), f"apart from step {seen[first]} on: {here[first]}, not {there[first]}"
    assert np.ptp(there[:, 0]) >= moved
