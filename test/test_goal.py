"""When a goal counts as reached: each tolerance on its own."""

import math

import pytest

from diffbot_control.geometry import Pose
from diffbot_control.goal import GoalTolerance, within
from diffbot_control.kinematics import Twist

TOLERANCE = GoalTolerance(0.4, 0.1, 0.05, 0.2)


def judged(rho=0.4, theta=0.1, v=0.05, omega=0.2):
    return within(Pose(9.0, 9.0, theta), rho, Twist(v, omega), TOLERANCE)


def test_the_bounds_belong_to_the_inside():
    assert judged()
    assert judged(theta=-0.1, v=-0.05, omega=-0.2)
    assert judged(0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("name", "value"), [("rho", 0.4), ("theta", 0.1), ("v", 0.05), ("omega", 0.2)])
def test_each_bound_alone_decides(name, value):
    assert not judged(**{name: math.nextafter(value, 1.0)})
    if name != "rho":
        assert not judged(**{name: -math.nextafter(value, 1.0)})
    assert not judged(**{name: math.nan})
