"""The compiled filter takes fixes of any covariance as filterpy's does; test_batch.py compares the rest, in drives."""

import numpy as np
import pytest
from filter_runs import SEPARATION, build_motion, covariance, fix

from diffbot_control.filter.dock import FixNoise
from diffbot_control.filter.gate import ACCEPTED, REJECTED
from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.options import FILTERS, FilterConfig, options_of
from diffbot_core.geometry import Pose
from diffbot_sim.compiled import gated_filter as twin
from diffbot_sim.compiled.late_fusion import WITH_WHEELS


def twin_fix(pose, R):
    return twin.PoseFix(Pose(*pose), FixNoise(R[0, 0], R[0, 1], R[1, 1], R[0, 2], R[1, 2], R[2, 2]))


@pytest.mark.parametrize("variant", FILTERS)
def test_fixes_with_correlated_errors_are_taken_as_by_filterpys(variant):
    rng, options = np.random.default_rng(1), options_of(FilterConfig(filter=variant))
    reference, arrays = GatedFilter(options, SEPARATION), np.zeros(1, WITH_WHEELS.filter.dtype)[0]
    twin.reset_arrays(arrays, options)
    start, R, outcomes = (1.0, -2.0, 3.1), covariance(rng, 3, 0.05, 0.3), set()
    reference.reset_to(Pose(*start), R)
    track = twin.take_fix(twin.new_track(), arrays, twin_fix(start, R), options)
    for number in range(30):
        motion = build_motion(0.0, 0.0, 0.1, 0.01, 0.005, 0.02)
        reference.predict(motion)
        track = twin.advance(track, arrays, motion, SEPARATION, options)
        pose, R = rng.normal(start, 2.0 if number % 10 == 9 else 0.1), covariance(rng, 3, 0.05, 0.3)
        outcomes.add(reference.take(fix(*pose, R)))
        track = twin.take_fix(track, arrays, twin_fix(pose, R), options)
        assert track.newest.nis == pytest.approx(reference.nis, rel=1e-9)
        x, P = reference.memory.belief
        np.testing.assert_allclose(arrays["belief"]["x"][:3], x[:3], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(arrays["belief"]["P"][:3, :3], P[:3, :3], rtol=0.0, atol=1e-9)
    assert outcomes == {ACCEPTED, REJECTED}
