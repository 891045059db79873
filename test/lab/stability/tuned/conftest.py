"""One small certificate of the tuned law for all tests."""

import pytest

from diffbot_control.law.configuration import ControllerConfig
from diffbot_lab.stability.tuned.certify import certify
from diffbot_lab.stability.tuned.contract import Plan

PLAN = Plan(finish=True, to=1.9, fineness=0.4)


@pytest.fixture(scope="session")
def certificate():
    return certify(ControllerConfig(), PLAN)
