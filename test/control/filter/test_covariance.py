"""Covariances from outside: the good pass as they are, the bad are named."""

import math

import numpy as np
import pytest

from diffbot_control.filter.covariance import check_covariance, inverse
from diffbot_core.errors import BadMessageError


@pytest.mark.parametrize(
    ("matrix", "kind"),
    [
        (np.diag([1e8, 1.0, 1e-12]), ""),
        # Rounding on the way, e.g. through float32.
        (np.array([[1.0, 0.5], [0.5 + 5e-7, 1.0]]), ""),
        (np.array([[1.0, math.inf], [-math.inf, 1.0]]), "covariance not finite"),
        (np.full((3, 3), 1e308), "covariance not finite"),
        (np.zeros((3, 3)), "covariance is zero"),
        (np.diag([1e9, 1.0, 1.0]), "covariance too large"),
        (np.array([[1.0, 0.5], [0.5 + 2e-6, 1.0]]), "covariance not symmetric"),
        (np.array([[1.0, 1.1], [1.1, 1.0]]), "covariance not positive definite"),
        # Its inverse overflows, and one NaN in a filter stays there for good.
        (np.diag([1.0, 1.0, 1e-310]), "covariance not positive definite"),
        # -1 is ROS's code for "unknown"; such a matrix is as symmetric as can be.
        (np.array([[-1.0]]), "covariance not positive definite"),
    ],
)
def test_good_covariances_pass_as_they_are_and_bad_ones_are_named(matrix, kind):
    if not kind:
        np.testing.assert_array_equal(check_covariance(matrix.copy()), matrix)
        return
    with pytest.raises(BadMessageError) as caught:
        check_covariance(matrix)
    assert caught.value.kind == kind


@pytest.mark.parametrize("size", [1, 2, 3])
def test_the_inverse_is_lapacks(size):
    rng = np.random.default_rng(size)
    for _ in range(100):
        root = rng.normal(size=(size, size)) * 10.0 ** rng.uniform(-4, 3)
        S = root @ root.T + 1e-3 * np.trace(root @ root.T) * np.eye(size)
        found = inverse(S)
        np.testing.assert_allclose(found, np.linalg.inv(S), rtol=1e-10, atol=1e-12 * np.abs(found).max())
        np.testing.assert_array_equal(found, found.T)


def test_a_matrix_that_is_no_covariance_has_no_inverse_here():
    indefinite = np.array([[1.0, 0.9, -0.9], [0.9, 1.0, 0.9], [-0.9, 0.9, 1.0]])
    for bad in (indefinite, indefinite[:2, :2] - np.diag([0.0, 1.0]), np.array([[math.nan]])):
        with pytest.raises(np.linalg.LinAlgError):
            inverse(bad)
