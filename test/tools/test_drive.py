"""The commands goal, dock and undock: the goals that they send, their frame and their controller."""

import math
import os
import signal
from types import SimpleNamespace

import pytest

from diffbot_control.ros.goals.client import GoalClient
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose
from diffbot_tools.cli import main
from diffbot_tools.drive import GoalOptions, _waiting_lines


@pytest.fixture
def sent(monkeypatch, kept_signal_handlers):
    """Collect the options of the goals instead of sending the goals."""
    given = []
    monkeypatch.setattr("diffbot_tools.drive.drive", lambda options: given.append(options) or 0)
    monkeypatch.setattr(GoalClient, "in_own_context", lambda **_: FakeClient(given))
    return given


def address(options):
    return options.controller, options.frame, options.namespace


def test_docking_from_the_present_pose_sends_one_goal_in_the_frame_of_the_dock(sent):
    assert main(["dock", "--namespace", "left", "--timeout", "20"]) == 0
    (goal,) = sent
    assert (*goal.pose, goal.timeout, goal.wait) == (0.0, 0.0, 0.0, 20.0, True)
    assert address(goal) == ("dock_controller", "dock", "left")


@pytest.mark.parametrize(("flags", "side"), [((), -1.0), (("--backward",), 1.0)])
def test_with_the_pose_of_the_dock_the_robot_drives_to_the_staging_pose_first(sent, flags, side):
    assert main(["dock", "3", "1", str(math.pi / 2), "--distance", "0.5", *flags]) == 0
    staging, dock = sent
    assert staging.pose == pytest.approx((3.0, 1.0 + 0.5 * side, math.pi / 2))
    assert address(staging) == ("controller", "map", "")
    assert address(dock) == ("dock_controller", "dock", "")


class FakeClient:
    """A client whose goals are reached; Ctrl-C is pressed when the first goal has ended."""

    def __init__(self, sent, backward=None):
        self.sent, self.task = sent, SimpleNamespace(end="reached", text="reached", elapsed=1.0, is_sent=False)
        self.wait_until_ready = self.wait_for_end = lambda _timeout: not self.is_stopped()
        self.parameter = {"dock_backward": backward}.get

    def send_goal(self, poses, timeout):
        if self.is_stopped():
            raise DiffbotError("no answer")
        self.sent += poses

    def close(self):
        if self.sent:
            os.kill(os.getpid(), signal.SIGINT)


def test_ctrl_c_between_the_drive_to_the_dock_and_the_docking_ends_the_command(
    monkeypatch, kept_signal_handlers, capsys
):
    sent = []
    monkeypatch.setattr(GoalClient, "in_own_context", lambda **_: FakeClient(sent))
    assert main(["dock", "3", "1", "0"]) == 130
    assert len(sent) == 1
    assert capsys.readouterr().out.splitlines()[-1] == "interrupted: no goal was sent"


@pytest.mark.parametrize(("flag", "backward"), [((), True), (("--backward",), False)])
def test_the_robot_does_not_drive_to_the_far_side_of_a_dock_with_another_direction(
    sent, monkeypatch, capsys, flag, backward
):
    monkeypatch.setattr(GoalClient, "in_own_context", lambda **_: FakeClient(sent, backward))
    assert main(["dock", "3", "1", "0", *flag]) == 1
    assert f"must be {backward}, as the parameter dock_backward of dock_controller" in capsys.readouterr().err
    assert not sent


@pytest.mark.parametrize(("flags", "x"), [((), -0.7), (("--backward", "--distance", "1"), 1.0)])
def test_undocking_sends_a_goal_on_the_axis_of_the_dock(sent, flags, x):
    assert main(["undock", *flags]) == 0
    assert sent[0].pose == (x, 0.0, 0.0)


def test_a_goal_in_the_map_is_not_sent_to_the_controller_that_docks(sent, capsys):
    assert main(["goal", "0", "0", "0", "--controller", "dock_controller"]) == 1
    assert "it only docks: use diffbot dock or diffbot undock" in capsys.readouterr().err
    assert not sent
    lines = _waiting_lines(["/r1/dock_controller", "/r1/pilot"], GoalOptions(Pose(0.0, 0.0, 0.0)))
    assert lines[1:3] == [
        "  /r1/dock_controller is running: diffbot dock --namespace r1",
        "  /r1/pilot is running: diffbot goal X Y YAW --namespace r1 --controller pilot",
    ]


def test_an_incomplete_pose_is_refused_in_one_line(sent, capsys):
    assert main(["dock", "3", "1"]) == 1
    assert "three numbers, or none" in capsys.readouterr().err
    assert main(["dock", "3", "1", "400deg"]) == 1
    assert capsys.readouterr().err.count("must be") == 1
    assert not sent


@pytest.mark.parametrize(("text", "theta"), [("90deg", math.pi / 2), ("-1.5", -1.5), ("-360deg", -math.tau)])
def test_a_heading_is_in_radians_or_in_degrees(sent, text, theta):
    assert main(["goal", "1", "2", text]) == 0
    assert sent[0].pose == pytest.approx((1.0, 2.0, theta))


@pytest.mark.parametrize(
    ("text", "hint"), [("90", "write 90deg"), ("400deg", "within a turn, +-360deg"), ("x", "90deg")]
)
def test_a_heading_beyond_a_turn_is_refused_with_a_hint(sent, capsys, text, hint):
    with pytest.raises(SystemExit):
        main(["goal", "1", "2", text])
    assert hint in capsys.readouterr().err
    assert not sent
