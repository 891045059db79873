"""The commands dock and undock: which goals they send, in which frame, to whom."""

import math

import pytest

from diffbot_tools.cli import main


@pytest.fixture
def sent(monkeypatch, kept_signal_handlers):
    """Options of the goals that would be sent; each is reached."""
    given = []
    monkeypatch.setattr("diffbot_tools.dock_command.run", lambda options: given.append(options) or 0)
    return given


def where(options):
    return options.controller, options.frame, options.namespace


def test_docking_where_the_robot_is_sends_one_goal_in_the_frame_of_the_dock(sent):
    assert main(["dock", "--namespace", "left", "--timeout", "20"]) == 0
    (goal,) = sent
    assert (*goal.pose, goal.timeout, goal.wait) == (0.0, 0.0, 0.0, 20.0, True)
    assert where(goal) == ("dock_controller", "dock", "left")


@pytest.mark.parametrize(("flags", "side"), [((), -1.0), (("--backward",), 1.0)])
def test_with_the_pose_in_map_the_robot_drives_to_the_pose_before_it_first(sent, flags, side):
    assert main(["dock", "3", "1", str(math.pi / 2), "--distance", "0.5", *flags]) == 0
    staging, dock = sent
    assert staging.pose == pytest.approx((3.0, 1.0 + 0.5 * side, math.pi / 2))
    assert where(staging) == ("controller", "map", "")
    assert where(dock) == ("dock_controller", "dock", "")


@pytest.mark.parametrize(("flags", "x"), [((), -0.7), (("--backward", "--distance", "1"), 1.0)])
def test_undocking_is_a_goal_on_the_axis(sent, flags, x):
    assert main(["undock", *flags]) == 0
    assert sent[0].pose == (x, 0.0, 0.0)


def test_a_pose_that_is_none_is_refused_in_one_line(sent, capsys):
    assert main(["dock", "3", "1"]) == 1
    assert "three numbers, or none" in capsys.readouterr().err
    assert not sent
