"""filterpy without scipy until it is needed, and with it then."""

import subprocess
import sys

PROGRAM = """
import sys
import numpy as np
from diffbot_control.filter.filterpy_ekf import ExtendedKalmanFilter
assert not [name for name in sys.modules if name.partition(".")[0] == "scipy"]

kf = ExtendedKalmanFilter(dim_x=2, dim_z=2)
kf.x, kf.P, kf.R = np.zeros(2), np.diag([4.0, 9.0]), np.eye(2)
kf.update(np.array([1.0, -2.0]), lambda x: np.eye(2), lambda x: x)
assert "scipy.stats" not in sys.modules
# log N(y; 0, S) of y = (1, -2), S = diag(5, 10)
expected = -0.5 * (1.0 / 5.0 + 4.0 / 10.0) - 0.5 * np.log(5.0 * 10.0) - np.log(2.0 * np.pi)
assert abs(kf.log_likelihood - expected) < 1e-12, (kf.log_likelihood, expected)

import filterpy.common, filterpy.stats
import scipy
# Functions of scipy that filterpy imported by name, and by their module.
A = filterpy.common.block_diag(np.eye(2), 3.0 * np.eye(1))
assert np.array_equal(A, np.diag([1.0, 1.0, 3.0])), A
from scipy.stats import norm
assert filterpy.stats.norm_cdf((-1.0, 2.0), 0.5, 2.0) == norm.cdf(2.0, 0.5, 2.0**0.5) - norm.cdf(-1.0, 0.5, 2.0**0.5)
"""


def test_scipy_is_loaded_when_it_is_used():
    result = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 0, result.stderr
