"""The record of a filter's innovations, against scipy's chi-square distribution."""

import numpy as np
import pytest
from scipy.stats import chi2

from diffbot_control.filter.gate import ACCEPTED, FIX, HEADING, LANDMARK, REJECTED, RELOCATED
from diffbot_control.filter.innovation_monitor import WINDOW, Innovation, InnovationMonitor, whitened

KINDS = {1: HEADING, 2: LANDMARK, 3: FIX}
"""by the numbers that they measure"""


def noted(entries):
    record = InnovationMonitor()
    for size, nis, outcome in entries:
        record.record(KINDS[size], nis, outcome)
    return record


@pytest.mark.parametrize("sizes", [[1], [3, 1, 2], [3] * 20 + [1] * 20])
def test_mean_and_bounds_are_those_of_chi_square(sizes):
    rng = np.random.default_rng(1)
    values = [rng.chisquare(size) for size in sizes]
    found = noted(zip(sizes, values, [ACCEPTED] * len(sizes), strict=True)).nis()
    numbers = sum(sizes)
    assert found.mean == pytest.approx(sum(values) / numbers)
    assert (found.low, found.high) == pytest.approx(tuple(chi2.ppf([0.025, 0.975], numbers) / numbers))
    assert found.alarm == pytest.approx(chi2.isf(1e-4, numbers) / numbers)
    assert 0.0 < found.low < 1.0 < found.high < found.alarm


def test_only_the_newest_fifty_count():
    old = [(3, 1e6, ACCEPTED)] * 70
    found = noted([*old, *[(1, 0.5, ACCEPTED)] * 20, *[(3, 6.0, ACCEPTED)] * 30]).nis()
    assert WINDOW == 50
    assert found.mean == pytest.approx((20 * 0.5 + 30 * 6.0) / (20 + 90))
    assert found.high == pytest.approx(chi2.ppf(0.975, 110) / 110)


def test_a_relocation_starts_the_mean_anew_and_keeps_the_counts():
    record = noted([(3, 2.0, ACCEPTED), (3, 900.0, REJECTED), (3, 950.0, RELOCATED)])
    assert record.nis() is None
    assert (record.rejected, record.relocated) == ({"fixes": 1}, {"fixes": 1})
    record.record(HEADING, 0.25, ACCEPTED)
    assert record.nis().mean == pytest.approx(0.25)
    record.clear()
    assert record.nis() is None
    assert record.relocated == {"fixes": 1}


def test_the_values_of_the_diagnostics():
    record = noted([(3, 2.4, ACCEPTED), (2, 900.0, REJECTED), (1, 40.0, RELOCATED), (3, 2.4, ACCEPTED)])
    low, high = chi2.ppf([0.025, 0.975], 3) / 3
    assert record.values() == {
        "NIS per number": "0.800",
        "NIS 95 % bounds": f"{low:.3f} {high:.3f}",
        "fixes rejected": "0",
        "relocations by fixes": "0",
        "landmarks rejected": "1",
        "relocations by landmarks": "0",
        "headings rejected": "0",
        "relocations by headings": "1",
    }


def test_a_covariance_that_rounding_has_left_singular_is_whitened():
    singular, regular = np.full((2, 2), 4.0), np.array([[4.0, 1.0], [1.0, 9.0]])
    innovations = [Innovation(np.array([2.0, 2.0]), singular), Innovation(np.array([2.0, 3.0]), regular)]
    first, second = whitened(innovations)
    # Along (1, 1) the variance is 8, across it nothing was measured.
    assert first @ first == pytest.approx(1.0)
    assert second @ second == pytest.approx(innovations[1].y @ np.linalg.inv(regular) @ innovations[1].y)
    (zero,) = whitened([Innovation(np.zeros(2), np.zeros((2, 2)))])
    assert np.isfinite(zero).all()
