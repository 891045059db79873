"""Fixtures of the tests of the command line."""

import signal

import pytest


@pytest.fixture
def kept_signal_handlers():
    """Restore the signal handlers of the test process: the command line sets its own."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)
