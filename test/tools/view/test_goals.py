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
LATE = 2_000_000
"""[ns] between a goal and the status that names it"""
GOALS = (
    ("a", 1.0, 1.0, True, "replaced", 3.0),
    ("b", 3.0, 1.0, True, "reached", 4.0),
    ("c", 5.0, 2.0, False, "cancelled", 6.0),
    ("d", 6.0, 3.0, True, "not reached", 8.0),
    ("e", 8.5, 4.0, True, "", 0.0),
)
"""Name, time [s], x of the pose [m], True if sent on goal_pose, end, and time of the end [s]; b has the pose of a."""


def id_of(name):
    return name * 32


def messages(goals, begin=0.0, before=()):
    """Return the messages of a bag that begins at ``begin`` [s], with latched results of the goals ``before``."""
    found, results = [], [view_bags.status(id_of(name), end, source="request") for name, end in before]
    at = [round(BEGIN + SECOND * time) for time in (begin, 10.0)]
    for time in range(*at, SECOND // 10):
        found.append((time, "/odom", view_bags.odometry(time, 0.0, 0.0, 0.0)))
    if results:
        found.append((at[0], "/controller/goal_results", view_bags.statuses(0, *results)))
    changes = []
    for name, sent, x, is_topic, end, ended in goals:
        time = round(BEGIN + SECOND * sent)
        if is_topic:
            found.append((time, "/goal_pose", view_bags.goal(0, x, 0.0, 0.0)))
        values = {"goal": f"{x:g} 0 0", "goal_id": id_of(name)}
        changes.append((time + LATE, "waiting for pose", values))
        if end:
            elapsed = {"elapsed time [s]": f"{ended - sent:.3f}"}
            results.append(view_bags.status(id_of(name), end, source="request", **elapsed))
            # The controller reports its new goal before the end of the previous goal.
            time = round(BEGIN + SECOND * ended) + 2 * LATE
            found.append((time, "/controller/goal_results", view_bags.statuses(0, *results)))
        if end in ("reached", "not reached"):
            is_held = end == "reached"
            changes.append((time - LATE, f"goal {end}", values if is_held else {}))
        elif end == "cancelled":
            changes.append((time - 3 * LATE, "idle", {}))
    for index, (time, text, values) in enumerate(changes):
        following = changes[index + 1][0] if index + 1 < len(changes) else at[1]
        for repeated in range(time, following, SECOND // 2):
            found.append((repeated, "/controller/status", view_bags.status("/controller", text, **values)))
    first = [one for one in found if one[0] >= at[0]]
    if latched := [one for one in found if one[0] < at[0] and one[1] == "/controller/status"]:
        first.append((at[0], *latched[-1][1:]))
    return [(topic, time, message) for time, topic, message in sorted(first, key=lambda one: one[0])]


def rows_of(folder, *arguments, **options):
    view_bags.write(folder / "bag", messages(*arguments, **options))
    (robot,) = page_data(read_bag(folder / "bag"))["robots"]
    return robot


def test_a_bag_that_begins_within_a_goal_has_the_whole_time_of_the_goal(tmp_path):
    robot = rows_of(tmp_path, GOALS, begin=5.5, before=(("a", "replaced"), ("b", "reached")))
    card = robot["cards"][0]
    assert (card["title"], card["verdict"]) == (
        "Goal 1: 2.00, 0.00 m, 0 deg",
        "Cancelled (sent by request) after 1.0 s",
    )
    events = [one.text for one in robot["events"] if one.kind in ("goal", "end")]
    assert events[:2] == ["goal 1: x 2.00 m, y 0.00 m, 0 deg", "goal 2: x 3.00 m, y 0.00 m, 0 deg"]
    assert events[2] == "goal cancelled [request]"


def test_a_goal_that_the_controller_never_accepted_has_no_answer(tmp_path):
    extra = [("/goal_pose", BEGIN + int(2.9 * SECOND), view_bags.goal(0, 9.0, 0.0, 0.0))]
    view_bags.write(tmp_path / "bag", sorted([*messages(GOALS), *extra], key=lambda one: one[1]))
    (robot,) = page_data(read_bag(tmp_path / "bag"))["robots"]
    assert [row["end"] for row in robot["cards"]] == ["replaced", "", "reached", "cancelled", "not reached", ""]


def test_a_live_page_does_not_list_goals_that_ended_before_it_was_opened():
    goals, earlier = GoalList(), Status(0, "a" * 32, "reached", {})
    assert goals.add_results(0.0, [earlier]) == []
    goals.add_status(1.0, Status(0, "controller", "driving", {"goal": "1 0 0", "goal id": "b" * 32}))
    (end,) = goals.add_results(2.0, [earlier, Status(0, "b" * 32, "cancelled", {"elapsed time [s]": "1.500"})])
    assert (end.end, end.id, end.ended, end.elapsed) == ("cancelled", "b" * 32, 2.0, 1.5)


def test_the_poses_of_a_path_stay_in_their_order_if_the_status_is_received_late():
    goals, path = GoalList(), "a" * 32
    goals.add_status(1.2, Status(0, "controller", "driving", {"goal": "1 0 0", "goal id": path}))
    goals.add_status(2.0, Status(0, "controller", "driving", {"goal": "2 0 0", "goal id": path}))
    goals.add_results(3.0, [Status(0, path, "reached", {"elapsed time [s]": "2.000"})], is_exact=True)
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


def docking(time, message, *results, **values):
    """Return the messages of the docking controller at a time [s]: its status, and results of goals that ended."""
    stamp = round(BEGIN + SECOND * time)
    found = [("/dock_controller/status", stamp, view_bags.status("/dock_controller", message, **values))]
    if results:
        found.append(("/dock_controller/goal_results", stamp + LATE, view_bags.statuses(stamp, *results)))
    return found


def test_dockings_have_cards_as_goals_do_with_figures_in_the_frame_of_the_dock(tmp_path):
    """After a goal in map, the robot docks within 3 s, undocks, and then does not detect its dock any more."""
    reason = "3 approaches broken off"
    first = view_bags.status(id_of("d"), "reached", **{"elapsed time [s]": "3.000"})
    second = view_bags.status(id_of("e"), "reached", **{"elapsed time [s]": "1.000"})
    third = view_bags.status(id_of("f"), "not reached", **{"elapsed time [s]": "2.400", "reason": reason})
    found = [
        *messages((("a", 0.5, 1.0, True, "reached", 1.5),)),
        *docking(2.0, "driving", goal="0 0 0", goal_id=id_of("d")),
        *docking(5.0, "goal reached", first),
        *docking(6.0, "driving", goal="-0.7 0 0", goal_id=id_of("e")),
        *docking(7.0, "goal reached", first, second),
        *docking(7.1, "driving", goal="0 0 0", goal_id=id_of("f")),
        *docking(9.5, "goal not reached", first, second, third),
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
