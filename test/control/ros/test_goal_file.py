"""A goal survives in its file as it was; a file of any other content is refused in one line."""

import contextlib
import json
import math

import hypothesis.strategies as st
import pytest
from hypothesis import given, settings

from diffbot_control.ros.goals.goal_file import BrokenGoalError, SavedGoal, encode_poses, load_goal, save_goal
from diffbot_core.geometry import Pose

ID = "0123456789abcdef" * 2
SINGLE = SavedGoal(ID, "goal_pose", "map", [Pose(1.0, -2.5, 0.1)])
PATH = SavedGoal(ID, "path", "map", [Pose(0.1 + 0.2, 1e-17, -3.0), Pose(4.0, 5.0, 6.0)], 3, 4)
CANCELLED = SavedGoal(ID, "request", "map", [], 0, 0, True)


@pytest.mark.parametrize("goal", [SINGLE, PATH, CANCELLED])
def test_a_goal_is_read_as_it_was_written(goal, tmp_path):
    path = tmp_path / "folder" / "goal.json"
    assert load_goal(path, 10) is None
    save_goal(path, goal)
    assert load_goal(path, 10) == goal
    assert [one.name for one in path.parent.iterdir()] == ["goal.json"]
    save_goal(path, goal, encode_poses([Pose(9.0, 9.0, 9.0), *goal.poses])[1:])
    assert load_goal(path, 10) == goal


def changed(**fields):
    content = {"version": 1, **PATH._asdict(), "poses": [list(pose) for pose in PATH.poses], **fields}
    return json.dumps({name: value for name, value in content.items() if value != "absent"})


BROKEN = {
    "deep nesting": "[" * 100_000,
    "another version": changed(version=2),
    "no id": changed(id="absent"),
    "too many poses": changed(poses=[[0.0, 0.0, 0.0]] * 4, waypoint=1, waypoints=4),
    "a huge integer": changed(poses=[[10**400, 0.0, 0.0]] * 2),
    "a waypoint beyond the path": changed(waypoint=5),
    "a waypoint of no path": changed(waypoint=1, waypoints=0, poses=[[0.0, 0.0, 0.0]]),
    "huge numbers of waypoints": changed(waypoint=10**30, waypoints=10**30 + 1),
    "a frame of two lines": changed(frame="map\n"),
    "a long file": changed(extra="x" * 10_000),
}


@pytest.mark.parametrize("content", BROKEN.values(), ids=BROKEN)
def test_anything_else_is_refused_in_one_line(content, tmp_path):
    path = tmp_path / "goal"
    path.write_text(content)
    with pytest.raises(BrokenGoalError) as caught:
        load_goal(path, 3)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < len(str(path)) + 200


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=40),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)


@settings(max_examples=50)
@given(st.sampled_from([*SavedGoal._fields, "version"]), JSON)
def test_any_value_of_a_field_is_taken_or_refused(tmp_path_factory, field, value):
    path = tmp_path_factory.getbasetemp() / "goal"
    path.write_text(changed(**{field: value}))
    with contextlib.suppress(BrokenGoalError):
        found = load_goal(path, 3)
        assert all(math.isfinite(number) for pose in found.poses for number in pose)
        assert found.is_cancelling or len(found.poses) == found.waypoints - found.waypoint + 1
