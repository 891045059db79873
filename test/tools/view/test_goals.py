"""Goals and their ends in messages of any order; dockings are listed as goals are. test/graph has a recorded bag."""

import math

import pytest
import view_bags

from diffbot_control.goals.record import goal_id
from diffbot_core.geometry import Pose
from diffbot_tools.view.bag_source import read_bag
from diffbot_tools.view.goal_list import GoalList
from diffbot_tools.view.report import page_data
from diffbot_tools.view.texts import Status

BEGIN, SECOND = view_bags.BEGIN, 10**9


def named(message, x, name):
    """Return a status of the controller that names a goal."""
    return Status(0, "controller", message, {"goal": f"{x} 0 0", "goal id": name * 32})


def result(name, end, elapsed):
    return Status(0, name * 32, end, {"elapsed time [s]": elapsed})


def test_goals_at_one_pose_have_their_own_ends_and_a_goal_that_was_never_accepted_has_none():
    goals, pose = GoalList(), Pose(1.0, 0.0, 0.0)
    goals.add_request(1.0, "map", 1, pose)
    goals.add_status(1.1, named("driving", 1, "a"))
    goals.add_request(2.9, "map", 2, Pose(9.0, 0.0, 0.0))
    goals.add_request(3.0, "map", 3, pose)
    # The controller reports its new goal before the end of the previous goal.
    goals.add_status(3.1, named("driving", 1, "b"))
    replaced, reached = result("a", "replaced", "2.0"), result("b", "reached", "0.9")
    goals.add_results(3.2, [replaced])
    goals.add_status(4.0, named("goal reached", 1, "b"))
    goals.add_results(4.1, [replaced, reached])
    goals.add_status(5.0, named("driving", 2, "c"))
    found = [(goal.pose.x, goal.end, goal.elapsed) for goal in goals.goals]
    unknown = pytest.approx(math.nan, nan_ok=True)
    assert found == [(1.0, "replaced", 2.0), (9.0, "", unknown), (1.0, "reached", 0.9), (2.0, "", unknown)]


def test_goals_that_ended_before_the_first_message_are_not_counted_and_later_goals_have_their_whole_time():
    goals, earlier = GoalList(), result("a", "reached", "9.0")
    assert goals.add_results(0.0, [earlier]) == []
    goals.add_status(0.1, named("goal reached", 3, "a"))
    assert goals.count == 0
    goals.add_status(1.0, named("driving", 1, "b"))
    (end,) = goals.add_results(2.0, [earlier, result("b", "cancelled", "1.5")])
    assert (goals.count, end.end, end.id, end.ended, end.elapsed) == (1, "cancelled", "b" * 32, 2.0, 1.5)


def test_the_poses_of_a_path_stay_in_their_order_if_the_status_is_received_late():
    goals = GoalList()
    goals.add_status(1.2, named("driving", 1, "a"))
    goals.add_status(2.0, named("driving", 2, "a"))
    goals.add_results(3.0, [result("a", "reached", "2.0")], is_exact=True)
    ordered = sorted(goals.goals, key=lambda goal: goal.time)
    assert [(goal.pose.x, goal.end) for goal in ordered] == [(1.0, "passed"), (2.0, "reached")]


def test_figures_of_a_goal_are_those_of_its_drive_until_the_answer(circle):
    """The robot drives on a circle of 1 m at 0.5 m/s: half a revolution per pi / 0.5 s."""
    first, second = read_bag(circle).robots[0].outcomes
    _, x, y, yaw = view_bags.at(249)
    assert (first.end, first.is_true, first.time) == ("reached", True, pytest.approx(5.0, abs=0.01))
    assert first.position_error == pytest.approx(math.hypot(x - 1.0, y - 0.5), abs=0.01)
    assert first.heading_error == pytest.approx(abs(math.remainder(yaw - 0.25, 2 * math.pi)), abs=0.01)
    assert first.path_length == pytest.approx(2.5, abs=0.03)
    assert first.revolutions == pytest.approx(2.5 / (2 * math.pi), abs=0.01)
    assert (second.end, second.reason) == ("not reached", view_bags.HOSTILE)


def test_a_late_message_of_goal_pose_belongs_to_the_goal_with_its_id():
    goals, stamp = GoalList(), 1_700_000_000_123_456_789
    values = {"goal": "1 0 0", "goal id": goal_id("map", stamp)}
    goals.add_status(1.0, Status(0, "controller", "driving", values))
    goals.add_request(60.0, "map", stamp, Pose(1.0, 0.0, 0.0))
    assert len(goals.goals) == 1
    goals.add_request(60.0, "odom", stamp + 1, Pose(1.0, 0.0, 0.0))
    assert len(goals.goals) == 2


def driven(controller, time, message, *results, **values):
    """Return the messages of a controller at a time [s]: its status, and results of goals that ended."""
    stamp = round(BEGIN + SECOND * time)
    found = [(f"/{controller}/status", stamp, view_bags.status(f"/{controller}", message, **values))]
    if results:
        found.append((f"/{controller}/goal_results", stamp + 1, view_bags.statuses(stamp, *results)))
    return found


def test_dockings_have_cards_as_goals_do_with_figures_in_the_frame_of_the_dock(tmp_path):
    """After a goal in map, the robot docks within 3 s, undocks, and then does not detect its dock any more."""
    reason, names = "3 approaches broken off", [letter * 32 for letter in "adef"]
    in_map = view_bags.status(names[0], "reached", **{"elapsed time [s]": "1.000"})
    first = view_bags.status(names[1], "reached", **{"elapsed time [s]": "3.000"})
    second = view_bags.status(names[2], "reached", **{"elapsed time [s]": "1.000"})
    third = view_bags.status(names[3], "not reached", **{"elapsed time [s]": "2.400", "reason": reason})
    found = [
        *driven("controller", 0.5, "driving", goal="1 0 0", goal_id=names[0]),
        *driven("controller", 1.5, "goal reached", in_map, goal="1 0 0", goal_id=names[0]),
        *driven("dock_controller", 2.0, "driving", goal="0 0 0", goal_id=names[1]),
        *driven("dock_controller", 5.0, "goal reached", first),
        *driven("dock_controller", 6.0, "driving", goal="-0.7 0 0", goal_id=names[2]),
        *driven("dock_controller", 7.0, "goal reached", first, second),
        *driven("dock_controller", 7.1, "driving", goal="0 0 0", goal_id=names[3]),
        *driven("dock_controller", 9.5, "goal not reached", first, second, third),
    ]
    found += [
        ("/odom", time, view_bags.odometry(time, 0.0, 0.0, 0.0))
        for time in range(BEGIN, BEGIN + 10 * SECOND, SECOND // 10)
    ]
    for step in range(71):
        time = BEGIN + step * SECOND // 10
        x = max(-1.5, min(-0.01, -0.01 - (5.0 - step / 10) * 0.5)) if step < 60 else -0.7
        found.append(("/dock/pose", time, view_bags.estimate(time, x, 0.03, 0.0, sigma=0.01)))
    view_bags.write(tmp_path / "bag", sorted(found, key=lambda one: one[1]))
    (robot,) = page_data(read_bag(tmp_path / "bag"))["robots"]
    _, dock, undock, failed = robot["cards"]
    assert [one["title"] for one in robot["cards"]] == ["Goal 1: 1.00, 0.00 m, 0 deg", "Dock", "Undock", "Dock"]
    assert dock["verdict"] == "Docked in 3.0 s"
    assert dock["position_error"] == pytest.approx(math.hypot(0.01, 0.03), abs=1e-6)
    assert dock["path_length"] == pytest.approx(1.49, abs=0.02)
    assert undock["verdict"] == "Undocked in 1.0 s"
    assert (failed["level"], failed["verdict"]) == (2, f"Not reached: {reason} (after 2.4 s)")
    assert failed["lines"][0] == (1, "No detected dock for 2.4 s")
    assert robot["result"] == (2, "1 of 1 goal reached, 2 of 3 docking drives done")
    ends = [one.text for one in robot["events"] if one.kind == "end"]
    assert ends[1:] == ["dock: reached", "undock: reached", f"dock: not reached: {reason}"]
    assert len(robot["goals"]) == 1, "goals in the frame of the dock are not drawn on the map"
