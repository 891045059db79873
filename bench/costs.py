"""What a command costs: time, CPU time and memory of a process and its children."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import graph
from measures import BenchError

DIFFBOT = (sys.executable, "-m", "diffbot_tools.cli")
_POLL = 0.005
"""[s] between two looks at the memory"""


class Cost(NamedTuple):
    """What a command took."""

    wall: float
    """[s]"""
    cpu: float
    """[s]"""
    memory: float
    """[MB] largest sum of what it and its children held; what they share is counted twice"""


def cost_of(*command: object, **options: Any) -> Cost:
    """Run a command to its end; ``options`` are those of Popen.

    Raises:
        BenchError: if it fails.
    """
    words = list(map(str, command))
    options.setdefault("env", graph.environment())
    begin, peak = time.monotonic(), 0
    child = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **options)
    try:
        while True:
            ended, status, used = os.wait4(child.pid, os.WNOHANG)
            if ended:
                break
            peak = max(peak, sum(map(_resident, _tree(child.pid))))
            time.sleep(_POLL)
        child.returncode = os.waitstatus_to_exitcode(status)
    finally:
        if child.returncode is None:
            child.kill()
            child.wait()
    if child.returncode:
        raise BenchError(f"{' '.join(words)}: exit status {child.returncode}")
    return Cost(time.monotonic() - begin, used.ru_utime + used.ru_stime, peak / 1e6)


def _tree(pid: int) -> list[int]:
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return []
    return [pid, *(one for child in children for one in _tree(int(child)))]


def _resident(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0
