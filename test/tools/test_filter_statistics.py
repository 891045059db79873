"""Consistency of simulated innovations with a known correlation."""

import math

import numpy as np
import pytest

from diffbot_tools.filter_statistics import Innovation, consistency_of_innovations


def innovations(rng, count, c, source=("Fix", ())):
    S = np.array([[2.0, 0.6], [0.6, 0.5]])
    factor, white, found = np.linalg.cholesky(S), rng.normal(size=2), []
    for index in range(count):
        white = c * white + math.sqrt(1.0 - c * c) * rng.normal(size=2)
        y = factor @ white
        found.append(Innovation(index, source, y, S, float(y @ np.linalg.inv(S) @ y), True))
    return found


@pytest.mark.parametrize("c", [0.0, 0.6])
def test_the_correlation_of_the_process_is_found(c):
    found = consistency_of_innovations(innovations(np.random.default_rng(1), 5000, c))
    assert found.correlation == pytest.approx(c, abs=0.03)
    assert found.nis == pytest.approx(1.0, abs=0.06)
    assert found.bound == pytest.approx(1.96 / math.sqrt(2 * 4999))


def test_pairs_are_consecutive_accepted_innovations_of_one_source():
    rng = np.random.default_rng(2)
    one, other = (innovations(rng, 2000, 0.7, ("landmarks", (x, 0.0))) for x in (0.0, 1.0))
    outlier = one[0]._replace(y=np.array([1e6, 1e6]), nis=1e12, accepted=False)
    # A bearing of the same landmark belongs to the same source.
    bearing = one[-1]._replace(y=np.array([0.1]), S=np.array([[1.0]]), nis=0.01)
    mixed = [item for pair in zip(one, other, strict=True) for item in (*pair, outlier)]
    found = consistency_of_innovations([*mixed, bearing])
    assert found.correlation == pytest.approx(0.7, abs=0.04)
    assert found.nis == pytest.approx(1.0, abs=0.15)
