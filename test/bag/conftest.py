"""Fixtures of the tests of bags."""

import os
import pty
import sys

import pytest


@pytest.fixture
def terminal():
    """Return both ends of a pseudo-terminal: ours and theirs."""
    ours, theirs = pty.openpty()
    yield ours, theirs
    os.close(ours)
    os.close(theirs)


@pytest.fixture
def nodes(monkeypatch):
    """Return what recorders and replays can be added to, in the process of the test."""
    import one_process

    # A replay changes it for its whole process.
    monkeypatch.setattr(sys, "setswitchinterval", lambda _: None)
    with one_process.nodes() as running:
        yield running
