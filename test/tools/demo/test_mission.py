"""A list of goals, driven by made-up reports of the controller."""

import pytest

from diffbot_core.geometry import Pose
from diffbot_tools.demo.mission import Leg, Mission

A, B = Pose(0.0, 0.0, 0.0), Pose(3.0, 2.0, 1.5)


def test_a_mission_by_hand():
    mission = Mission([A, B], hold=1.0, timeout=60.0)
    assert (mission.goal, mission.done, mission.progress) == (A, False, 0.0)
    assert not mission.on_navigation(0.0, 5.0)
    assert not mission.on_navigation(2.0, 2.5)
    assert mission.progress == pytest.approx(0.25)
    # The robot may have to go away first: the way is measured from the farthest point.
    assert not mission.on_navigation(2.0, 10.0)
    assert mission.progress == 0.0
    mission.on_goals_reached(1)
    assert mission.progress == pytest.approx(0.5)
    assert not mission.on_navigation(2.9, 0.1)
    assert mission.on_navigation(3.0, 0.1)
    assert (mission.goal, mission.done) == (B, False)
    assert mission.progress == pytest.approx(0.5)
    assert not mission.on_navigation(3.1, 4.0)
    assert not mission.on_navigation(5.1, 1.0)
    assert mission.progress == pytest.approx(0.5 + 0.375)
    mission.on_goals_reached(2)
    # The last goal: nothing to send, but the mission is done.
    assert not mission.on_navigation(6.5, 0.1)
    assert (mission.done, mission.gave_up, mission.progress) == (True, False, 1.0)
    assert mission.legs == [Leg(A, 0.0, 3.0, True), Leg(B, 3.1, 6.5, True)]


def test_a_goal_not_reached_in_time_is_given_up_and_ends_the_mission():
    mission = Mission([A, B], hold=0.0, timeout=10.0)
    assert not mission.on_navigation(5.0, 3.0)
    assert not mission.on_navigation(15.0, 3.0)
    assert not mission.done
    assert not mission.on_navigation(15.1, 3.0)
    assert (mission.done, mission.gave_up) == (True, True)
    assert not mission.on_navigation(30.0, 3.0)
    mission.on_goals_reached(1)
    assert mission.legs == [Leg(A, 5.0, 15.1, False)]
