"""Start an executable whose imports take a moment, so that a signal meanwhile ends it at once, without a traceback.

Python turns SIGINT into a KeyboardInterrupt wherever the program is, in the middle of an import, too. A node handles
SIGINT and SIGTERM once it runs; from here until then, both end the process with the status of a node that was stopped.
Before, while the interpreter itself starts (some 50 ms), no code of this project runs: a signal then has the effect
that Python gives it.
"""

from __future__ import annotations

import os
import signal
import sys
from functools import partial
from importlib import import_module

_PACKAGES_OF_ROS = ("rclpy", "_interfaces", "_msgs", "_srvs")
"""How the names end of what ROS brings; without it, the commands that need no ROS work all the same."""
_DEFAULTS = (signal.SIG_DFL, signal.default_int_handler)


def launch(module: str, args: list[str] | None = None, status: int = 0) -> int:
    """Import ``module`` and run its ``main(args)``; return its exit status.

    Until ``main`` installs handlers of its own, SIGINT and SIGTERM end the process with ``status``. Where ROS is
    missing, one line says so, and the status is 1.
    """
    end_on_signals(status)
    try:
        result: int = import_module(module).main(args)
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if not missing.endswith(_PACKAGES_OF_ROS):
            raise
        how = "source its setup.bash, or install this package with the extra jazzy"
        print(f"{os.path.basename(sys.argv[0])}: needs ROS 2 (no module {missing}): {how}", file=sys.stderr)
        return 1
    return result


def end_on_signals(status: int) -> None:
    """Let SIGINT and SIGTERM end the process with ``status``; a signal that is ignored or handled already stays so."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) in _DEFAULTS:
            # Nothing has begun that would have to be ended first.
            signal.signal(number, partial(_end, status))


def _end(status: int, _number: int, _frame: object) -> None:
    # No exception, which an import may catch, or report as ignored where it cannot be raised.
    os._exit(status)
