"""A list of goals, driven by made-up reports of the controller."""

import pytest

from diffbot_core.geometry import Pose
from diffbot_lab.demo.mission import Leg, Mission

A, B, C = Pose(0.0, 0.0, 0.0), Pose(3.0, 2.0, 1.5), Pose(1.0, -2.0, 3.0)


def test_a_mission_by_hand():
    mission = Mission([A, B], hold=1.0, timeout=60.0)
    assert (mission.goal, mission.done, mission.progress) == (A, False, 0.0)
    assert not mission.on_navigation(10.0, 5.0)
    assert not mission.on_navigation(12.0, 2.5)
    assert mission.progress == pytest.approx(0.25)
    mission.on_goals_reached(1)
    assert mission.progress == pytest.approx(0.5)
    assert not mission.on_navigation(12.9, 0.1)
    assert mission.on_navigation(13.0, 0.1)
    assert (mission.goal, mission.done) == (B, False)
    assert mission.progress == pytest.approx(0.5)
    assert not mission.on_navigation(13.1, 4.0)
    assert not mission.on_navigation(15.1, 1.0)
    assert mission.progress == pytest.approx(0.5 + 0.375)
    mission.on_goals_reached(2)
    # The last goal: nothing to send, but the mission is done.
    assert not mission.on_navigation(16.5, 0.1)
    assert mission.done
    assert not mission.gave_up
    assert mission.progress == 1.0
    assert mission.goal == B
    assert mission.legs == [Leg(A, 10.0, 13.0, True), Leg(B, 13.1, 16.5, True)]


def test_a_leg_may_begin_at_time_zero():
    mission = Mission([A], hold=0.5, timeout=60.0)
    mission.on_navigation(0.0, 5.0)
    mission.on_navigation(3.0, 0.1)
    mission.on_goals_reached(1)
    mission.on_navigation(4.0, 0.1)
    assert mission.legs == [Leg(A, 0.0, 4.0, True)]


def test_a_goal_not_reached_in_time_is_given_up_and_ends_the_mission():
    mission = Mission([A, B, C], hold=0.0, timeout=10.0)
    assert not mission.on_navigation(5.0, 3.0)
    assert not mission.on_navigation(15.0, 3.0)
    assert not mission.on_navigation(15.1, 3.0)
    assert mission.done
    assert mission.gave_up
    assert mission.legs == [Leg(A, 5.0, 15.1, False)]
    assert not mission.on_navigation(30.0, 3.0)
    mission.on_goals_reached(1)
    assert len(mission.legs) == 1


def test_a_reached_goal_is_not_given_up_while_it_is_held():
    mission = Mission([A], hold=20.0, timeout=10.0)
    mission.on_navigation(0.0, 3.0)
    mission.on_navigation(9.0, 0.1)
    mission.on_goals_reached(1)
    mission.on_navigation(15.0, 0.1)
    assert not mission.done
    mission.on_navigation(29.0, 0.1)
    assert mission.legs == [Leg(A, 0.0, 29.0, True)]


def test_a_late_report_does_not_count_for_the_next_goal():
    mission = Mission([A, B], hold=0.0, timeout=60.0)
    # Received before any navigation for this goal, so it refers to an earlier one.
    mission.on_goals_reached(1)
    mission.on_navigation(0.0, 5.0)
    assert not mission.legs
    mission.on_goals_reached(1)
    assert mission.on_navigation(1.0, 0.1)
    mission.on_navigation(1.1, 4.0)
    mission.on_goals_reached(1)
    assert not mission.on_navigation(2.0, 3.0)
    assert len(mission.legs) == 1


def test_progress_never_leaves_its_range():
    mission = Mission([A, B], hold=0.0, timeout=60.0)
    for time, distance in enumerate((2.0, 5.0, 7.0, 3.5, 9.0)):
        mission.on_navigation(float(time), distance)
        assert 0.0 <= mission.progress <= 0.5
    # The robot may have to go away first: the way is measured from the farthest point.
    mission.on_navigation(9.0, 4.5)
    assert mission.progress == pytest.approx(0.25)
