"""Keys of a terminal, as ``ros2 bag play`` takes them: read without waiting, and without an Enter. Free of ROS."""

from __future__ import annotations

import atexit
import contextlib
import os
import select
import termios
from collections.abc import Iterator
from typing import Any

TOGGLE, NEXT, FASTER, SLOWER = "toggle", "next", "faster", "slower"
RATE_STEP = 0.1
"""FASTER and SLOWER change the rate by this share of it"""
HELP = "keys: space pauses and resumes, right sends the next message of a paused replay, up and down change the rate"
_KEYS = {
    b" ": TOGGLE,
    # The second form of each arrow is that of terminals in application mode.
    b"\x1b[C": NEXT,
    b"\x1bOC": NEXT,
    b"\x1b[A": FASTER,
    b"\x1bOA": FASTER,
    b"\x1b[B": SLOWER,
    b"\x1bOB": SLOWER,
}
_STARTS = {key[:length] for key in _KEYS for length in range(1, len(key))}
_MAX_READ = 256
"""[bytes] read at once"""


class KeyDecoder:
    """Finds the keys in what a terminal sends; a key may come in parts, other input is ignored."""

    def __init__(self) -> None:
        """Begin without input."""
        self._begun = b""

    def feed(self, data: bytes) -> Iterator[str]:
        """Yield the keys that are complete with ``data``."""
        for index in range(len(data)):
            byte = data[index : index + 1]
            if self._begun + byte not in _KEYS and self._begun + byte not in _STARTS:
                self._begun = b""
            self._begun += byte
            if self._begun in _KEYS:
                yield _KEYS[self._begun]
            if self._begun not in _STARTS:
                self._begun = b""


class Keyboard:
    """A terminal whose keys arrive one by one, unechoed, until :meth:`close` restores it; Ctrl-C works as before."""

    def __init__(self, descriptor: int, before: list[Any]) -> None:
        """Change the modes of a terminal from ``before``; see :func:`open_keyboard`."""
        self._descriptor, self._before = descriptor, before
        self._decoder = KeyDecoder()
        self._claim()
        # For an end without close(): an exception, or sys.exit of somebody else.
        atexit.register(self.close)

    def _claim(self) -> None:
        """Have keys arrive at once and unechoed; a shell that had the terminal meanwhile has changed that back."""
        modes = termios.tcgetattr(self._descriptor)
        if modes[3] & (termios.ICANON | termios.ECHO):
            modes[3] &= ~(termios.ICANON | termios.ECHO)
            modes[6][termios.VMIN], modes[6][termios.VTIME] = 0, 0
            termios.tcsetattr(self._descriptor, termios.TCSADRAIN, modes)

    def pressed(self) -> list[str]:
        """Return the keys pressed since the last call; none while the process is in the background."""
        try:
            # Reading from the background, or changing modes, would stop the process.
            if not in_foreground(self._descriptor):
                return []
            self._claim()
            if not select.select([self._descriptor], [], [], 0)[0]:
                return []
            return list(self._decoder.feed(os.read(self._descriptor, _MAX_READ)))
        except (OSError, termios.error):  # the terminal is gone
            return []

    def close(self) -> None:
        """Restore the terminal, unless another process has it; further calls have no effect."""
        atexit.unregister(self.close)
        before, self._before = self._before, []
        with contextlib.suppress(termios.error, OSError):
            if before and in_foreground(self._descriptor):
                termios.tcsetattr(self._descriptor, termios.TCSADRAIN, before)


def in_foreground(descriptor: int) -> bool:
    """Return whether this process is in the foreground of a terminal, and may read it."""
    return os.tcgetpgrp(descriptor) == os.getpgrp()


def open_keyboard(descriptor: int = 0) -> Keyboard | None:
    """Return the keyboard of stdin, or None if that is no terminal or belongs to another process at present."""
    try:
        if not os.isatty(descriptor) or not in_foreground(descriptor):
            return None
        return Keyboard(descriptor, termios.tcgetattr(descriptor))
    except (OSError, termios.error):
        return None
