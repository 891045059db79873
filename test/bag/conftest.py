"""Fixtures of the tests of bags."""

import sys

import pytest


@pytest.fixture
def nodes(monkeypatch):
    """Return what recorders and replays can be added to, in the process of the test."""
    import one_process

    # A replay changes it for its whole process.
    monkeypatch.setattr(sys, "setswitchinterval", lambda _: None)
    with one_process.nodes() as running:
        yield running
