"""Start an executable whose imports take a moment, so that a signal meanwhile ends it without a traceback.

Python turns SIGINT into a KeyboardInterrupt wherever the program is, in the middle of an import, too. A node handles
SIGINT and SIGTERM once it runs; until then both have to do what they do to any other program: end it.
"""

from __future__ import annotations

import signal
from importlib import import_module


def launch(module: str, args: list[str] | None = None) -> int:
    """Import ``module`` and run its ``main(args)``; return its exit status.

    SIGINT ends the process with the status of a signal until ``main`` installs a handler of its own. A process that
    was started with SIGINT ignored, or that has a handler already, keeps it.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    status: int = import_module(module).main(args)
    return status
