"""Twist and pose of an odometry, or wheels and gyro, that contradict each other: found by motion only."""

import math

import numpy as np
import pytest

from diffbot_control.filter.odometry_check import Agreement, OdometryCheck, with_rates
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist

DT = 0.02


def story(change, seconds, rests=False, jump=math.inf):
    """Yield the time [s] of motion and the fault of a robot on a winding path, whose message ``change`` spoils."""
    found, x, y, theta, moved = OdometryCheck(), 0.0, 0.0, 0.0, 0.0
    random = np.random.default_rng(3)
    for number in range(round(seconds / DT)):
        time = number * DT
        # With rests it moves one second of four.
        stands = rests and time % 4.0 >= 1.0
        v, omega = (0.0, 0.0) if stands else (0.3, 0.6 * math.copysign(1.0, math.sin(time)))
        moved += 0.0 if stands else DT
        x += v * math.cos(theta + 0.5 * omega * DT) * DT
        y += v * math.sin(theta + 0.5 * omega * DT) * DT
        theta += omega * DT
        noise = 0.02 * random.standard_normal(2) * (not stands)
        # The driver counts ticks of 2 mm, and may set its pose to 0.
        pose = Pose(round(x - 5.0 * (time > jump), 3) // 0.002 * 0.002, round(y, 3), math.remainder(theta, math.tau))
        pose, twist = change(pose, Twist(v + noise[0], omega + noise[1]))
        found.add(round(time * 1e9) + 10**18, pose, twist)
        yield moved, found.fault()


FAULTS = {
    "twist.linear.x stays 0": lambda pose, twist: (pose, Twist(0.0, twist.omega)),
    "twist.angular.z stays 0": lambda pose, twist: (pose, Twist(twist.v, 0.0)),
    "the position stands still": lambda pose, twist: (Pose(1.0, 2.0, pose.theta), twist),
    "the orientation stands still": lambda pose, twist: (pose._replace(theta=0.5), twist),
    "twist.linear.x and the pose differ by a factor": lambda pose, twist: (pose, Twist(1e3 * twist.v, twist.omega)),
    "twist.angular.z and the pose differ by a factor": lambda pose, twist: (pose, Twist(twist.v, 57.3 * twist.omega)),
    "twist.linear.x and the pose have opposite signs": lambda pose, twist: (pose, Twist(-twist.v, twist.omega)),
    "twist.angular.z and the pose have opposite signs": lambda pose, twist: (pose, Twist(twist.v, -twist.omega)),
}


@pytest.mark.parametrize("rests", [False, True])
@pytest.mark.parametrize("name", [name for name in FAULTS if "still" not in name])
def test_a_twist_that_contradicts_the_pose_is_named_within_five_seconds_of_motion(name, rests):
    moved = next(moved for moved, fault in story(FAULTS[name], 40.0, rests) if fault)
    assert moved < 5.0
    *_, (_, fault) = story(FAULTS[name], 40.0, rests)
    assert fault.startswith(name)


@pytest.mark.parametrize("name", ["the position stands still", "the orientation stands still"])
def test_a_pose_that_stands_still_is_named(name):
    *_, (moved, fault) = story(FAULTS[name], 4.9)
    assert moved < 5.0
    assert fault.startswith(name)


def test_a_right_odometry_is_never_named_even_if_its_pose_jumps_or_the_robot_only_creeps():
    assert {fault for _, fault in story(lambda *right: right, 60.0, jump=20.0)} == {""}
    found = OdometryCheck()
    for number in range(1000):
        # Encoders without a tick between two messages, far below the smallest motion.
        found.add(number * 10**8 + 1, Pose(0.05 * (number // 50), 0.0, 0.0), Twist(0.01, 0.0))
    assert found.fault() == ""


def test_a_fault_that_is_repaired_is_over_after_as_much_motion():
    found = Agreement()
    for _ in range(30):
        found = with_rates(found, 0.1, 0.5, -0.5, 0.1)
    assert found.contradiction() == "opposed"
    found = with_rates(found, 100.0, 0.01, -0.05, 0.1)
    assert found.contradiction() == "opposed", "rest says nothing"
    for _ in range(40):
        found = with_rates(found, 0.1, 0.5, 0.45, 0.1)
    assert found.contradiction() == ""
    assert sum(found) == pytest.approx(2.0)
