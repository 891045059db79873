"""Causes of a missed goal: each fault of a drive is found in its curves and named."""

import numpy as np
import pytest

from diffbot_control.law.registry import PRESETS
from diffbot_core.kinematics import WheelGeometry
from diffbot_tools.view.causes import causes
from diffbot_tools.view.texts import ERROR, WARNING

TIME = np.linspace(0.0, 20.0, 201)


def drive():
    """Return the curves of a drive along x at 0.5 m/s with random fixes of 5 cm."""
    rng = np.random.default_rng(3)
    speeds = {"v": np.full(201, 0.5), "omega": np.zeros(201)}
    path = {"t": TIME, "x": 0.5 * TIME, "y": 0.0 * TIME, "theta": 0.0 * TIME}
    noise = {name: path[name] + 0.05 * rng.standard_normal(201) for name in ("x", "y", "theta")}
    fixes, odometry, truth = {"t": TIME} | noise, path | speeds, path | speeds
    return {"truth": truth, "odometry": odometry, "estimate": path, "fixes": fixes, "command": {"t": TIME} | speeds}


def found(curves):
    return causes(curves, 2.0, 18.0, PRESETS["tuned"].config, WheelGeometry(0.05, 0.6))


def test_a_drive_without_a_fault_has_no_cause():
    assert found(drive()) == []


@pytest.mark.parametrize(
    ("role", "begin", "end", "words"),
    [
        ("fixes", 5.05, 9.95, "No fix for 5.0 s"),
        ("estimate", 0.0, 7.05, "No pose from the filter for 5.1 s"),
        ("command", 5.05, 6.95, None),
    ],
)
def test_a_topic_without_messages_is_named_and_a_short_gap_is_not(role, begin, end, words):
    curves = drive()
    is_kept = (curves[role]["t"] < begin) | (curves[role]["t"] > end)
    curves[role] = {name: values[is_kept] for name, values in curves[role].items()}
    assert found(curves) == ([(WARNING, words)] if words else [])


def test_a_wheel_that_stands_still_is_named():
    curves = drive()
    late = TIME > 10.0
    # The left wheel stands. The right wheel drives on, so the robot turns left at half the speed.
    for role in ("odometry", "truth"):
        curves[role] = curves[role] | {"v": np.where(late, 0.25, 0.5), "omega": np.where(late, 0.5 / 0.6, 0.0)}
    assert found(curves) == [(ERROR, "The left wheel did not turn: 0.50 m/s commanded, 0.00 measured")]


def test_a_wheel_that_slips_is_named():
    curves = drive()
    late = TIME > 15.05
    # The right wheel turns at 0.5 m/s and moves the robot by 0.2 m/s.
    curves["truth"] = curves["truth"] | {"v": np.where(late, 0.35, 0.5), "omega": np.where(late, -0.3 / 0.6, 0.0)}
    ((level, text),) = found(curves)
    assert level == ERROR
    assert text.startswith("The right wheel slipped for ")
    assert float(text.split()[-2]) == pytest.approx(3.0, abs=0.15)


def test_wrong_fixes_are_named_with_their_mean_error():
    curves = drive()
    fixes = curves["fixes"]
    curves["fixes"] = fixes | {"y": fixes["y"] + 0.4, "theta": fixes["theta"] + np.pi}
    assert found(curves) == [(ERROR, "The fixes were 0.40 m and 180 deg off the truth")]


def test_headings_of_fixes_that_say_nothing_are_no_cause():
    curves = drive()
    for seed in range(5):
        headings = np.random.default_rng(seed).uniform(-np.pi, np.pi, 201)
        curves["fixes"] = curves["fixes"] | {"theta": headings}
        assert found(curves) == []
    curves["fixes"] = curves["fixes"] | {"theta": np.full(201, np.nan), "y": curves["fixes"]["y"] + 0.4}
    assert found(curves) == [(ERROR, "The fixes were 0.40 m off the truth")]
    curves = drive()
    curves["truth"] = curves["truth"] | {"theta": np.full(201, 1.5), "tt": np.full(201, 1e6)}
    assert found(curves) == []
