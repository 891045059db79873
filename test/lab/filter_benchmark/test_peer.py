"""The comparison with robot_localization, with a runner that repeats the newest fix."""

import json
import math
import sys

import numpy as np
import pytest
from scipy import stats

from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_lab.benchmark_command import PEER
from diffbot_lab.filter_benchmark import peer, peer_drives, peer_filters
from diffbot_tools import cli

REPEATS_FIXES = """#!{python}
import csv, sys
with open(sys.argv[1]) as drive, open(sys.argv[2], "w") as out:
    fix = None
    for row in csv.reader(drive):
        if row[1] == "pose":
            fix = row[3:]
        elif fix and row[1] == "odom":
            x, y, yaw, xx, yy, tt = fix
            out.write(",".join([row[2], x, y, yaw, xx, "0", "0", yy, "0", tt]) + "\\n")
print("noise is fine", file=sys.stderr)
print("1.2.3 0.5", file=sys.stderr)
"""
NOMINAL = peer_drives.CASES[0]
DURATION = 60.0


def write_runner(folder, code):
    path = folder / "runner"
    path.write_text(code.format(python=sys.executable))
    path.chmod(0o755)
    return path


@pytest.fixture(scope="module")
def runner(tmp_path_factory):
    return write_runner(tmp_path_factory.mktemp("runner"), REPEATS_FIXES)


def test_the_peer_gets_every_message_and_is_judged_by_its_own_stamps(runner):
    drive = peer_drives.record_drive(NOMINAL, 5, DURATION)
    estimates, version = peer_filters.run_peer(runner, NOMINAL, drive, None)
    assert (version, estimates.cpu, len(estimates.steps)) == ("1.2.3", 0.5, len(drive.truth))
    found = peer.errors_of(estimates, drive)
    # A fix each 0.2 s, with its error and what has been driven since; the latter is small beside the first.
    errors = [one.content for one in drive.events if type(one.content).__name__ == "PoseFix"]
    truth = [drive.truth[round((one.stamp - 10**15) / 2e7)] for one in errors]
    squares = [(one.pose.x - t[0]) ** 2 + (one.pose.y - t[1]) ** 2 for one, t in zip(errors, truth, strict=True)]
    assert found.position == pytest.approx(math.sqrt(np.mean(squares)), rel=0.25)
    assert found.cpu == pytest.approx(0.5 / len(drive.truth))


def test_errors_are_those_of_a_known_offset():
    drive = peer_drives.record_drive(NOMINAL, 5, DURATION)
    steps = np.arange(len(drive.truth))
    poses = drive.truth + np.array((0.3, -0.4, 2.0 * math.pi + 0.1))
    P = np.tile(np.diag((0.09, 0.16, 0.0025)), (len(steps), 1, 1))
    found = peer.errors_of(peer_filters.Estimates(steps, poses, P, 1.0), drive)
    assert found[:3] == pytest.approx((0.5, 0.1, 1.0 + 1.0 + 4.0))


def test_means_and_ratios_have_students_interval():
    values = [0.8, 1.1, 1.3, 0.9, 1.2]
    expected = stats.ttest_1samp(values, 0.0).confidence_interval(0.95)
    assert peer.interval_of(values) == pytest.approx([np.mean(values), *expected])
    assert peer.ratio_of([2.0, 2.0, 2.0], [1.0, 1.0, 1.0]) == pytest.approx([2.0, 2.0, 2.0])
    assert peer.interval_of([3.0]) == [3.0, -math.inf, math.inf]


def test_the_settings_name_what_each_message_is_used_for():
    gyro = next(case for case in peer_drives.CASES if case.sensors.gyro_rate > 0.0)
    settings = peer_filters.peer_settings(gyro, peer_filters.PeerNoise(1.0, 2.0, 3.0, 4.0, 5.0))["ekf_filter_node"][
        "ros__parameters"
    ]
    # robot_localization: x y z, roll pitch yaw, their velocities, accelerations.
    names = ["x", "y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz", "vroll", "vpitch", "vyaw", "ax", "ay", "az"]
    used = {key: {n for n, on in zip(names, settings[key], strict=True) if on} for key in settings if "_config" in key}
    assert used == {"pose0_config": {"x", "y", "yaw"}, "odom0_config": {"vx", "vy", "vyaw"}, "imu0_config": {"vyaw"}}
    noise = dict(zip(names, settings["process_noise_covariance"], strict=True))
    assert (noise["x"], noise["y"], noise["yaw"], noise["vx"], noise["vyaw"]) == (1.0, 1.0, 2.0, 3.0, 4.0)
    assert settings["pose0_rejection_threshold"] == 5.0
    assert (
        "process_noise_covariance" not in peer_filters.peer_settings(gyro, None)["ekf_filter_node"]["ros__parameters"]
    )


def test_the_whole_comparison(runner):
    results = peer.run_benchmark(runner, 2, 1, ("nominal",), 40.0)
    (case,) = results["cases"]
    assert (results["peer"], case["name"], case["noise"]["gate"]) == ("robot_localization 1.2.3", "nominal", 1e9)
    assert case["ratio"]["position"][0] < 0.5
    low, high = case["ratio"]["position"][1:]
    assert low < case["ratio"]["position"][0] < high
    json.dumps(results, allow_nan=False)
    assert peer.table(results).count("\n") == 2


def test_errors_are_one_line(runner, tmp_path, capsys):
    broken = write_runner(tmp_path, "#!/bin/sh\necho first >&2; echo no such parameter >&2; exit 3\n")
    with pytest.raises(DiffbotError, match=f"runner: {broken} ended with 3: no such parameter"):
        peer_filters.run_peer(broken, NOMINAL, peer_drives.record_drive(NOMINAL, 1, 1.0), None)
    with pytest.raises(InvalidValueError, match="case = 'moon': must be one of nominal, "):
        peer.run_benchmark(runner, 1, 1, ("moon",))
    with pytest.raises(InvalidValueError, match="seed = 990: "):
        peer.run_benchmark(runner, 20, 990)
    assert cli.main(["benchmark", PEER]) == 1
    assert capsys.readouterr().err == f"diffbot: benchmark: {PEER} needs --runner, the others take none\n"
