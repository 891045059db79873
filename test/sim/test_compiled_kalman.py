"""The loops that compiled code uses equal the functions that use filterpy."""

import numpy as np
import pytest

from diffbot_control.filter import kalman
from diffbot_sim import compiled_kalman


def assert_equal(found, expected):
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("n", "m"), [(3, 1), (3, 3), (7, 2), (10, 3)])
def test_the_loops_equal_filterpys_results(n, m):
    rng = np.random.default_rng(n)

    def covariance(size):
        root = rng.normal(size=(size, size))
        return root @ root.T + 0.1 * np.eye(size)

    P, Q, R = covariance(n), covariance(n), covariance(m)
    F = np.eye(n) + rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.3)
    H = rng.normal(size=(m, n)) * (rng.random((m, n)) < 0.6)
    x, y = rng.normal(size=n), rng.normal(size=m)
    given = [array.copy() for array in (P, F, Q, H, R, x, y)]
    for name, arguments in (("propagate", (P, F, Q)), ("innovation_covariance", (P, H, R))):
        assert_equal([getattr(compiled_kalman, name)(*arguments)], [getattr(kalman, name)(*arguments)])
    assert_equal(compiled_kalman.correct(P, y, H, R), kalman.correct(P, y, H, R))
    assert_equal(compiled_kalman.condition(x, P, 1, 0.7), kalman.condition(x, P, 1, 0.7))
    for array, before in zip((P, F, Q, H, R, x, y), given, strict=True):
        np.testing.assert_array_equal(array, before)  # the arguments are not changed
