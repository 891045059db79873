"""The covariance of a fit is the inverse curvature at the values of the fit."""

from types import SimpleNamespace

import numpy as np
import pytest

from diffbot_tools.calibration import fit as module
from diffbot_tools.calibration.quantities import Quantity


class Quartic:
    """Replaces the likelihood of a drive by 100 x^4, where each Newton step reduces x by a third."""

    quantities = (Quantity("x", "gyro_factor", (), True, 0.0, -10.0, 10.0),)
    drives = (
        SimpleNamespace(odometry=SimpleNamespace(start=np.zeros(1), end=np.ones(1)), rates=SimpleNamespace(time=())),
    )

    def filtered(self, values):
        """Do nothing."""

    def negative(self, values):
        return 100.0 * float(values[0]) ** 4

    cost = negative


def test_covariance_is_that_of_the_final_values_after_the_last_step(monkeypatch):
    """All four Newton steps reduce the cost, so the last one is the fourth."""
    monkeypatch.setattr(module, "minimize", lambda *_, **__: SimpleNamespace(x=[2.0], fun=1600.0))
    found = module.fit(Quartic(), [np.array([2.0])])
    assert found.values == pytest.approx([2.0 * (2.0 / 3.0) ** 4], rel=0.02)
    curvature = 1200.0 * found.values[0] ** 2
    # Finite differences have steps of 0.1; the prior has a standard deviation of 3.
    assert found.covariance == pytest.approx(1.0 / (curvature + 1.0 / 9.0), rel=0.15)
    assert found.at_bound == [False]
