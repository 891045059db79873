"""One small certificate of the tuned law for all tests: far from the goal, where large cells suffice."""

import pytest

from diffbot_control.law.configuration import ControllerConfig
from diffbot_lab.stability.tuned.certify import certify, tuned_loop
from diffbot_lab.stability.tuned.contract import Contract, Plan
from diffbot_lab.stability.tuned.near import near_bounds


@pytest.fixture(scope="session")
def plan():
    config, contract = ControllerConfig(), Contract()
    near = near_bounds(tuned_loop(config, contract), config, contract.sigma_max)
    return Plan(to=1.9, margin=1.3 - near.holding, fineness=0.4)


@pytest.fixture(scope="session")
def certificate(plan):
    return certify(ControllerConfig(), plan)
