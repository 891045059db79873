"""Read keys of a terminal without blocking and without Enter, as ``ros2 bag play`` does. Does not need ROS."""

from __future__ import annotations

import atexit
import contextlib
import os
import re
import select
import termios
import tty

SPACE, RIGHT, UP, DOWN = " ", "C", "A", "B"
_KEYS = re.compile(rb" |\x1b[\[O]([ABC])")
"""Space bar and arrow keys; a terminal in application mode sends O instead of [."""


class Keyboard:
    """The terminal of stdin. Until :meth:`close`, it sends each key at once and does not echo it.

    Ctrl-C works as usual. Without a terminal, or while this process is in the background, no keys are returned.
    """

    def __init__(self, descriptor: int = 0) -> None:
        """Prepare the terminal of a file descriptor."""
        self._descriptor = descriptor
        self._saved_mode = termios.tcgetattr(descriptor) if self._is_foreground() else None
        # The process may end without close(), by an exception or sys.exit.
        atexit.register(self.close)

    @property
    def is_open(self) -> bool:
        """True if there is a terminal."""
        return self._saved_mode is not None

    def _is_foreground(self) -> bool:
        """Return True if this process is in the foreground; reading in the background would stop the process."""
        try:
            return os.isatty(self._descriptor) and os.tcgetpgrp(self._descriptor) == os.getpgrp()
        except OSError:
            return False

    def pressed(self) -> list[str]:
        """Return the keys pressed since the last call."""
        if not self.is_open or not self._is_foreground():
            return []
        with contextlib.suppress(OSError, termios.error):  # the terminal was closed
            # After Ctrl-Z and fg, the shell has restored the mode of the terminal.
            if termios.tcgetattr(self._descriptor)[3] & termios.ICANON:
                tty.setcbreak(self._descriptor, termios.TCSADRAIN)
            if select.select([self._descriptor], [], [], 0)[0]:
                return [
                    match[1].decode() if match[1] else SPACE for match in _KEYS.finditer(os.read(self._descriptor, 256))
                ]
        return []

    def close(self) -> None:
        """Restore the mode of the terminal, unless this process is in the background."""
        atexit.unregister(self.close)
        mode, self._saved_mode = self._saved_mode, None
        if mode is not None and self._is_foreground():
            with contextlib.suppress(OSError, termios.error):
                termios.tcsetattr(self._descriptor, termios.TCSADRAIN, mode)
