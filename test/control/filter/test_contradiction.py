"""Fixes that no odometry agrees with: a robot that drives by them is stopped; outliers and a kidnapping are not."""

import math

import numpy as np
import pytest

from diffbot_control.filter.contradiction import FROZEN, RELOCATING
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements import PoseFix
from diffbot_control.filter.odometry import OdometryStep
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance

SIGMAS = np.array([0.1, 0.1, 0.05])
FAULTS = {
    "turned by pi": lambda x, y, theta, _: (x, y, theta + math.pi),
    "mirrored": lambda x, y, theta, _: (x, -y, -theta),
    "swapped": lambda x, y, theta, _: (y, x, theta),
    "frozen": lambda *_: (0.0, 0.0, 0.0),
}


def drive(seconds, fault=lambda x, y, theta, _: (x, y, theta), *, outliers=0.0, rest_after=math.inf, every=2):
    """Drive a winding path at 0.5 m/s with 20 Hz and a fix with ``every`` so many; yield time and filter."""
    rng, made = np.random.default_rng(3), Localization(LocalizationConfig())
    x = y = 0.0
    theta = 0.3
    for n in range(round(20 * seconds)):
        time, stamp = n / 20, n * 50_000_000
        moves = 1.0 < time < rest_after
        twist = Twist(0.5, 0.3 * math.sin(time / 3)) if moves else Twist(0.0, 0.0)
        theta += twist.omega / 20
        x, y = x + twist.v / 20 * math.cos(theta), y + twist.v / 20 * math.sin(theta)
        if n % every == 0:
            fix = np.array(fault(x, y, theta, time))
            if fault is not FAULTS["frozen"]:
                fix += rng.normal(0.0, SIGMAS) + (rng.random() < outliers) * rng.normal(0.0, 3.0, 3)
            made.on_measurement(PoseFix(stamp, Pose(*fix[:2], math.remainder(fix[2], math.tau)), np.diag(SIGMAS**2)))
        if n % 10 == 9:
            made.check_innovations()
        made.on_odometry(OdometryStep(stamp, twist, TwistCovariance(1e-4, 0.0, 1e-4)))
        yield time, made


@pytest.mark.parametrize(("fault", "every"), [*((fault, 1) for fault in FAULTS), ("frozen", 2)])
def test_fixes_that_contradict_the_odometry_are_found_while_driving(fault, every):
    story = drive(40.0, FAULTS[fault], every=every)
    found = next((time, made.contradiction.cause) for time, made in story if made.contradiction.cause)
    assert found[1] == (FROZEN if fault == "frozen" else RELOCATING)
    assert found[0] < 20.0


@pytest.mark.parametrize("outliers", [0.0, 0.3])
def test_noise_outliers_and_a_kidnapping_are_no_contradiction(outliers):
    carried = [
        made.contradiction.cause
        for _, made in drive(40.0, lambda x, y, theta, time: (x + 5.0 * (time > 10.0), y, theta), outliers=outliers)
    ]
    assert set(carried) == {""}


def test_a_contradiction_ends_after_a_minute_of_rest_or_by_a_pose_set_by_hand():
    story = [made.contradiction.cause for _, made in drive(100.0, FAULTS["turned by pi"], rest_after=5.0)]
    began = story.index(RELOCATING)
    assert story[-1] == ""
    assert 1200 <= story.index("", began) - began <= 1300
    *_, (_, made) = drive(10.0, FAULTS["turned by pi"])
    assert made.contradiction.cause == RELOCATING
    made.initialise(Pose(0.0, 0.0, 0.0), np.diag(SIGMAS**2))
    assert made.contradiction.cause == ""
