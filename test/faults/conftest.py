"""Fixtures of the fault tests: each fault is tried once in ``make test`` and many times in ``make slow``."""

import contextlib
import random

import pytest
from robot import robot
from witness import Witness


@pytest.fixture
def seeded(request):
    """Return random numbers that depend on the name of the test alone."""
    return random.Random(request.node.name)


@pytest.fixture(scope="module")
def observed():
    """Return a context of a robot with its witness; at the end its processes and messages are audited."""

    @contextlib.contextmanager
    def begin(*arguments, **options):
        with robot(*arguments, **options) as running:
            witness = Witness(running)
            yield witness
            witness.audit()

    return begin
