"""Dead time of the odometry: each twist acts later than its message is stamped."""

import math

import numpy as np
import pytest

from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements import OdometryStep, PoseFix
from diffbot_control.filter.odometry_delay import DelayLine
from diffbot_control.filter.odometry_noise import MESSAGE, MOTION, OdometryConfig
from diffbot_control.filter.options import EKF, FilterConfig
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance

MS = 10**6
NOISE = TwistCovariance(0.01, 0.0, 0.02)


def twist_at(time):
    """The commanded twist of the 100 ms that end at ``time`` [ms]."""
    return Twist(0.4 + 0.2 * math.sin(time / 700.0), 0.8 * math.cos(time / 400.0))


def drive(delay, times, kind=MESSAGE, measurements=()):
    odometry = OdometryConfig(kind, odometry_delay=delay)
    found = Localization(LocalizationConfig(5.0, FilterConfig(filter=EKF, gate_probability=1.0), odometry))
    found.initialise(Pose(0.0, 0.0, 0.0), 1e-6 * np.eye(3), times[0] * MS)
    rows = []
    for time in times:
        rows.append(found.on_odometry(OdometryStep(time * MS, twist_at(time), NOISE)))
        for measurement in measurements:
            if measurement.stamp == time * MS:
                found.on_measurement(measurement)
    return found, rows


def dead_reckoning(delay, times):
    """Robot that at each millisecond has the twist of ``delay`` [ms] before; at first that of the first message."""
    x, y, theta, poses, now = 0.0, 0.0, 0.0, [], times[0]
    for time in times:
        while now < time:
            now += 1
            number = next((one for one in times[1:] if one + delay >= now), times[-1])
            v, omega = twist_at(number)
            x += v * 1e-3 * math.cos(theta + 0.5e-3 * omega)
            y += v * 1e-3 * math.sin(theta + 0.5e-3 * omega)
            theta += 1e-3 * omega
        poses.append((x, y, theta))
    return np.array(poses)


@pytest.mark.parametrize(("delay", "kind"), [(0, MESSAGE), (30, MOTION), (250, MESSAGE)])
def test_the_twist_acts_later_by_the_delay(delay, kind):
    times = [0, 100, 200, 310, 400, 480, 600, *range(700, 3000, 100)]
    _, rows = drive(delay * 1e-3, times, kind)
    assert [row.stamp for row in rows] == [time * MS for time in times]
    expected = dead_reckoning(delay, times)
    found = np.array([row.pose for row in rows])
    np.testing.assert_allclose(found[:, :2], expected[:, :2], atol=2e-3)
    np.testing.assert_allclose(np.unwrap(found[:, 2]), expected[:, 2], atol=1e-9)


def test_a_late_fix_gives_what_it_gives_on_time():
    times = list(range(0, 2000, 100))
    fix = PoseFix(730 * MS, Pose(0.2, 0.1, 0.3), np.diag([0.01, 0.01, 0.01]))
    late = fix._replace(stamp=730 * MS)
    punctual, _ = drive(0.25, times)
    reference = Localization(punctual.config)
    reference.initialise(Pose(0.0, 0.0, 0.0), 1e-6 * np.eye(3), 0)
    for time in times:
        if time == 800:
            reference.on_measurement(fix)
        reference.on_odometry(OdometryStep(time * MS, twist_at(time), NOISE))
    punctual.on_measurement(late)
    assert punctual.estimate().pose == reference.estimate().pose
    assert np.array_equal(punctual.estimate().P, reference.estimate().P)


def test_the_noise_of_a_message_is_parted_among_its_pieces():
    """With errors independent from message to message: var_theta is the sum of var_omega dt^2 over the messages."""
    times = list(range(0, 3000, 100))
    _, rows = drive(0.25, times)
    # 0.25 s are covered by the first message, which is only 0.1 s long; then whole messages and the half of one.
    whole = 0.02 * 0.1**2
    assert rows[-1].P[2, 2] - 1e-6 == pytest.approx(whole * 29.0, rel=1e-9)


def test_the_pieces_cover_each_interval_once():
    line, start = DelayLine(), 0
    for stamp in (100, 190, 320, 400, 500, 640):
        pieces = line.pieces(start, OdometryStep(stamp, Twist(0.0, float(stamp)), NOISE), 130)
        assert pieces[-1].odometry.stamp == stamp
        ends = [start, *(piece.odometry.stamp for piece in pieces)]
        assert ends == sorted(set(ends))
        start = stamp
    found = [(piece.odometry.stamp, piece.odometry.twist.omega, piece.whole) for piece in pieces]
    assert found == [(530, 400.0, 80), (630, 500.0, 100), (640, 640.0, 140)]
