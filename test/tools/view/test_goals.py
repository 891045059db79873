"""Which goal each end belongs to: with ids in the status, and in recordings of controllers that do not name them."""

import pytest
import view_bags

from diffbot_tools.view.events import EventMaker
from diffbot_tools.view.report import page_data, read_bag_run
from diffbot_tools.view.texts import Status

BEGIN, SECOND = view_bags.BEGIN, 10**9
LATE = 2_000_000
"""[ns] between a goal and what the controller says of it"""
# Name, time [s] of the goal, x of its pose, topic or not, its end and the time [s] of the end.
REPLACED_TWICE = (
    ("a", 1.0, 1.0, True, "replaced", 3.0),
    ("b", 3.0, 2.0, True, "replaced", 3.2),
    ("c", 3.2, 3.0, True, "reached", 6.0),
)
REPLACED_THEN_OTHER_ENDS = (
    ("a", 1.0, 1.0, True, "replaced", 2.0),
    ("b", 2.0, 2.0, False, "cancelled", 4.0),
    ("c", 5.0, 3.0, False, "replaced", 7.0),
    ("d", 7.0, 4.0, True, "not reached", 9.0),
)
CANCELLED_BY_THE_NEXT_GOAL = (
    ("a", 1.0, 1.0, False, "cancelled", 3.0),
    ("b", 3.0, 2.0, False, "reached", 5.0),
    ("c", 5.5, 3.0, True, "", 0.0),
)
THE_SAME_GOAL_AGAIN = (
    ("a", 1.0, 1.0, True, "replaced", 3.0),
    ("b", 3.0, 1.0, True, "reached", 5.0),
    ("c", 6.0, 1.0, True, "reached", 6.1),
)
ORDERS = (REPLACED_TWICE, REPLACED_THEN_OTHER_ENDS, CANCELLED_BY_THE_NEXT_GOAL, THE_SAME_GOAL_AGAIN)


def id_of(name):
    return name * 32


def messages(goals, names_ids, has_elapsed, begin=0.0, before=()):
    """Return the messages of a recording that begins at ``begin`` [s]; results ``before`` it are latched."""
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
        values = {"goal": f"{x:g} 0 0"} | ({"goal_id": id_of(name)} if names_ids else {})
        changes.append((time + LATE, "waiting for pose", values))
        if end:
            elapsed = {"elapsed time [s]": f"{ended - sent:.3f}"} if has_elapsed else {}
            results.append(view_bags.status(id_of(name), end, source="request", **elapsed))
            # The controller reports its new goal first, and then the end of the goal before.
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
    (robot,) = page_data(read_bag_run(folder / "bag"))["robots"]
    return robot


@pytest.mark.parametrize("has_elapsed", [True, False], ids=["elapsed", "no elapsed"])
@pytest.mark.parametrize("names_ids", [True, False], ids=["ids", "no ids"])
@pytest.mark.parametrize("goals", ORDERS)
def test_each_end_is_that_of_its_own_goal(tmp_path, goals, names_ids, has_elapsed):
    robot = rows_of(tmp_path, goals, names_ids, has_elapsed)
    assert [row["goal"][0] for row in robot["summary"]] == [x for _, _, x, *_ in goals]
    assert [row["end"] for row in robot["summary"]] == [end and f"{end} [request]" for *_, end, _ in goals]
    for row, (_, sent, _, _, end, ended) in zip(robot["summary"], goals, strict=True):
        # Without a message of its own, a goal was sent when the status first named it.
        assert row["time"] == pytest.approx(sent, abs=0.01)
        assert not end or row["verdict"].rstrip(")").endswith(f" {ended - sent:.1f} s")
    assert len([one for one in robot["events"] if one[1] == "end"]) == len([one for one in goals if one[-2]])


def test_a_recording_that_begins_within_a_goal_knows_its_whole_time(tmp_path):
    robot = rows_of(tmp_path, REPLACED_TWICE, True, True, begin=4.0, before=(("a", "replaced"), ("b", "replaced")))
    (row,) = robot["summary"]
    assert (row["goal"][0], row["verdict"]) == (3.0, "Reached in 2.8 s")
    assert [one[3] for one in robot["events"] if one[1] in ("goal", "end")] == [
        "goal 1: x 3.00 m, y 0.00 m, 0 deg",
        "goal reached [request]",
    ]


def test_a_goal_that_the_controller_never_accepted_has_no_answer_and_takes_none(tmp_path):
    path = tmp_path / "bag"
    extra = [("/goal_pose", BEGIN + int(2.9 * SECOND), view_bags.goal(0, 9.0, 0.0, 0.0))]
    found = sorted([*messages(REPLACED_TWICE, True, True), *extra], key=lambda one: one[1])
    view_bags.write(path, found)
    (robot,) = page_data(read_bag_run(path))["robots"]
    ends = ["replaced [request]", "", "replaced [request]", "reached [request]"]
    assert [row["end"] for row in robot["summary"]] == ends


def test_a_live_page_lists_no_goal_that_ended_before_it_was_opened():
    maker = EventMaker(names_goals=True)
    earlier = Status(0, "a" * 32, "reached", {})
    assert maker.of_results(0.0, [earlier]) == []
    maker.of_status(1.0, "controller", Status(0, "controller", "driving", {"goal": "1 0 0", "goal id": "b" * 32}))
    (end,) = maker.of_results(2.0, [earlier, Status(0, "b" * 32, "cancelled", {"elapsed time [s]": "1.500"})])
    assert (end.row, end.goal, end.elapsed) == ((2.0, "end", 0, "goal cancelled"), "b" * 32, 1.5)
