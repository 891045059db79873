"""The errors of the wheels as states: found, honestly claimed, and forgotten where they are impossible."""

import numpy as np
import pytest
from filter_runs import R_FIX, SEPARATION, Robot, build_motion, fix, gated_filter, winding

from diffbot_control.filter.belief import ErrorEstimate
from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.models import Motion
from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance
from diffbot_sim.compiled.gated_filter import check_supported


@pytest.mark.parametrize("variant", ["ekf_calibrating", "ekf_fnn_calibrating"])
def test_errors_of_the_radii_and_of_the_wheel_separation_are_found(variant):
    # Wheels 10 % further apart than the filter knows: the robot of the test has the right distance.
    robot, true = Robot(np.random.default_rng(4), (-0.03, 0.02)), np.array([-0.03, 0.02, 0.1])
    options = options_of(FilterConfig(variant, wheel_radius_sigma=0.1, wheel_separation_sigma=0.1))
    found = GatedFilter(options, SEPARATION / 1.1)
    found.reset_to(Pose(0.0, 0.0, 0.0), R_FIX)
    for step in range(1500):
        twist, dt, (var_v, cov, var_omega), _ = robot.move(*winding(step))
        wrong = Twist(twist.v, 1.1 * twist.omega), dt, TwistCovariance(var_v, 1.1 * cov, 1.21 * var_omega)
        found.predict(Motion(*wrong))
        if step % 2 == 0:
            found.take(robot.fix())
    wheels = found.wheels()
    assert np.abs(wheels.errors - true).max() < 0.02
    assert (np.abs(wheels.errors - true) < 3.5 * np.sqrt(wheels.P.diagonal())).all()


@pytest.mark.parametrize("index", [0, 1, 2])
def test_an_error_beyond_five_deviations_resets_all_three(index):
    found = gated_filter("ekf_calibrating", wheel_radius_sigma=0.1, wheel_separation_sigma=0.1)
    for size, kept in ((0.49, True), (0.51, False)):
        errors = np.zeros(3)
        errors[index] = size
        found.set_wheels(ErrorEstimate(errors, 1e-8 * np.eye(3)))
        found.predict(build_motion(1.0, 0.3, 0.1, 1e-4, 0.0, 1e-4))
        found.take(fix(0.0, R=np.eye(3)))
        assert found.wheels().errors.any() == kept
        assert found.memory.belief.P[3:, :3].any() == kept
    np.testing.assert_allclose(found.wheels().P, 0.01 * np.eye(3))


def test_the_compiled_filter_refuses_what_it_does_not_have():
    with pytest.raises(InvalidValueError, match="correlation"):
        check_supported(options_of(FilterConfig(fix_correlation_time=1.0)))
    check_supported(options_of(FilterConfig(wheel_separation_sigma=0.1)))
