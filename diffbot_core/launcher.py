"""Start an executable whose imports take a moment, so that a signal meanwhile ends it at once, without a traceback.

Python turns SIGINT into a KeyboardInterrupt wherever the program is, also in the middle of an import. A node handles
SIGINT and SIGTERM once it runs; until then, both end the process with the status of a node that was stopped.
"""

from __future__ import annotations

import os
import signal
import sys
from functools import partial
from importlib import import_module

_PACKAGES_OF_ROS = ("rclpy", "_interfaces", "_msgs", "_srvs")
"""Ends of the names of packages that ROS brings; the commands that need no ROS work without them."""
_DEFAULTS = (signal.SIG_DFL, signal.default_int_handler)


def launch(module: str, status: int = 0) -> int:
    """Import ``module`` and run its ``main()``; return its exit status.

    Until ``main`` installs handlers of its own, SIGINT and SIGTERM end the process with ``status``. Where ROS is
    missing, one line says so, and the status is 1.
    """
    end_on_signals(status)
    try:
        result: int = import_module(module).main()
    except ModuleNotFoundError as error:
        if not (hint := ros_hint(error)):
            raise
        print(f"{os.path.basename(sys.argv[0])}: {hint}", file=sys.stderr)
        return 1
    return result


def ros_hint(error: ModuleNotFoundError) -> str:
    """Return what to do if the missing module is one of ROS; empty for other modules."""
    missing = (error.name or "").partition(".")[0]
    how = "source its setup.bash, or install this package with the extra jazzy"
    return f"needs ROS 2 (no module {missing}): {how}" if missing.endswith(_PACKAGES_OF_ROS) else ""


def end_on_signals(status: int) -> None:
    """Let SIGINT and SIGTERM end the process with ``status``; a signal that is ignored or handled already stays so."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) in _DEFAULTS:
            signal.signal(number, partial(_end, status))


def _end(status: int, _number: int, _frame: object) -> None:
    # Not an exception, which an import may catch. Nothing has started that would have to be ended first.
    os._exit(status)


if __name__ == "__main__":
    # python -m diffbot_core.launcher MODULE ...
    raise SystemExit(launch(sys.argv.pop(1)))
