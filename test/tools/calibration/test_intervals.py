"""The intervals that a calibration states hold the true numbers."""

import math

import numpy as np
import pytest
from calibration_drives import Errors, events_of, record

from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_tools.calibration.calibrate import calibrate
from diffbot_tools.calibration.quantities import CONSTANTS

DRIVES, SECONDS = 4, 100.0
NOISE, DELAY = 3.0, 0.2
"""Factor on the deviations that the messages claim; [s] by which the odometry is late."""


def deviations_of(seed):
    """Return the error of each number of one drive, over the standard deviation that the calibration states."""
    left, right, separation = np.random.default_rng([seed, 1]).choice((-1.0, 1.0), 3) * (0.03, 0.03, 0.05)
    events = events_of(record(Errors(left, right, separation, DELAY, NOISE), seed, SECONDS))
    found = calibrate([events], EkfNodeConfig(), lambda: None)
    names = [*(one.name for one in found.quantities), *CONSTANTS[:3]]
    values = [*found.found.values, *found.constants[:3]]
    variances = [*np.diag(found.found.covariance), *np.diag(found.constants_covariance)[:3]]
    truth = {"odometry_delay": DELAY, "odometry_covariance_scale": 2.0 * math.log(NOISE)}
    truth |= dict.fromkeys(("xy_factor", "yaw_factor"), math.log(NOISE))
    truth |= dict(zip(CONSTANTS[:3], (left, right, separation), strict=True))
    return [
        (value - truth[name]) / math.sqrt(variance)
        for name, value, variance in zip(names, values, variances, strict=True)
        if name in truth
    ]


def test_nineteen_of_twenty_intervals_hold_the_true_number():
    found = np.abs([deviations_of(seed) for seed in range(1, DRIVES + 1)])
    assert found.shape == (DRIVES, 7)
    assert (found <= 1.96).mean() >= 0.8
    # Nor are they so wide that they would hold any number.
    assert np.sqrt((found**2).mean()) == pytest.approx(1.0, abs=0.3)
