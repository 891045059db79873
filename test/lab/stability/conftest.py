"""One small certificate for all tests. It has large cells, which suffice far from the goal."""

import pytest

from diffbot_control.law.configuration import SwitchingConfig
from diffbot_lab.stability.maker import certify, holding_radius
from diffbot_lab.stability.plan import Plan, ideal_law


@pytest.fixture(scope="session")
def plan():
    near = holding_radius(ideal_law(SwitchingConfig(), Plan()), Plan())
    return Plan(to=1.5, margin=1.3 - near, fineness=0.4)


@pytest.fixture(scope="session")
def certificate(plan):
    return certify(SwitchingConfig(), plan)
