"""Motion by odometry: noise at different rates, dead time, gaps, gyro, and the reported twist."""

import math

import numpy as np
import pytest
from filter_runs import SEPARATION, body_twist, build_motion

from diffbot_control.filter import state
from diffbot_control.filter.config import EKF, FNN, FilterConfig, LocalizationConfig
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.measurement import GyroSample, heading, pose_fix
from diffbot_control.filter.models import NO_RATE, WHEELS, TurnRate
from diffbot_control.filter.odometry import MESSAGE, MOTION, Densities, OdometryConfig, OdometryStep
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance

MS = 10**6
UNKNOWN, SMALL = TwistCovariance(0.0, 0.0, 0.0), TwistCovariance(1e-8, 0.0, 1e-8)
NOISE = OdometryConfig(MOTION, densities=Densities(0.02, 0.004, 0.03, density_xy=1e-3, density_theta=2e-4))


def started(odometry, pose=(0.0, 0.0, 0.0), variance=1e-12, max_extrapolation=math.inf, **values):
    config = LocalizationConfig(60.0, FilterConfig(**{"filter": EKF, **values}), odometry)
    found = Localization(config, SEPARATION, max_extrapolation)
    found.initialise(Pose(*pose), variance * np.eye(3), 0)
    return found


def covariance_after(twist, rate, seconds, odometry, covariance=UNKNOWN, **values):
    """Return the covariance (3, 3) of the pose after a drive with a constant twist from a known pose."""
    found = started(odometry, (0.0, 0.0, 0.3), **values)
    for number in range(1, round(seconds * rate) + 1):
        found.on_odometry(OdometryStep(round(number * 1e9 / rate), twist, covariance))
    return found.estimate().P


@pytest.mark.parametrize("variant", [EKF, FNN])
@pytest.mark.parametrize("kind", [MOTION, MESSAGE])
def test_the_noise_of_a_motion_does_not_depend_on_the_rate_of_the_messages(variant, kind):
    # The messages have no covariance, so the densities are used for both kinds.
    noise = NOISE._replace(odometry_noise=kind)
    reference = covariance_after(Twist(0.6, 0.5), 100.0, 3.0, noise, filter=variant)
    for rate in (5.0, 20.0):
        found = covariance_after(Twist(0.6, 0.5), rate, 3.0, noise, filter=variant)
        np.testing.assert_allclose(found, reference, rtol=0.01, atol=1e-4)


def test_densities_are_variances_per_second_and_covariances_of_messages_belong_to_the_mean_twist():
    def variances(odometry, covariance):
        P = covariance_after(Twist(-0.5, 0.0), 20.0, 4.0, odometry, covariance)
        c, s = math.cos(0.3), math.sin(0.3)
        T = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        return np.diag(T @ P @ T.T)

    # Densities of NOISE at 0.5 m/s: 0.03 |v| + 1e-3 along, 1e-3 across, 0.004 |v| + 2e-4 of the heading.
    across = 4.0 * 1e-3 + 0.5**2 * 2.2e-3 * 4.0**3 / 3.0
    assert variances(NOISE, UNKNOWN) == pytest.approx((4.0 * 0.016, across, 4.0 * 2.2e-3), rel=1e-6)
    along, _, heading = variances(OdometryConfig(), TwistCovariance(0.02, 0.0, 0.03))
    assert (along, heading) == pytest.approx((80 * 0.02 * 0.05**2, 80 * 0.03 * 0.05**2), rel=1e-6)
    scaled = covariance_after(Twist(-0.5, 0.0), 20.0, 4.0, OdometryConfig(odometry_covariance_scale=9.0), SMALL)
    np.testing.assert_allclose(scaled[2, 2], 80 * 9e-8 * 0.05**2, rtol=1e-2)


def twist_at(time):
    """Return the commanded twist of the 100 ms that end at ``time`` [ms]."""
    return Twist(0.4 + 0.2 * math.sin(time / 700.0), 0.8 * math.cos(time / 400.0))


def drive(delay, times, kind=MESSAGE):
    found, noise = started(OdometryConfig(kind, odometry_delay=delay), variance=1e-6), TwistCovariance(0.01, 0.0, 0.02)
    return [found.on_odometry(OdometryStep(time * MS, twist_at(time), noise)) for time in times]


def dead_reckoning(delay, times):
    """Return the poses of a robot that executes each twist ``delay`` [ms] later, and at first the first twist."""
    x, y, theta, poses, now = 0.0, 0.0, 0.0, [], 0
    for time in times:
        while now < time:
            now += 1
            v, omega = twist_at(next((one for one in times if one + delay >= now), times[-1]))
            x += v * 1e-3 * math.cos(theta + 0.5e-3 * omega)
            y += v * 1e-3 * math.sin(theta + 0.5e-3 * omega)
            theta += 1e-3 * omega
        poses.append((x, y, theta))
    return np.array(poses)


@pytest.mark.parametrize(("delay", "kind"), [(0, MESSAGE), (30, MOTION), (250, MESSAGE)])
def test_the_twist_acts_after_the_delay(delay, kind):
    times = [100, 200, 310, 400, 480, 600, *range(700, 3000, 100)]
    rows = drive(delay * 1e-3, times, kind)
    assert [row.stamp for row in rows] == [time * MS for time in times]
    found, expected = np.array([row.pose for row in rows]), dead_reckoning(delay, times)
    np.testing.assert_allclose(found[:, :2], expected[:, :2], atol=2e-3)
    np.testing.assert_allclose(np.unwrap(found[:, 2]), expected[:, 2], atol=1e-9)


def test_the_parts_of_a_delayed_message_have_the_noise_of_the_message():
    rows = drive(0.25, list(range(100, 3000, 100)))
    # Sum of var_omega dt^2 over the messages. The first message, of 0.1 s, acts for 0.35 s, the last for 0.05 s.
    assert rows[-1].P[2, 2] - 1e-6 == pytest.approx(0.02 * 0.1**2 * 29.0, rel=1e-9)


@pytest.mark.parametrize("rate", [0.1, 0.9])
def test_measurements_within_a_step_do_not_change_the_noise_of_wheels_gyro_and_slip(rate):
    variances = []
    for cuts in ((), (20, 50)):
        found = started(OdometryConfig(), use_gyro=True)
        found.on_gyro(GyroSample(100 * MS, rate, 0.003))
        for cut in cuts:
            found.on_measurement(heading(cut * MS, 0.0, 1e9 * np.eye(1)))
        found.on_odometry(OdometryStep(100 * MS, Twist(0.5, 0.1), TwistCovariance(0.02, 0.0, 0.005)))
        variances.append(found.filter.P[[0, 2], [0, 2]])
        assert found.slips == (rate == 0.9)
    np.testing.assert_allclose(*variances, rtol=1e-3)


def after_a_gap(seconds, fixes=(), gyro=False):
    """Return the estimate after odometry with (0.5, 0.2) at 1 s and with (0.4, 0.1) ``seconds`` later."""
    found = started(OdometryConfig(), variance=1e-4, max_extrapolation=1.0, use_gyro=gyro)
    found.on_odometry(OdometryStep(10**9, Twist(0.5, 0.2), SMALL))
    for one in fixes:
        (found.on_gyro if gyro else found.on_measurement)(one)
    return found.on_odometry(OdometryStep(round((1.0 + seconds) * 1e9), Twist(0.4, 0.1), SMALL))


def test_after_a_gap_the_twist_acts_for_max_extrapolation_and_the_rest_adds_uncertainty():
    after, short = after_a_gap(61.0), after_a_gap(1.0)
    assert after.pose == pytest.approx(short.pose, abs=1e-9), "the twist acts for one second, not 61"
    assert short.pose.theta == pytest.approx(0.2 + 0.1, abs=1e-6)
    # In 60 s the faster twist leads 30 m in any direction, with any heading.
    x, y, theta = np.sqrt(np.diag(after.P))
    assert theta == pytest.approx(math.pi, rel=1e-3)
    assert min(x, y) >= 29.9
    assert np.sqrt(np.diag(short.P)).max() < 0.1


@pytest.mark.parametrize("seconds", [0.3, 0.5, 0.7])
def test_odometry_after_exactly_max_extrapolation_has_no_gap(seconds):
    found = started(OdometryConfig(), max_extrapolation=seconds)
    after = found.on_odometry(OdometryStep(round(seconds * 1e9), Twist(0.4, 0.0), SMALL))
    assert after.pose.x == pytest.approx(0.4 * seconds)
    assert after.P[0, 0] < 1e-6


def test_fixes_and_turn_rates_in_a_gap_are_fused_at_their_stamps():
    after = after_a_gap(61.0, [pose_fix(31 * 10**9, Pose(7.0, 3.0, 0.2), 1e-4 * np.eye(3))])
    # After the fix, 30 s of the gap remain, and then the twist acts for one second.
    assert math.hypot(after.pose.x - 7.0, after.pose.y - 3.0) == pytest.approx(0.4, abs=0.01)
    assert math.sqrt(after.P[2, 2]) == pytest.approx(math.pi / math.sqrt(2.0), rel=0.02)
    turned = after_a_gap(11.0, [GyroSample(2 * 10**9 + n * 10**8, 0.1, 1e-6) for n in range(95)], gyro=True)
    assert turned.pose.theta == pytest.approx(0.2 + 10 * 0.1 + 0.1, abs=0.05)


def test_a_gap_of_the_odometry_does_not_contradict_the_gyro():
    found = started(OdometryConfig(), max_extrapolation=0.5, use_gyro=True)
    for number in range(1, 101):
        found.on_gyro(GyroSample(100 * MS * number, 0.5, 1e-4))
        if number < 11 or number == 100:
            found.on_odometry(OdometryStep(100 * MS * number, Twist(0.4, 0.5), SMALL))
    assert found.turns.contradiction() == ""


@pytest.mark.parametrize("as_configured", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("use_gyro", [False, True])
def test_the_reported_twist_is_the_motion_of_the_reported_pose(as_configured, use_gyro):
    found = started(
        OdometryConfig(), filter="ekf_calibrating", wheels_as_configured=as_configured, use_gyro=use_gyro, variance=0.01
    )
    # Small compared with the initial deviations, but large enough for both hypotheses to have a weight.
    errors = np.array([0.006, 0.008, 0.01])
    state.set_errors(found.filter, found.options, WHEELS, errors, np.diag([0.005, 0.005, 0.01]) ** 2)
    M, rate = TwistCovariance(4e-3, 1e-3, 0.02), TurnRate(0.7, 1e-4) if use_gyro else NO_RATE
    if use_gyro:
        found.on_gyro(GyroSample(100 * MS, *rate))
    before, step = found.estimate().pose, OdometryStep(100 * MS, Twist(1.2, 0.7), M)
    after = found.on_odometry(step)
    twist, covariance = found.twist_of(after, step)
    expected, M_expected = body_twist(after.x, build_motion(1.2, 0.7, 0.1, *M, rate=rate))
    np.testing.assert_allclose(twist, expected, rtol=1e-9)
    np.testing.assert_allclose(covariance, M_expected[[0, 0, 1], [0, 1, 1]], rtol=1e-9)
    middle = before.theta + 0.05 * twist.omega
    way = 0.1 * twist.v * np.array([math.cos(middle), math.sin(middle)])
    np.testing.assert_allclose(np.subtract(after.pose[:2], before[:2]), way, atol=3e-6)
    assert after.pose.theta - before.theta == pytest.approx(0.1 * twist.omega, abs=2e-6)
    low, high = {0.0: (1.0, 1.0), 0.5: (0.2, 0.8), 1.0: (0.0, 0.0)}[as_configured]
    share = after.x[3:6] / found.filter.x[3:6]
    assert (share >= low - 1e-9).all()
    assert (share <= high + 1e-9).all()
    without = OdometryStep(200 * MS, Twist(1.2, 0.7), UNKNOWN)
    assert found.twist_of(found.on_odometry(without), without)[1] == UNKNOWN, "an unknown covariance stays unknown"


def test_a_wheel_that_slips_is_counted_and_the_heading_follows_the_gyro():
    found = started(OdometryConfig(), filter="ekf_calibrating", use_gyro=True)
    for number in range(1, 31):
        slips = 10 < number <= 20
        found.on_gyro(GyroSample(number * 100 * MS, 0.8 if slips else 0.0, 1e-6))
        estimate = found.on_odometry(OdometryStep(number * 100 * MS, Twist(0.3, 0.0), SMALL))
        assert found.slips == min(max(number - 10, 0), 10)
        assert found.slipping == pytest.approx(0.1 * (number - 10) if slips else 0.0)
    assert estimate.pose.theta == pytest.approx(0.8, abs=0.05)
    # Slip adds a variance of (L / 2 0.8 rad/s 0.1 s)^2 along in each of the ten steps.
    assert 0.5 < estimate.P[0, 0] / (10 * (0.3 * 0.8 * 0.1) ** 2) < 1.5


def test_the_variant_of_the_filter_cannot_be_changed_at_runtime_but_other_parameters_can():
    found = started(OdometryConfig(), filter="ekf_calibrating")
    state.set_errors(found.filter, found.options, WHEELS, np.array([0.0, 0.1, 0.0]), 1e-6 * np.eye(3))
    found.configure(LocalizationConfig(1.0, FilterConfig(filter=EKF, relocation_fixes=7)), 0.3)
    assert (found.config.filter.filter, found.options.relocation_fixes) == ("ekf_calibrating", 7)
    # The right wheel is 10 % larger: 0.1 m/s / 0.3 m for 0.1 s.
    found.on_odometry(OdometryStep(100 * MS, Twist(1.0, 0.0), SMALL))
    assert found.filter.x[2] == pytest.approx(0.1 / 0.3 * 0.1, rel=1e-3)


@pytest.mark.parametrize(
    ("number", "variance", "kind"),
    [
        (30, 1.0, "duplicate"),
        (-40, 1.0, "too old"),
        (32, 1.0, "no odometry at its stamp"),
        (31, math.inf, "not finite"),
    ],
)
def test_an_unusable_turn_rate_is_refused_without_a_change_of_the_filter(number, variance, kind):
    found, unused, tenth = started(OdometryConfig(), use_gyro=True), started(OdometryConfig()), 100 * MS
    for step in range(1, 31):
        found.on_gyro(GyroSample(step * tenth, 0.1, 1e-4))
        found.on_odometry(OdometryStep(step * tenth, Twist(0.5, 0.1), SMALL))
    before = found.filter.memory.copy()
    for extra in range(10_000 if number == 32 else 0):
        found.on_gyro(GyroSample(31 * tenth + extra, 0.1, 1e-4))
    with pytest.raises(BadMessageError, match=kind):
        found.on_gyro(GyroSample(number * tenth, 0.1, variance))
    np.testing.assert_array_equal(found.filter.memory, before)
    found.reset()
    for one, reason in ((found, "no odometry yet"), (unused, "not used")):
        with pytest.raises(BadMessageError, match=reason):
            one.on_gyro(GyroSample(tenth, 0.1, 1e-4))
