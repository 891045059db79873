"""Deviations of runs from the requested motion, fitted bounds, and the share of the runs that keep a contract."""

import math

import numpy as np
import pytest

from diffbot_control.law.configuration import SwitchingConfig
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose
from diffbot_lab.cases import Configuration, make_case
from diffbot_lab.stability import contract
from diffbot_lab.stability.contract import (
    DISTANCE,
    BaseStep,
    RobotRuns,
    deviations_of,
    excess_speed_near_goal,
    fit_bounds,
    is_kept,
    kept_share,
)
from diffbot_lab.stability.plan import Contract, Plan, ideal_law
from diffbot_lab.stability.runs import uniform_starts
from diffbot_sim.batch import Starts, run_histories
from diffbot_tools.robot import read_robot

SEED = 9017
BOUNDS = Contract(eps_v=0.01, eps_omega=0.02)


def test_a_contract_is_kept_if_all_deviations_are_within_the_bounds():
    deviations = np.zeros((1, 7, 6))
    deviations[0, 1:, :5] = np.diag([0.061, 0.031, 0.027, 0.011, 0.021, 0.0])[:, :5]
    deviations[0, 6, :5] = 0.06, 0.03, 0.026, 0.01, 0.02
    deviations[..., 5] = 1.0
    assert is_kept(deviations, BOUNDS).tolist() == [[True, False, False, False, False, False, True]]


def test_slopes_allow_the_estimate_more_far_from_the_goal():
    deviations = np.zeros((1, 4, 6))
    deviations[0, :, :3] = 0.1, 0.07, 0.056
    deviations[0, :, DISTANCE] = 2.01, 1.9, 2.1, 20.0
    sloped = BOUNDS._replace(position_slope=0.02, theta_slope=0.02, sigma_slope=0.015)
    assert is_kept(deviations, sloped).tolist() == [[True, False, True, True]]
    deviations[0, 3, 3] = 0.011
    assert is_kept(deviations, sloped).tolist() == [[True, False, True, False]]
    assert fit_bounds(deviations[:, :1], sloped)["sigma_max"] == pytest.approx(0.026)
    assert sloped.at(2.0) == pytest.approx(BOUNDS._replace(eps_position=0.1, eps_theta=0.07, sigma_max=0.056))


def test_the_share_of_the_runs_has_wilsons_interval():
    within = np.ones((4, 10), np.bool_)
    within[0, 3], within[1, :5] = False, False
    assert kept_share(within) == pytest.approx((0.5, 0.150, 0.850), abs=1e-3)  # 2 of 4


def test_fitted_bounds_are_the_largest_deviations_rounded_up_to_two_digits():
    deviations = np.zeros((10, 3, 6))
    deviations[:, 1, 0] = 0.01001 * np.arange(1.0, 11.0)
    deviations[:, 2, 2] = math.inf
    assert fit_bounds(deviations, BOUNDS) == pytest.approx(
        {"eps_position": 0.11, "eps_theta": 0.001, "sigma_max": math.inf, "eps_v": 0.001, "eps_omega": 0.001}
    )


def test_near_the_goal_only_the_speed_beyond_the_largest_request_is_a_deviation():
    """The base moves 0.05 m in 0.1 s; f(0.1 m) = 0.188 m/s, and the wheel error of a turn adds up to 0.039 m/s."""
    law, numbers = ideal_law(SwitchingConfig(), Plan()), BaseStep(0.05, 0.1)
    before, after = Pose(1.0, 2.0, 3.1), Pose(0.97, 2.04, -1.0)
    assert excess_speed_near_goal(before, after, 0.1, law, numbers) == pytest.approx(0.5 - 0.188 - 0.039, abs=1e-3)
    assert excess_speed_near_goal(before, Pose(1.0, 2.01, 3.05), 0.1, law, numbers) == 0.0


@pytest.fixture(scope="module")
def nominal():
    return RobotRuns(make_case(Configuration(), 60.0), uniform_starts(np.random.default_rng(SEED), 4, 3.0))


def test_an_ideal_base_has_only_the_errors_of_the_estimate(nominal):
    case = nominal.case
    histories = run_histories(case, Starts(nominal.starts), SEED, 0, 4)
    found = contract.measure_deviations(nominal, Contract(), SEED)
    # The deviations are finite from the first measured pose on.
    known = np.isfinite(found[..., :3]).all(axis=-1)
    assert known[:, 50:].all()
    errors = histories[:, :-1, 3:6] - histories[:, :-1, :3]
    np.testing.assert_allclose(found[known, 0], np.hypot(errors[known, 0], errors[known, 1]), rtol=1e-12)
    wrapped = np.abs(np.remainder(errors[known, 2] + math.pi, 2.0 * math.pi) - math.pi)
    np.testing.assert_allclose(found[known, 1], wrapped, atol=1e-12)
    np.testing.assert_array_equal(found[known, 2], histories[:, :-1, 8][known])
    np.testing.assert_array_equal(found[known, DISTANCE], np.hypot(*histories[:, :-1, :2][known].T))
    assert found[known][:, 3:5].max() < 1e-9
    # If the contract allows less than the wheel noise of the plant, the base deviates.
    assert contract.measure_deviations(nominal, Contract(wheel_error=0.04), SEED)[known][:, 3].max() > 1e-3


def test_a_robot_with_limits_dead_time_and_lag_follows_the_request_for_the_coasted_pose():
    robot = read_robot("turtlebot4")
    runs = contract.runs_of_robot(robot, 20, SEED)
    assert np.hypot(*runs.starts[:, :2].T).max() < contract.start_radius(robot) == pytest.approx(12.0 * 0.31)
    found = contract.measure_deviations(runs, Contract(), SEED)[:, 100:]
    assert 1e-3 < found[..., 3].max() < 0.01
    assert 1e-3 < found[..., 4].max() < 0.1
    # Without the prediction the deviation is the distance that the robot drives in the dead time.
    sheet = runs.case.controller.data_sheet
    blind = runs.case.controller._replace(data_sheet=sheet._replace(command_latency=0.0, drive_time_constant=0.0))
    histories = run_histories(runs.case._replace(controller=blind), Starts(runs.starts), SEED, 0, 20)
    law = ideal_law(blind, Plan(BOUNDS, 0.05))
    assert deviations_of(blind, law, 0.05, 0.05, histories)[:, 100:, 3].max() > 0.03


def test_histories_of_another_law_are_refused(nominal):
    histories, config = run_histories(nominal.case, Starts(nominal.starts), SEED, 0, 4), nominal.case.controller
    other = config._replace(sigma_known=0.01, tolerance=config.tolerance._replace(xy_goal_tolerance=0.02))
    with pytest.raises(DiffbotError, match="recorded with another law or configuration"):
        deviations_of(other, ideal_law(other, Plan()), 0.05, 0.1, histories)
