"""The filter in all its variants under hostile numbers: its state stays what a state has to be."""

import math

import numpy as np
import pytest
from extremes import extreme_configs
from filter_runs import (
    R_FIX,
    SEPARATION,
    build_measurement,
    build_motion,
    covariance,
    fix,
    gated_filter,
    heading,
    numbers_of,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.filter.gate import ACCEPTED, REJECTED
from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.models import Motion
from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_core.geometry import Pose

EVENTS = st.lists(
    st.tuples(
        st.sampled_from(("drive", "drive", "fix", "fix again", "heading", "landmark", "singular", "huge")),
        st.integers(0, 2**32 - 1),
    ),
    min_size=20,
    max_size=60,
)
CONFIGS = [config for _, config in extreme_configs(FilterConfig, 3, 100)]


def signed(rng, low, high, count):
    """Numbers of any order of magnitude between two powers of ten."""
    return rng.choice([-1.0, 1.0], count) * 10.0 ** rng.uniform(low, high, count)


def event(rng, kind):
    """A motion or a measurement with numbers of very different sizes."""
    if kind == "drive":
        M = covariance(rng, 2, 1e-3, 3.0)
        return build_motion(*signed(rng, -3, 1, 2), 10.0 ** rng.uniform(-9.0, 0.0), M[0, 0], M[0, 1], M[1, 1])
    angle = rng.uniform(-math.pi, math.pi)
    if kind == "heading":
        return build_measurement(0, np.array([angle]), covariance(rng, 1, 1e-3, 10.0))
    if kind == "landmark":
        return build_measurement(
            0,
            np.array([10.0 ** rng.uniform(-3, 2), angle]),
            covariance(rng, 2, 1e-3, 10.0),
            tuple(signed(rng, -3, 2, 2)),
        )
    if kind == "singular":
        # The smallest deviation is a ten-thousandth of the largest.
        return build_measurement(0, np.array([*signed(rng, -3, 0, 2), angle]), covariance(rng, 3, 1e-4, 1.0))
    size = 7 if kind == "huge" else 2
    R = covariance(rng, 3, 1e-2, 10.0)
    return build_measurement(0, np.array([*signed(rng, -3, size, 2), angle]), R)


def assert_healthy(found, config):
    x, P = found.memory.belief
    assert np.isfinite(x).all()
    assert np.isfinite(P).all()
    assert -math.pi < x[2] <= math.pi
    wheels = found.wheels()
    if wheels is not None:
        bound = max(5.0 * max(config.wheel_radius_sigma, config.wheel_separation_sigma), 0.1)
        start = (config.left_radius_error, config.right_radius_error, config.wheel_separation_error)
        assert np.abs(wheels.errors - start[: wheels.errors.size]).max() <= bound + 1e-12
    deviations = np.sqrt(P.diagonal())
    assert (deviations > 0.0).all()
    correlations = P / np.outer(deviations, deviations)
    np.testing.assert_allclose(correlations, correlations.T, atol=1e-5)
    assert np.linalg.eigvalsh(0.5 * (correlations + correlations.T)).min() > -1e-9
    if found.memory.candidate is not None:
        assert np.isfinite(found.memory.candidate.x).all()
        assert (found.memory.candidate.P.diagonal() > 0.0).all()
    assert found.nis >= 0.0
    assert math.isfinite(found.memory.gate.slack)
    assert (found.memory.candidate is None) == (found.memory.gate.fixes.rejected == 0)


@settings(max_examples=40)
@given(EVENTS, st.sampled_from(CONFIGS))
def test_the_state_stays_finite_symmetric_and_positive_definite(events, config):
    found = GatedFilter(options_of(config), SEPARATION)
    found.reset_to(Pose(1.0, -2.0, 3.0), R_FIX)
    last = fix(0.0)
    for kind, seed in events:
        one = last if kind == "fix again" else event(np.random.default_rng(seed), kind)
        if isinstance(one, Motion):
            found.predict(one)
            continue
        before = found.memory
        verdict = found.take(one)
        last = one if numbers_of(one).size == 3 else last
        if verdict == REJECTED and not found.options.adaptive:
            assert found.memory.belief is before.belief
        if config.gate_probability == 1.0:
            assert verdict == ACCEPTED
        assert_healthy(found, config)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_fix_without_numbers_is_not_accepted(value):
    # The nodes let none through; whoever uses the filter without them must not lose the state to one.
    found = gated_filter("ekf_calibrating")
    before = found.memory.belief
    with np.errstate(invalid="ignore"):
        assert found.take(fix(value, 0.0)) == REJECTED
        if math.isnan(value):
            assert found.take(heading(value)) == REJECTED
    np.testing.assert_array_equal(found.memory.belief.x, before.x)
    assert found.take(fix(0.0)) == ACCEPTED
    assert np.isfinite(found.memory.belief.x).all()


@pytest.mark.parametrize("variant", ["ekf_calibrating", "ekf_fnn"])
def test_a_fix_whose_innovation_has_a_singular_covariance_is_rejected(variant):
    found = gated_filter(variant, P=np.zeros((3, 3)))
    before = found.memory.belief
    assert found.take(fix(0.1, R=np.zeros((3, 3)))) == REJECTED
    assert math.isnan(found.nis)
    np.testing.assert_array_equal(found.memory.belief.x, before.x)
