"""The record of a filter's innovations: NIS against chi-square, autocorrelation against Markov processes."""

import math

import numpy as np
import pytest
from scipy.special import chdtrc, chdtri
from scipy.stats import chi2

from diffbot_control.filter.chi_square import chi_square_bound, survival
from diffbot_control.filter.gate import ACCEPTED, REJECTED, RELOCATED, WEIGHED
from diffbot_control.filter.innovation_monitor import InnovationMonitor, whitened, whiteness_of
from diffbot_control.filter.measurements import FIXES, HEADINGS, LANDMARKS, Innovation, Source

SOURCES = {1: Source(HEADINGS), 2: Source(LANDMARKS, (1.0, 2.0)), 3: Source(FIXES)}
"""by the numbers that they measure"""


@pytest.mark.parametrize("sizes", [[1], [3, 1, 2], [3] * 60 + [1] * 20])
def test_mean_and_bounds_of_the_newest_fifty_are_those_of_chi_square(sizes):
    rng = np.random.default_rng(1)
    values = [rng.chisquare(size) for size in sizes]
    monitor = InnovationMonitor()
    for size, nis in zip(sizes, values, strict=True):
        monitor.record(SOURCES[size], nis, ACCEPTED, Innovation(np.zeros(size), np.eye(size)))
    found = monitor.nis()
    numbers = sum(sizes[-50:])
    assert found.mean == pytest.approx(sum(values[-50:]) / numbers)
    assert (found.low, found.high) == pytest.approx(tuple(chi2.ppf([0.025, 0.975], numbers) / numbers))
    assert found.alarm == pytest.approx(chi2.isf(1e-4, numbers) / numbers)


S = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.002], [0.0, 0.002, 0.01]])


def innovations(rng, count, rho=0.0, factor=1.0):
    """First-order Markov sequence with covariance ``factor`` S and autocorrelation ``rho``."""
    root, u = np.linalg.cholesky(factor * S), rng.normal(size=3)
    found = []
    for _ in range(count):
        found.append((None, Innovation(root @ u, S)))
        u = rho * u + math.sqrt(1.0 - rho * rho) * rng.normal(size=3)
    return found


def whiteness(found):
    sources, innovations = zip(*found, strict=True) if found else ((), ())
    return whiteness_of(zip(sources, range(len(sources)), whitened(innovations), strict=True))


@pytest.mark.parametrize(("rho", "factor"), [(0.0, 1.0), (0.9, 0.1), (0.9, 10.0)])
def test_the_correlation_is_that_of_the_sequence_whatever_its_size(rho, factor):
    found = [whiteness(innovations(np.random.default_rng([1, run]), 100, rho, factor)) for run in range(200)]
    assert np.mean([one.correlation for one in found]) == pytest.approx(rho, abs=0.04)
    if rho == 0.0:
        assert 0.91 < np.mean([abs(one.correlation) < one.bound for one in found]) < 0.99
        assert not any(one.correlation > one.alarm for one in found)


def test_only_innovations_of_one_source_are_compared():
    """Two landmarks in turn, each with an offset of its own: compared in the order of time they would cancel."""
    monitor, rng, y = InnovationMonitor(), np.random.default_rng(3), {}
    for number in range(100):
        source = number % 2
        y = np.array([0.2, 0.2]) * (1.0 if source else -1.0) + rng.normal(0.0, 0.05, 2)
        # Seen in turn every 0.1 s, the second one 0.03 s early each time; one message overtakes another.
        stamp = 100 * number - 30 * source + (-450 if number == 50 else 0)
        innovation = Innovation(y, 0.04 * np.eye(2))
        monitor.record(Source(LANDMARKS, (source,)), 2.0, ACCEPTED, innovation, stamp * 10**6)
    found = monitor.whiteness()
    assert set(found) == {LANDMARKS}
    assert found[LANDMARKS].correlation > 0.8
    assert sorted(found[LANDMARKS].periods) == pytest.approx([0.2] * 96 + [0.25, 0.65])


def test_only_accepted_measurements_count_and_a_relocation_starts_anew():
    assert whiteness(innovations(np.random.default_rng(0), 10)) is None, "30 products are needed"
    assert whiteness(innovations(np.random.default_rng(0), 11)) is not None
    monitor, (_, innovation) = InnovationMonitor(), innovations(np.random.default_rng(0), 1)[0]
    for outcome in (REJECTED, WEIGHED):
        for _ in range(50):
            monitor.record(SOURCES[3], 1.0, outcome, innovation)
    assert monitor.whiteness() == {}
    assert monitor.weighed == 50
    for _ in range(50):
        monitor.record(SOURCES[3], 1.0, ACCEPTED, innovation)
    assert monitor.whiteness()[FIXES].correlation == pytest.approx(1.0)
    assert monitor.values()["autocorrelation of fixes"] == "1.000"
    monitor.record(SOURCES[3], 1.0, RELOCATED, innovation)
    assert monitor.whiteness() == {}


TAILS = (0.999, 0.975, 0.5, 0.025, 1e-3, 1e-4, 1e-9, 1e-15)


@pytest.mark.parametrize("dof", [1, 2, 3, 10, 99, 150])
def test_bounds_and_probabilities_are_those_of_scipy(dof):
    for tail in TAILS:
        # Rounding of a probability near 1 is large relative to the small bound.
        assert chi_square_bound(dof, tail) == pytest.approx(float(chdtri(dof, tail)), rel=1e-12)
    for x in (0.0, 1e-6, 0.3, 1.0, float(dof), 3.0 * dof, 700.0):
        assert survival(x, dof) == pytest.approx(float(chdtrc(dof, x)), rel=1e-12, abs=1e-300)
