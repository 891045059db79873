"""How long the errors of sensors last, which the filter finds out: its covariance stays honest."""

import math
from dataclasses import replace

import numpy as np
import pytest
from filter_runs import R_FIX, SEPARATION, Robot, fix, gated_filter, landmark, numbers_of, wrapped

from diffbot_control.filter.fix_correlation import correlation_of, new_fix_correlation
from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.landmark_correlation import NO_PAIRS, Pair, with_pair
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_control.ros.messages.ekf import error_values
from diffbot_core.geometry import Pose
from diffbot_core.units import NS_PER_S

DT = 0.2
"""[s] from fix to fix, and between measurements of a landmark"""
PLACES = (4.0, 4.0), (-4.0, 4.0), (-4.0, -4.0), (4.0, -4.0), (0.0, 7.0)
SIGMAS = np.array((0.06, 0.03))


class Run:
    """What remains of a drive: the filter, and NEES of the pose and squared errors of the position [m^2]."""

    def __init__(self, found, robot):
        self.found, self.robot, self.nees, self.square = found, robot, [], []

    def note(self):
        belief = self.found.memory.belief
        e = belief.x[:3] - self.robot.truth
        e[2] = wrapped(e[2])
        self.nees.append(e @ np.linalg.solve(belief.P[:3, :3], e))
        self.square.append(e[0] ** 2 + e[1] ** 2)


def by_fixes(c, seed, **options):
    """40 s at 10 Hz with a fix at 5 Hz, noted after 10 s; ``c`` is the correlation of a fix's errors with the last."""
    rng = np.random.default_rng(seed)
    found, robot = gated_filter("ekf", **options), Robot(rng, noise=0.06)
    sigmas, noise = np.sqrt(R_FIX.diagonal()), rng.normal(size=3)
    robot.truth = -sigmas * noise  # the filter starts at the first fix, which is coloured, too
    run = Run(found, robot)
    for step in range(400):
        found.predict(robot.move(0.5 + 0.2 * math.sin(0.05 * step), 0.4 * math.sin(0.03 * step + 0.01)))
        if step % 2 == 0:
            noise = c * noise + math.sqrt(1.0 - c * c) * rng.normal(size=3)
            x, y, theta = robot.truth + sigmas * noise
            found.take(fix(x, y, wrapped(theta)))
        if step >= 100:
            run.note()
    return run


def by_landmarks(c, seed, **options):
    """40 s at 5 Hz, all landmarks at each step, noted after 16 s."""
    rng = np.random.default_rng(seed)
    robot = Robot(rng, noise=0.06, dt=DT)
    robot.truth = np.array((1.0, 0.0, 3.0))
    found = GatedFilter(options_of(FilterConfig(**options), landmarks=True), SEPARATION)
    found.reset_to(Pose(*robot.truth), 1e-4 * R_FIX)
    run, errors = Run(found, robot), rng.normal(size=(len(PLACES), 2))
    for step in range(1, 200):
        found.predict(robot.move(0.5, 0.3))
        errors = c * errors + math.sqrt(1.0 - c * c) * rng.normal(size=errors.shape)
        for place, error in zip(PLACES, errors, strict=True):
            seen = landmark(robot.truth, place, np.diag(SIGMAS**2))
            distance, bearing = (numbers_of(seen) + SIGMAS * error).tolist()
            stamp = round(step * DT * NS_PER_S)
            found.take(replace(seen, stamp=stamp, range=distance, bearing=wrapped(bearing)))
        if step >= 80:
            run.note()
    return run


def correlation_found(run):
    factor, time = run.found.memory.fix_correlation.inflation, run.found.memory.landmarks.means.time
    return math.exp(-DT / time) if time else (factor - 1.0) / (factor + 1.0)


def together(drive, c, **options):
    """Mean NEES and RMSE [m] over eight runs by fixes or two by landmarks, and the mean correlation found."""
    done = [drive(c, seed, **options) for seed in range(8 if drive is by_fixes else 2)]
    found = np.mean([correlation_found(one) for one in done])
    return np.mean([one.nees for one in done]), math.sqrt(np.mean([one.square for one in done])), found


@pytest.mark.study
@pytest.mark.parametrize(
    ("drive", "c", "within", "most", "blind"),
    [
        (by_fixes, 0.5, 0.2, 6.0, 5.0),
        (by_fixes, 0.9, 0.2, 6.0, 12.0),
        (by_landmarks, math.exp(-DT / 3.0), 0.02, 5.0, 12.0),
    ],
)
def test_the_covariance_is_honest_with_errors_that_last(drive, c, within, most, blind):
    nees, rmse, found = together(drive, c)
    without, rmse_without, _ = together(drive, c, detect_correlation=False)
    assert 1.0 < nees < most
    assert without > blind
    assert rmse < 1.05 * rmse_without
    assert found == pytest.approx(c, abs=within)


@pytest.mark.study
@pytest.mark.parametrize(("drive", "most"), [(by_fixes, 0.05), (by_landmarks, 0.13)])
def test_with_independent_errors_nothing_changes(drive, most):
    nees, rmse, found = together(drive, 0.0)
    without, rmse_without, _ = together(drive, 0.0, detect_correlation=False)
    assert nees == pytest.approx(without, rel=0.1)
    assert rmse == pytest.approx(rmse_without, rel=0.02)
    assert found < most


def test_what_was_found_survives_a_relocation_but_no_reset_and_is_not_sought_where_it_is_given():
    for options in ({"detect_correlation": False}, {"fix_correlation_time": 1.0}, {"filter": "ekf_fnn"}):
        assert not options_of(FilterConfig(**options)).detects_fix_correlation
    found, seen = by_fixes(0.9, 0).found, by_landmarks(0.9, 0).found
    means = seen.memory.landmarks.means
    for one in (found, seen):
        one.reset_to(Pose(9.0, 9.0, 0.0), R_FIX)
    assert found.memory.fix_correlation.inflation > 3.0
    assert (seen.memory.landmarks.means, len(seen.memory.landmarks.seen)) == (means, 0)
    for one in (found, seen):
        one.reset()
    assert found.memory.fix_correlation == new_fix_correlation()
    assert seen.landmark_correlation_time() == 0.0
    told = by_fixes(0.9, 0, fix_correlation_time=-0.2 / math.log(0.9)).found
    assert told.memory.fix_correlation == new_fix_correlation()


@pytest.mark.parametrize("c", [0.3, 0.6, 0.9])
def test_right_means_give_the_correlation(c):
    # Of noise with variance R: half the squared difference 1 - c, the product of neighbours c.
    assert correlation_of(1.0 - c, 0.0, c, 200) == pytest.approx(c)
    assert correlation_of(1.0 - c + 0.1, 0.1, c, 200) == pytest.approx(c)
    assert correlation_of(0.1 * (1.0 - c), 0.0, 0.1 * c, 200) == pytest.approx(c)  # R claimed ten times as large
    assert correlation_of(1.0 - c, 0.0, 0.0, 200) == 0.0  # white fixes of too large a claimed R
    assert correlation_of(1.0, 0.0, c, 200) == 0.0  # a drift
    assert correlation_of(1.0 - c, 0.0, c, 1) == 0.0  # too few


@pytest.mark.parametrize(("difference", "motion"), [(40.0, 0.0), (0.2, 1.5)])
def test_an_outlier_or_a_long_way_has_no_partner(difference, motion):
    assert with_pair(NO_PAIRS, Pair(difference, motion, 1.0, 1.0, 2, 0.4)) == NO_PAIRS


def warnings(c, seed, kind, **options):
    """Drive 40 s at 5 Hz with coloured fixes or landmarks; return all warnings of each second and the localization."""
    rng = np.random.default_rng([seed, 3])
    robot, found = Robot(rng, noise=0.06, dt=DT), Localization(LocalizationConfig(filter=FilterConfig(**options)))
    if kind == "landmarks":
        found = Localization(found.config, SEPARATION, landmarks=True)
    robot.truth = np.array((1.0, 0.0, 3.0))
    found.initialise(Pose(*robot.truth), 0.1 * R_FIX, 0)
    errors, warned = rng.normal(size=(len(PLACES), 3)), set()
    for step in range(1, 200):
        motion, stamp = robot.move(0.5, 0.3), round(step * DT * NS_PER_S)
        errors = c * errors + math.sqrt(1.0 - c * c) * rng.normal(size=errors.shape)
        if kind == "fixes":
            x, y, theta = robot.truth + np.sqrt(R_FIX.diagonal()) * errors[0]
            found.on_measurement(replace(fix(x, y, wrapped(theta)), stamp=stamp))
        for place, error in zip(PLACES, errors, strict=True) if kind == "landmarks" else ():
            seen = landmark(robot.truth, place, np.diag(SIGMAS**2))
            distance, bearing = (numbers_of(seen) + SIGMAS * error[:2]).tolist()
            found.on_measurement(replace(seen, stamp=stamp, range=distance, bearing=wrapped(bearing)))
        found.on_odometry(OdometryStep(stamp, motion.twist, motion.covariance))
        if step % 5 == 0:
            warned.update(found.correlated())
    return warned, found


def lasting(c):
    """Return the time [s] after which a share ``c`` of an error is left from one measurement to the next."""
    return -DT / math.log(c)


@pytest.mark.parametrize("c", [0.5, 0.95])
@pytest.mark.parametrize("kind", ["fixes", "landmarks"])
def test_it_warns_of_correlated_errors_only_if_it_does_not_allow_for_them(kind, c):
    given = "fix_correlation_time" if kind == "fixes" else "landmark_correlation_time"
    for seed in range(2 if kind == "fixes" else 1):
        warned, found = warnings(c, seed, kind)
        assert warned == set(), "found"
        values = found.monitor.values() | error_values(found.filter)
        assert float(values[f"autocorrelation of {kind}"]) > 0.6 * c
        if kind == "fixes":
            assert float(values["correlation of neighbouring fixes found"]) == pytest.approx(c, abs=0.1)
        else:
            assert math.exp(-DT / float(values["correlation time of landmarks found"])) == pytest.approx(c, abs=0.1)
        assert warnings(c, seed, kind, **{given: lasting(c)})[0] == set(), "given"
        assert warnings(c, seed, kind, detect_correlation=False)[0] == {kind}
        if c > 0.5:
            assert warnings(c, seed, kind, **{given: lasting(0.3)})[0] == {kind}, "given as too short"


@pytest.mark.parametrize("variant", ["ekf_fnn", "ekf_fnn_calibrating"])
def test_variants_that_do_not_look_for_the_correlation_warn_of_it(variant):
    assert warnings(0.5, 0, "fixes", filter=variant)[0] == {"fixes"}
    assert warnings(0.0, 0, "fixes", filter=variant)[0] == set()
