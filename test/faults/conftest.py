"""Fixtures of the fault tests."""

import contextlib
import random

import pytest
from robot import robot
from witness import Witness


@pytest.fixture
def seeded(request):
    """Return a random generator whose seed is the name of the test."""
    return random.Random(request.node.name)


@pytest.fixture(scope="module")
def observed():
    """Return a context manager of a robot and its witness, which audits processes and messages at the end."""

    @contextlib.contextmanager
    def begin(*arguments, **options):
        with robot(*arguments, **options) as running:
            witness = Witness(running)
            yield witness
            witness.audit()

    return begin
