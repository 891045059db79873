"""Start an executable. A signal during its imports ends it at once, without a traceback.

The imports take a moment, and Python turns SIGINT into a KeyboardInterrupt even in the middle of an import. A running
node handles SIGINT and SIGTERM itself. Until then, both signals end the process with the status of a stopped node.
"""

from __future__ import annotations

import os
import signal
import sys
from functools import partial
from importlib import import_module

_PACKAGES_OF_ROS = ("rclpy", "_interfaces", "_msgs", "_srvs")
"""Suffixes of the names of ROS packages."""
_DEFAULTS = (signal.SIG_DFL, signal.default_int_handler)


def launch(module: str, status: int = 0) -> int:
    """Import ``module`` and run its ``main()``; return its exit status.

    Until ``main`` installs its own handlers, SIGINT and SIGTERM end the process with ``status``. If ROS is missing,
    print one line and return 1.
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
    """Return a text on how to install ROS if the missing module belongs to ROS; empty for other modules."""
    missing = (error.name or "").partition(".")[0]
    how = "source its setup.bash, or install this package with the extra jazzy"
    return f"needs ROS 2 (no module {missing}): {how}" if missing.endswith(_PACKAGES_OF_ROS) else ""


def end_on_signals(status: int) -> None:
    """Make SIGINT and SIGTERM end the process with ``status``, unless they are already ignored or handled."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) in _DEFAULTS:
            signal.signal(number, partial(_end, status))


def _end(status: int, _number: int, _frame: object) -> None:
    # An import may catch an exception. Nothing that needs a clean end has started yet.
    os._exit(status)


if __name__ == "__main__":
    # Usage: python -m diffbot_core.launcher MODULE ...
    raise SystemExit(launch(sys.argv.pop(1)))
