"""Rounds of paired measurements, and the table of their ratios.

Each round measures this project and its reference one right after the other, so that other work of the machine affects
both. Absolute times differ between machines, so the table shows the median and the range of the ratio over the rounds.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time
from pathlib import Path


class Table:
    """The measures of all rounds."""

    def __init__(self) -> None:
        self._rounds: dict[str, list[tuple[float, float | None]]] = {}

    def add(self, measure: str, ours: float, reference: float | None = None) -> None:
        """Add one round of a measure; without a reference, the table shows the range of ``ours``."""
        self._rounds.setdefault(measure, []).append((ours, reference))

    def show(self) -> None:
        """Print the table."""
        rows = [("measure", "ours", "reference", "ratio", "range", "rounds")]
        for measure, pairs in self._rounds.items():
            ours = statistics.median(one for one, _ in pairs)
            references = [reference for _, reference in pairs if reference is not None]
            ratios = [one / reference for one, reference in pairs if reference is not None]
            spread = ratios or [one for one, _ in pairs]
            rows.append(
                (
                    measure,
                    f"{ours:.3g}",
                    f"{statistics.median(references):.3g}" if references else "",
                    f"{statistics.median(ratios):.2f}" if ratios else "",
                    f"{min(spread):.3g} to {max(spread):.3g}",
                    str(len(pairs)),
                )
            )
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        for row in rows:
            print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def is_quick(description: str) -> bool:
    """Read the command line; return True if one short round is requested, to check that the program runs."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="run one short round, to check that the program runs")
    return parser.parse_args().quick


def start(command: list[str], environment: dict[str, str], log: Path) -> subprocess.Popen[str]:
    """Start a process whose output is read line by line and whose errors go to a file."""
    with log.open("w") as errors:
        return subprocess.Popen(
            [sys.executable, *command], env=environment, stdout=subprocess.PIPE, stderr=errors, text=True
        )


def cpu_seconds(processes: list[subprocess.Popen[str]]) -> float:
    """Return the CPU time [s] of all threads of the processes so far, user and system."""
    # This is the clock id that glibc's clock_getcpuclockid returns. /proc/PID/stat has a resolution of only 10 ms.
    return sum(time.clock_gettime((~process.pid << 3) | 2) for process in processes)
