"""A lost heading is found from positions alone, and the covariance stays honest meanwhile."""

import math

import numpy as np

from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.measurements import PoseFix
from diffbot_control.filter.models import Motion
from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance

PERIOD, START = 0.1, np.diag([0.0289, 0.0289, 1.0])


def lost(rate, seed):
    """RMSE of the position [m] and mean NEES of a run of a minute with fixes of the position only, ``rate`` [Hz]."""
    rng = np.random.default_rng([seed, 3])
    found = GatedFilter(options_of(FilterConfig(filter="ekf", gate_probability=1.0)), 0.6)
    truth = np.array([0.0, 0.0, rng.uniform(-3.0, 3.0)])
    found.reset_to(Pose(*(truth + rng.normal(size=3) * np.sqrt(np.diag(START)))), START)
    v, omega, squares, nees = rng.uniform(0.4, 1.0), rng.uniform(-0.3, 0.3), [], []
    for step in range(1, 601):
        speed, turn = v + rng.normal(0.0, 0.02), omega + rng.normal(0.0, 0.03)
        middle = truth[2] + 0.5 * turn * PERIOD
        truth = truth + PERIOD * np.array([speed * math.cos(middle), speed * math.sin(middle), turn])
        found.predict(Motion(Twist(v, omega), PERIOD, TwistCovariance(4e-4, 0.0, 9e-4)))
        if step % round(10 / rate) == 0:
            x, y = truth[:2] + rng.normal(0.0, 0.17, 2)
            found.take(PoseFix(step, Pose(x, y, 0.0), np.diag([0.0289, 0.0289, 1e7])))
        error = found.memory.belief.x - truth
        error[2] = math.remainder(error[2], 2.0 * math.pi)
        squares.append(error[0] ** 2 + error[1] ** 2)
        nees.append(error @ np.linalg.solve(found.memory.belief.P, error))
    return np.mean(squares), np.mean(nees)


def test_a_lost_heading_is_found_from_positions():
    """Within 10 % of the RMSE of the invariant filter, 0.138 m at 1 Hz; the plain one has 0.175 m."""
    runs = np.array([lost(1, seed) for seed in range(60)])
    assert math.sqrt(runs[:, 0].mean()) < 0.152
    assert runs[:, 1].mean() < 4.0
