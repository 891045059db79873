"""Detection of odometry messages whose twist and pose contradict each other, and of contradictory turn rates."""

import math

import numpy as np
import pytest

from diffbot_control.filter.odometry_check import Agreement, OdometryCheck, with_rates
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist

DT = 0.02


def drive(change, seconds, rests=False, jump=math.inf):
    """Drive a winding path, with each message changed by ``change``; yield the time [s] of motion and the fault."""
    check, x, y, theta, motion = OdometryCheck(), 0.0, 0.0, 0.0, 0.0
    rng = np.random.default_rng(3)
    for number in range(round(seconds / DT)):
        time = number * DT
        # With rests, the robot moves for one of four seconds.
        is_at_rest = rests and time % 4.0 >= 1.0
        v, omega = (0.0, 0.0) if is_at_rest else (0.3, 0.6 * math.copysign(1.0, math.sin(time)))
        motion += 0.0 if is_at_rest else DT
        x += v * math.cos(theta + 0.5 * omega * DT) * DT
        y += v * math.sin(theta + 0.5 * omega * DT) * DT
        theta += omega * DT
        noise = 0.02 * rng.standard_normal(2) * (not is_at_rest)
        # The driver counts encoder ticks of 2 mm, and resets its pose at ``jump`` [s].
        pose = Pose(round(x - 5.0 * (time > jump), 3) // 0.002 * 0.002, round(y, 3), math.remainder(theta, math.tau))
        pose, twist = change(pose, Twist(v + noise[0], omega + noise[1]))
        check.add(round(time * 1e9) + 10**18, pose, twist)
        yield motion, check.fault()


FAULTS = {
    "twist.linear.x stays 0": lambda pose, twist: (pose, Twist(0.0, twist.omega)),
    "twist.angular.z stays 0": lambda pose, twist: (pose, Twist(twist.v, 0.0)),
    "the position does not change": lambda pose, twist: (Pose(1.0, 2.0, pose.theta), twist),
    "the orientation does not change": lambda pose, twist: (pose._replace(theta=0.5), twist),
    "twist.linear.x and the pose differ by a factor": lambda pose, twist: (pose, Twist(1e3 * twist.v, twist.omega)),
    "twist.angular.z and the pose differ by a factor": lambda pose, twist: (pose, Twist(twist.v, 57.3 * twist.omega)),
    "twist.linear.x and the pose have opposite signs": lambda pose, twist: (pose, Twist(-twist.v, twist.omega)),
    "twist.angular.z and the pose have opposite signs": lambda pose, twist: (pose, Twist(twist.v, -twist.omega)),
}


@pytest.mark.parametrize("rests", [False, True])
@pytest.mark.parametrize("name", FAULTS)
def test_a_contradiction_of_twist_and_pose_is_reported_within_five_seconds_of_motion(name, rests):
    faults = [fault for motion, fault in drive(FAULTS[name], 20.0, rests) if motion < 5.0]
    assert faults[-1].startswith(name)


def test_a_correct_odometry_is_not_reported_even_if_its_pose_jumps_or_the_robot_creeps():
    assert {fault for _, fault in drive(lambda pose, twist: (pose, twist), 60.0, jump=20.0)} == {""}
    check = OdometryCheck()
    for number in range(1000):
        # One encoder tick in 50 messages, at a speed below MIN_SPEED.
        check.add(number * 10**8 + 1, Pose(0.05 * (number // 50), 0.0, 0.0), Twist(0.01, 0.0))
    assert check.fault() == ""


def test_a_contradiction_ends_after_motion_without_it_but_not_at_rest():
    memory = Agreement()
    for _ in range(30):
        memory = with_rates(memory, 0.1, 0.5, -0.5, 0.1)
    assert memory.contradiction() == "opposed"
    memory = with_rates(memory, 100.0, 0.01, -0.05, 0.1)
    assert memory.contradiction() == "opposed"
    for _ in range(40):
        memory = with_rates(memory, 0.1, 0.5, 0.45, 0.1)
    assert memory.contradiction() == ""
    assert sum(memory) == pytest.approx(2.0)
