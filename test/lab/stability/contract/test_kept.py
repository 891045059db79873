"""Shares of steps and runs that keep a contract, against arrays counted by hand."""

import math

import numpy as np
import pytest

from diffbot_lab.stability.contract.kept import errors_within, holds_from, shares
from diffbot_lab.stability.tuned.contract import Contract


def test_a_contract_is_kept_by_hand_counted_steps_and_runs():
    errors = np.zeros((4, 10, 3))
    errors[0, 3, 0], errors[1, :5, 2], errors[2, 0] = 0.061, -0.031, (0.036, -0.047, 0.03)
    kept = shares(errors_within(errors, Contract()))
    assert kept.steps == pytest.approx((9 + 5 + 10 + 10) / 40)
    assert kept.runs == 0.5
    # Wilson's interval of 2 of 4, from the published formula: 0.5 -+ z sqrt(1/16 + z^2/64) / (1 + z^2/4) at z = 1.96.
    half = 1.96 * math.sqrt(0.25 / 4 + 1.96**2 / 64) / (1 + 1.96**2 / 4)
    assert (kept.runs_low, kept.runs_high) == pytest.approx((0.5 - half, 0.5 + half), abs=1e-4)
    # Half width: 1.96 standard deviations of the four shares over sqrt(4).
    half = 1.96 * np.std([0.9, 0.5, 1.0, 1.0], ddof=1) / 2.0
    assert kept.steps - kept.steps_low == pytest.approx(half, rel=1e-4)


def test_it_is_the_distance_that_is_bounded_and_no_estimate_is_no_kept_step():
    errors = np.array([[0.045, 0.045, 0.0], [0.0, -0.06, -0.03], [np.nan, np.nan, np.nan]])
    assert errors_within(errors, Contract()).tolist() == [False, True, False]


def test_the_contract_holds_from_the_step_after_the_last_break():
    kept = np.ones((4, 11), dtype=np.bool_)
    kept[1, [0, 3]], kept[2, 0], kept[3, 10] = False, False, False
    assert holds_from(kept, 0.5).tolist() == [0.0, 2.0, 0.5, math.inf]
