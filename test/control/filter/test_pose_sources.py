"""Several sources of fixes, each with its own noise, correlation time and delay; and fixes without a heading."""

import math

import numpy as np
import pytest
from filter_input import fix
from filter_runs import Robot, gated_filter, winding, wrapped
from scipy.stats import chi2

from diffbot_control.filter.gate import ACCEPTED
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements import FIXES, PoseFix, PositionFix, Source
from diffbot_control.filter.measurements.fix import fix_of
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.filter.options import FilterConfig
from diffbot_control.filter.pose_sources import PoseSources
from diffbot_control.ros.messages.ekf import EkfInputs
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import BadMessageError, InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance
from diffbot_core.schema import build

TENTH = 10**8
CAMERA, GPS = np.array([0.17, 0.17, 0.1]), np.array([0.5, 0.5, 0.4])
C = 0.9
"""Correlation of neighbouring errors of the GPS, at 2 Hz."""
TIME = -0.5 / math.log(C)

SOURCES = Source(FIXES), Source("fixes of gps")


SEEDS = range(5)


class Drive:
    """40 s: odometry at 10 Hz, white fixes of a camera at 1 Hz, fixes of a GPS at 2 Hz whose errors last."""

    def __init__(self, seed, config, gps=True):
        rng = np.random.default_rng([seed, 5])
        self.found = Localization(config)
        truth, noise = np.zeros(3), rng.normal(0.0, GPS)
        self.nees, self.square = [], []
        for step in range(401):
            camera = truth + rng.normal(0.0, CAMERA)
            if step % 10 == 0:
                self.take(step, camera, CAMERA, 0)
            if step % 5 == 0:
                noise = C * noise + math.sqrt(1.0 - C * C) * rng.normal(0.0, GPS)
                if gps:
                    self.take(step, truth + noise, GPS, 1)
            estimate = self.found.on_odometry(OdometryStep(step * TENTH, *self.odometry))
            if step > 100:
                e = np.array(estimate.pose) - truth
                e[2] = math.remainder(e[2], 2.0 * math.pi)
                self.nees.append(e @ np.linalg.solve(estimate.P, e))
                self.square.append(e[0] ** 2 + e[1] ** 2)
            v, omega = 0.5 + rng.normal(0.0, 0.03), 0.2 + rng.normal(0.0, 0.03)
            middle = truth[2] + 0.05 * omega
            truth = truth + 0.1 * np.array([v * math.cos(middle), v * math.sin(middle), omega])

    odometry = Twist(0.5, 0.2), TwistCovariance(9e-4, 0.0, 9e-4)

    def take(self, step, z, sigmas, source):
        pose = Pose(z[0], z[1], math.remainder(z[2], 2.0 * math.pi))
        self.found.on_measurement(PoseFix(step * TENTH, pose, np.diag(sigmas**2), SOURCES[source]))


def config(time=TIME, **options):
    sources = PoseSources(("gps",), pose_source_correlation_time=(time,))
    return LocalizationConfig(filter=FilterConfig(filter="ekf", **options), sources=sources)


def together(**options):
    """Mean NEES and RMSE [m] of some drives."""
    drives = [Drive(seed, config(**options)) for seed in SEEDS]
    return np.mean([one.nees for one in drives]), math.sqrt(np.mean([one.square for one in drives])), drives


@pytest.fixture(scope="module")
def given():
    return together()


@pytest.fixture(scope="module")
def independent():
    return together(time=0.0)


@pytest.mark.study
def test_two_sources_of_different_noise_leave_the_covariance_honest(given, independent):
    assert 2.0 < given[0] < 4.0
    assert independent[0] > given[0] + 1.0  # the errors of the GPS taken as white
    alone = math.sqrt(np.mean([Drive(seed, config(), gps=False).square for seed in SEEDS]))
    # Such a GPS adds next to nothing to the camera; taken as white it does harm.
    assert given[1] < 1.02 * alone
    assert given[1] < 0.8 * independent[1]


def test_each_source_has_its_own_nis_and_whiteness(given, independent):
    values = given[2][0].found.monitor.values()
    assert float(values["NIS per number of fixes"]) == pytest.approx(1.0, abs=0.4)
    assert float(values["autocorrelation of fixes of gps"]) > 0.5
    assert abs(float(values["autocorrelation of fixes"])) < 0.4
    assert all(one.found.filter.fix_correlation() < 0.3 for one in independent[2]), "of global_pose"
    # Only the source whose correlation nobody gave raises the alarm.
    assert [one.found.correlated() for one in given[2]] == [[]] * len(SEEDS)
    assert [one.found.correlated() for one in independent[2]] == [["fixes of gps"]] * len(SEEDS)


def test_fixes_of_two_sources_are_no_duplicates_and_are_fused_in_their_order():
    results = []
    for order in ((0, 1), (1, 0)):
        found = Localization(config())
        found.on_measurement(PoseFix(0, Pose(0.0, 0.0, 0.0), np.eye(3)))
        found.on_odometry(OdometryStep(0, *Drive.odometry))
        for source in order:
            R = np.diag((GPS if source else CAMERA) ** 2)
            found.on_measurement(PoseFix(TENTH, Pose(0.3, 0.1, 0.0), R, SOURCES[source]))
            with pytest.raises(BadMessageError, match="duplicate"):
                found.on_measurement(PoseFix(TENTH, Pose(0.3, 0.1, 0.0), R, SOURCES[source]))
        results.append(found.on_odometry(OdometryStep(TENTH, *Drive.odometry)))
    assert results[0].pose == results[1].pose
    assert (results[0].P == results[1].P).all()


def message(variance):
    made = fix(5.0, 1.0, 0.0, 0.0)
    made.pose.covariance[[0, 7, 35]] = variance
    return made


NODE = {
    "pose_sources": ["gps", "uwb/pose"],
    "pose_source_sigma_xy": [0.0, 0.2],
    "pose_source_sigma_yaw": [0.0, 1000.0],
    "pose_source_delay": [0.25, 0.0],
}


def test_messages_get_the_deviations_and_the_delay_of_their_source():
    inputs = EkfInputs(build(EkfNodeConfig, NODE))
    (found,), uses_fallback, *_ = inputs.sensor("gps").read(message(0.5))
    assert (found.stamp, found.source, found.pose.x) == (4_750_000_000, Source("fixes of gps"), 1.0)
    assert found.R.tolist() == np.diag([0.5] * 3).tolist()
    assert not uses_fallback
    with pytest.raises(BadMessageError, match="covariance is zero"):
        inputs.sensor("gps").read(message(0.0))
    # A deviation of the heading that says nothing: the fix is one of the position.
    (found,), uses_fallback, *_ = inputs.sensor("uwb/pose").read(message(0.0))
    assert isinstance(found, PositionFix)
    assert (found.stamp, found.source) == (5_000_000_000, Source("fixes of uwb/pose"))
    np.testing.assert_allclose(found.R, np.diag([0.04, 0.04]))
    assert uses_fallback
    (found,), *_ = inputs.sensor("global_pose").read(message(0.5))
    assert found.source == Source(FIXES)


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ({"pose_sources": ["global_pose"]}, "pose_sources"),
        ({"pose_sources": ["gps"], "pose_source_delay": [0.1, 0.2]}, "pose_source_delay"),
        ({"pose_sources": ["gps"], "pose_source_delay": [1.5]}, "pose_source_delay"),
        ({"pose_sources": ["gps"], "filter": "ekf_fnn"}, "pose_sources"),
    ],
)
def test_settings_that_do_not_fit_are_refused(values, name):
    with pytest.raises(InvalidValueError) as caught:
        build(EkfNodeConfig, values)
    assert str(caught.value).startswith(name)
    assert "\n" not in str(caught.value)


R = np.diag([0.04, 0.04])


def position(robot, rng, stamp=0):
    x, y = robot.truth[:2] + rng.multivariate_normal(np.zeros(2), R)
    return PositionFix(stamp, x, y, R)


@pytest.mark.parametrize(("sigma", "kind"), [(math.pi, PositionFix), (0.99 * math.pi, PoseFix)])
def test_a_fix_is_a_position_if_its_heading_has_a_deviation_of_pi_or_more(sigma, kind):
    assert type(fix_of(5, Pose(1.0, 2.0, 3.0), np.diag([0.1, 0.2, sigma**2]))) is kind


@pytest.mark.study
def test_the_filter_starts_without_a_heading_finds_it_and_knows_its_errors():
    nees, ends, late = [], [], []
    for run in range(20):
        rng, robot = np.random.default_rng([1, run]), Robot(np.random.default_rng([2, run]))
        robot.truth = np.array([3.0, -2.0, wrapped(0.6 * run)])
        pose, P = position(robot, rng).restart(Pose(0.0, 0.0, 0.0))
        assert (pose.theta, P[2, 2], P[:2, :2].tolist()) == (0.0, math.pi**2, R.tolist())
        found, squares = gated_filter("ekf", pose, P, gate_probability=1.0), []
        for step in range(500):
            found.predict(robot.move(*winding(step)))
            if step % 5 == 0:
                assert found.take(position(robot, rng)) == ACCEPTED
                squares.append(found.nis)
        error = found.memory.belief.x[:3] - robot.truth
        error[2] = wrapped(error[2])
        nees.append(error @ np.linalg.solve(found.memory.belief.P, error))
        ends.append(abs(error[2]))
        late += squares[60:]
    assert max(ends) < 0.25
    # Two degrees of freedom, once the heading is known: within 14 % of 2, which is four deviations of the mean.
    assert len(late) == 20 * 40
    assert abs(np.mean(late) / 2.0 - 1.0) < 0.14
    low, high = chi2.ppf([1e-3, 1.0 - 1e-3], 3 * len(nees))
    assert low < sum(nees) < high
