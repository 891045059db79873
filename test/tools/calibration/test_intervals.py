"""The 95 % intervals of a calibration contain the true values, for each quantity."""

import math
from collections import defaultdict

import numpy as np
import pytest
from calibration_drives import SECOND, Errors, Sensors, events_of, record

from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.schema import build
from diffbot_tools.calibration.calibrate import calibrate
from diffbot_tools.calibration.quantities import CONSTANTS

DRIVES, SECONDS = 20, 100.0
NOISE, DELAY = 3.0, 0.2
"""Factor on the deviations that the messages claim; [s] by which the odometry is late."""
SETUPS = (Sensors(), {}), (Sensors(second=5, gyro=True), {"pose_sources": [SECOND], "use_gyro": True})
"""Sensors and parameters of even and of odd drives; ``DRIVES`` of each."""


def deviations_of(seed):
    """Return the error of each quantity, divided by the standard deviation that the calibration reports."""
    left, right, separation = np.random.default_rng([seed, 1]).choice((-1.0, 1.0), 3) * (0.03, 0.03, 0.05)
    sensors, parameters = SETUPS[seed % 2]
    events = events_of(record(Errors(left, right, separation, DELAY, NOISE), seed, SECONDS, sensors))
    calibration = calibrate([events], build(EkfNodeConfig, parameters), lambda: None)
    fit, constants = calibration.found, dict(zip(CONSTANTS, (left, right, separation), strict=False))
    truth = {one.name: math.log(NOISE) for one in calibration.quantities if one.name.endswith("factor")} | constants
    truth |= {"odometry_delay": DELAY, "odometry_covariance_scale": 2.0 * math.log(NOISE)}
    found = zip(
        [*(one.name for one in calibration.quantities), *CONSTANTS],
        [*fit.values, *calibration.constants],
        [*np.diag(fit.covariance), *np.diag(calibration.constants_covariance)],
        strict=True,
    )
    return {name: (value - truth[name]) / math.sqrt(variance) for name, value, variance in found if name in truth}


@pytest.mark.slow
def test_at_least_four_of_five_true_values_are_inside_the_95_percent_intervals_of_each_quantity():
    found = defaultdict(list)
    for seed in range(2 * DRIVES):
        for name, deviation in deviations_of(seed).items():
            found[name, seed % 2].append(abs(deviation))
    inside = {name: float(np.mean(np.array(values) <= 1.96)) for name, values in found.items()}
    assert len(inside) == 17
    assert min(inside.values()) >= 0.8, inside
    # The intervals are not so wide that they would contain any number.
    every = np.concatenate(list(found.values()))
    assert 0.5 < np.sqrt((every**2).mean()) < 1.5
