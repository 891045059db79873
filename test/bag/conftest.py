"""Fixtures of the tests of bags."""

import sys

import pytest


@pytest.fixture
def nodes(monkeypatch):
    """Yield the nodes in the process of the test, to which recorders and replays can be added."""
    import one_process

    # A replay changes the switch interval of its whole process.
    monkeypatch.setattr(sys, "setswitchinterval", lambda _: None)
    with one_process.nodes() as running:
        yield running
