"""Pseudo-terminals for processes that read keys."""

import fcntl
import os
import pty
import termios

import pytest


@pytest.fixture
def terminal():
    """Return both ends of a pseudo-terminal: ours and theirs."""
    ours, theirs = pty.openpty()
    yield ours, theirs
    os.close(ours)
    os.close(theirs)


def in_terminal(theirs):
    """Return the options of a process whose stdin is this terminal, in its foreground."""
    return {
        "stdin": theirs,
        "start_new_session": True,
        "preexec_fn": lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        "cwd": "/",  # not the source tree, where a program of -c would find the package first
    }
