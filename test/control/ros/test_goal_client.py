"""The client of the controller, without a controller."""

from contextlib import closing

import pytest

from diffbot_control.goals.record import MAX_PATH_POSES
from diffbot_control.ros.goals.client import GoalClient, GoalRefusedError
from diffbot_core.geometry import Pose


def test_a_path_that_is_too_long_is_refused_at_once():
    refused = pytest.raises(GoalRefusedError, match="goal refused: path too long: 2001 poses, at most 2000")
    with closing(GoalClient.in_own_context()) as client, refused:
        client.send_goal([Pose(0.0, 0.0, 0.0)] * (MAX_PATH_POSES + 1), timeout=0.0)
