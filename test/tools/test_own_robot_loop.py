"""A robot of the user in a closed loop: describe it, drive a plant that differs, calibrate, drive again."""

import math

import graph
import numpy as np
import pytest

from diffbot_control.ros.goals.client import GoalClient
from diffbot_core.geometry import Pose
from diffbot_core.yaml_files import values_for
from diffbot_tools import cli
from diffbot_tools.bringup import REQUIRED
from diffbot_tools.view.bag_source import read_bag

pytestmark = [pytest.mark.graph, pytest.mark.study]

GOALS = [(2.0, 0.0, 0.0), (2.0, 2.0, 0.5 * math.pi), (0.0, 2.0, math.pi), (0.0, 0.0, -0.5 * math.pi)]
DESCRIBED = {
    "fix-rate": 2.0, "pose-correlation": 0.0, "global-pose-sigma-xy": 0.02, "xy-goal-tolerance": 0.25,
    "linear-x-max-velocity": 0.5,
}  # fmt: skip
TRUTH = {"wheel_separation": 0.245, "left_radius_error": 0.08, "command_latency": 0.3, "eps_xy_max": 0.16}
"""Parameters of the plant. The description says 0.233 m, 0.01, 0.12 s, and poses with a deviation of 0.02 m."""


def drive(folder, name, parameters):
    """Drive to GOALS; return the error of the estimated heading at each of its times [rad], and how the goals ended."""
    truth, bag = folder / "truth.yaml", folder / name
    truth.write_text(
        "/**/plant:\n  ros__parameters:\n" + "".join(f"    {key}: {value}\n" for key, value in TRUTH.items())
    )
    files = ("--params-file", str(parameters), "--params-file", str(truth))
    values = ("-p", "clock:=lockstep", "-p", "use_sim_time:=true", "-p", "plant:use_sim_time:=false")
    words = (*files, *values, "-p", f"recorder:uri:={bag}")
    with graph.diffbot("run", "robot", "--with", "plant", "recorder", "--ros-args", *words) as process:
        process.wait_for_output("[recorder]: ready")
        client = GoalClient.in_own_context()
        try:
            for goal in GOALS:
                client.send_goal([Pose(*goal)], timeout=graph.PATIENCE)
                graph.wait_for(lambda: client.wait_for_end(1.0), what="the end of the goal")
        finally:
            client.close()
        assert process.stop() == 0
    (robot,) = read_bag(bag).robots
    return robot.curves["error"]["theta"], [one.end for one in robot.outcomes]


def test_the_drive_after_the_calibration_has_smaller_errors(tmp_path, kept_signal_handlers, capsys):
    mine, calibrated = tmp_path / "mine.yaml", tmp_path / "calibrated.yaml"
    flags = [word for name, value in DESCRIBED.items() for word in (f"--{name}", str(value))]
    assert cli.main(["robot", "new", str(mine), "--like", "turtlebot4", *flags]) == 0
    before, _ = drive(tmp_path, "first", mine)
    assert cli.main(["calibrate", str(tmp_path / "first"), "--params", str(mine), "--out", str(calibrated)]) == 0
    values = values_for(calibrated, "controller")
    assert set(REQUIRED) <= set(values), "the data sheet is still in the file"
    assert values["command_latency"] == pytest.approx(TRUTH["command_latency"], abs=0.06)
    after, ends = drive(tmp_path, "second", calibrated)
    assert ends == ["reached"] * len(GOALS)
    # With 13 other sequences of noise, the ratio was 0.51 to 0.83. That of positions was 0.59 to 1.02.
    assert np.sqrt(np.mean(after**2)) < 0.95 * np.sqrt(np.mean(before**2))
