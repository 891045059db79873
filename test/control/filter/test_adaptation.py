"""The fuzzy-neural adaptation: against finite differences, and against noise whose right scale is known."""

import math
from dataclasses import replace

import numpy as np
import pytest
from filter_runs import R_FIX, Robot, gated_filter

from diffbot_control.filter.adaptation import Normalised, adapt, new_adaptation, q_scale, r_scales
from diffbot_control.filter.gate import ACCEPTED
from diffbot_control.filter.measurements import PositionFix
from diffbot_core.geometry import Pose


def fed(count, position=1.0, heading=1.0, seed=0, offset=(0.0, 0.0, 0.0), outliers=0.0, state=None):
    """Feed white innovations whose variances are ``position`` and ``heading`` times what an unscaled filter expects.

    The filter's own P is taken to be small, so an innovation is divided by the deviation of the scaled R alone.
    """
    rng, state, scales, q = np.random.default_rng(seed), state or new_adaptation(), [], []
    factors = np.sqrt([position, position, heading])
    for _ in range(count):
        of_position, of_heading = r_scales(state)
        y = factors * rng.normal(size=3) / np.sqrt([of_position, of_position, of_heading]) + offset
        thrown = rng.random() < outliers
        if thrown:
            y[:2] += 30.0 * rng.choice([-1.0, 1.0], 2)
        state = adapt(state, Normalised(*y.tolist()), not thrown)
        scales.append(r_scales(state))
        q.append(q_scale(state))
    return state, np.array(scales), np.array(q)


@pytest.mark.parametrize("factor", [0.1, 100.0])
def test_a_wrong_r_is_recovered_for_position_and_heading_apart(factor):
    for position, heading in ((factor, 1.0), (1.0, factor), (factor, factor), (factor, 1.0 / factor)):
        _, scales, _ = fed(2000, position, heading)
        ratio = np.log(scales / (position, heading))
        assert (np.abs(ratio[150:]).max(axis=0) < np.log(4.0)).all()
        np.testing.assert_allclose(ratio[300:].mean(axis=0), 0.0, atol=0.25)


@pytest.mark.parametrize("drift", [1.0, 5.0])
def test_a_drift_raises_q_but_not_r(drift):
    _, still, _ = fed(2000, seed=1)
    _, scales, q = fed(2000, seed=1, offset=(drift, -drift, 0.5 * drift))
    # Differences of successive innovations do not contain it at all.
    np.testing.assert_allclose(scales, still, rtol=1e-6)
    assert np.median(q[100:]) > 2.0
    assert q.max() <= math.exp(4.0)


def test_isolated_outliers_do_not_inflate_r():
    seed = 1
    _, scales, _ = fed(2500, seed=seed, outliers=0.05)
    assert np.exp(np.log(scales[300:]).mean(axis=0))[0] < 1.5
    # Two outliers in a row are seen now and then, and forgotten.
    assert (scales[300:, 0] > 5.0).mean() < 0.02


def test_the_filter_gives_the_adaptation_each_innovation_by_its_own_deviation():
    variant = "ekf_fnn"
    rng = np.random.default_rng(8)
    root = rng.normal(size=(3, 3))
    P = 0.01 * (root @ root.T + np.eye(3))
    found = gated_filter(variant, (1.0, 2.0, 3.1), P)
    found.memory = found.memory._replace(
        adaptation=found.memory.adaptation._replace(
            position=found.memory.adaptation.position._replace(log_scale=math.log(4.0)),
            heading=found.memory.adaptation.heading._replace(log_scale=math.log(9.0)),
        )
    )
    found.take(replace(Robot(rng).fix(), pose=Pose(1.1, 1.8, -3.1)))
    S = P.diagonal() + R_FIX.diagonal() * (4.0, 4.0, 9.0)
    expected = np.array([0.1, -0.2, 2.0 * math.pi - 6.2]) / np.sqrt(S)
    kept = found.memory.adaptation
    assert tuple(kept.innovation) == pytest.approx(tuple(expected))
    # The R that it used is the scaled one: K = P S^-1 of the textbook.
    scale = np.diag([2.0, 2.0, 3.0])
    S_whole = P + scale @ R_FIX @ scale
    x = np.array([1.0, 2.0, 3.1]) + P @ np.linalg.solve(S_whole, [0.1, -0.2, 2.0 * math.pi - 6.2])
    np.testing.assert_allclose(found.memory.belief.x[:2], x[:2], rtol=1e-9)


def test_of_fixes_without_a_heading_only_the_position_is_adapted():
    rng, full, part = np.random.default_rng(5), new_adaptation(), new_adaptation()
    for number in range(300):
        # Every tenth fix has a heading, then two in a row: only those two are a pair.
        has_heading = number % 10 == 0 or number >= 298
        x, y, theta = rng.normal(size=3).tolist()
        before = part
        full = adapt(full, Normalised(x, y, theta), True)
        part = adapt(part, Normalised(x, y, theta if has_heading else math.nan), True)
        assert part.position == full.position
        assert (part.heading == before.heading) == (number != 299)
        assert (part.drift.theta == before.drift.theta) == (not has_heading)
        assert part.drift[:2] == full.drift[:2]
    assert part.heading.pairs == 1


def test_a_heading_is_still_accepted_after_many_fixes_without_one():
    rng, found = np.random.default_rng(6), gated_filter("ekf_fnn")
    for _ in range(200):
        assert found.take(PositionFix(0, *rng.normal(0.0, 0.17, 2).tolist(), R_FIX[:2, :2])) == ACCEPTED
    sigma = math.sqrt(found.memory.belief.P[2, 2])
    assert r_scales(found.memory.adaptation)[1] == 1.0
    # An innovation of three deviations of the heading alone, R_FIX as it is.
    off = 3.0 * math.hypot(sigma, math.sqrt(R_FIX[2, 2]))
    x, y = found.memory.belief.x[:2].tolist()
    assert found.take(replace(Robot(rng).fix(), pose=Pose(x, y, off))) == ACCEPTED
