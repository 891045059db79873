"""Run a command that ends when its parent does, whatever ends the parent: ``bound_process.py PARENT COMMAND ...``.

The kernel sends SIGTERM (prctl, PR_SET_PDEATHSIG) even if the parent was killed and could stop nothing: a recorder then
still closes its bag. The process becomes the command, so its id, signals and status are the command's. It runs as a
file of its own, since code between fork and exec of a process with threads is unsafe.
"""

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1
"""of <sys/prctl.h>"""


def main(arguments: list[str]) -> None:
    """Bind this process to the parent with the id ``arguments[0]`` and become the command that follows."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, int(signal.SIGTERM))
    # A parent that died before the call above sends no signal.
    if os.getppid() == int(arguments[0]):
        os.execv(arguments[1], arguments[1:])


if __name__ == "__main__":
    main(sys.argv[1:])
