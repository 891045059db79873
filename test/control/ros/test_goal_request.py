"""Goals by request: what the client writes the controller reads, and every bad field is named in one line."""

import math

import pytest
from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import SetParametersAtomically
from robot import parameter_value

from diffbot_control.ros.goals.request import goal_request, read_goal_request
from diffbot_control.ros.messages.fields import pose_of
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose

ID = "0123456789abcdef0123456789abcdef"
GOOD = {"goal_id": ID, "frame_id": "map", "x": 1.0, "y": -2.0, "yaw": 0.5}


def request(values):
    pairs = values.items() if isinstance(values, dict) else values
    parameters = [Parameter(name=name, value=parameter_value(value)) for name, value in pairs]
    return SetParametersAtomically.Request(parameters=parameters)


def test_a_goal_and_a_path_are_read_as_they_were_written():
    goal, path = Pose(1.0, -2.0, 0.5), [Pose(1.0, -2.0, 0.5), Pose(3.0, 4.0, -1.0)]
    sent = read_goal_request(goal_request(ID, [goal], "odom"), "map")
    assert (sent.id, sent.message.header.frame_id) == (ID, "odom")
    assert pose_of(sent.message.pose) == pytest.approx(goal)
    sent = read_goal_request(goal_request(ID, path, "map"), "elsewhere")
    assert sent.message.header.frame_id == "map"
    assert [pose_of(one.pose) for one in sent.message.poses] == [pytest.approx(pose) for pose in path]
    # The frame may be left out, numbers may be whole and the id in capitals.
    sent = read_goal_request(request({"goal_id": ID.upper(), "x": 1, "y": 2, "yaw": 0}), "the_map")
    assert (sent.id, sent.message.header.frame_id) == (ID, "the_map")
    # A list of one is a path of one, an id alone a question.
    sent = read_goal_request(request({**GOOD, "x": [1.0], "y": [2.0], "yaw": [0.5]}), "map")
    assert len(sent.message.poses) == 1
    assert read_goal_request(goal_request(ID, (), ""), "map") == (ID, None)


HOSTILE = {
    "id with line breaks": ({**GOOD, "goal_id": ID + "\n"}, "goal_id = '0123456789abcdef0123456789abcdef\\n'"),
    "zero id": ({**GOOD, "goal_id": "0" * 32}, "not all zero"),
    "endless id": ({**GOOD, "goal_id": "a" * 10**6}, "goal_id = 'aaaaaaaaaa"),
    "x is nan": ({**GOOD, "x": math.nan}, "x = nan: must be a finite number [m]"),
    "yaw is huge": ({**GOOD, "yaw": 1001.0}, "yaw = 1001.0: must be from -1000 to 1000 rad"),
    "a frame alone": ({"goal_id": ID, "frame_id": "map"}, "x = None: must be given"),
    "frame is empty": ({**GOOD, "frame_id": ""}, "frame_id = ''"),
    "unknown field": ({**GOOD, "z\ny": 1.0}, "field = 'z\\ny': must be one of goal_id, frame_id, x, y, yaw"),
    "field twice": ([*GOOD.items(), ("x", 2.0)], "x = 2.0: must be given once"),
    "one list": ({**GOOD, "x": [1.0, 2.0]}, "y = -2.0: must be a list of 2 numbers, as x is"),
    "empty lists": ({**GOOD, "x": [], "y": [], "yaw": []}, "x = '0 values': must be from 1 to 1000 values"),
    "a list with nan": ({**GOOD, "x": [1.0, math.nan], "y": [1.0, 2.0], "yaw": [0.0, 0.0]}, "x = nan"),
}


@pytest.mark.parametrize(("values", "text"), HOSTILE.values(), ids=HOSTILE)
def test_a_bad_field_is_named_in_one_short_line(values, text):
    with pytest.raises(InvalidValueError) as refused:
        read_goal_request(request(values), "map")
    reason = str(refused.value)
    assert text in reason
    assert "\n" not in reason
    assert len(reason) < 250
