"""The parent's side of the chains: start the processes of one turn, read their clocks, end them.

A turn is one side (ours or bare) of one scenario with fresh processes. A round is one turn of each side, one right
after the other, so that what else the machine does meets both; the order changes from round to round.
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import graph
from measures import BenchError

CLOCKED, LOCKSTEP = "clocked", "lockstep"
OURS, BARE, ROBOT = "ours", "bare", "robot"
ONE = ("source,filter,control",)
TWO = ("filter,control", "source")
THREE = ("filter", "control", "source")
"""Which nodes share a process; the source comes last because it begins to measure."""
_STOP_TIMEOUT = 5.0
_ATTEMPTS = 3


class Chains:
    """Runs turns on the DDS domain of this process; logs of the processes go to ``folder``."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "chains"
        self.folder.mkdir(exist_ok=True)
        self._environment = graph.environment(ROS_LOG_DIR=str(folder / "ros"))
        # With a safe path a script does not find the modules beside it.
        self._environment["PYTHONPATH"] += os.pathsep + str(Path(__file__).parent)

    def turn(self, scenario: str, side: str, groups: tuple[str, ...], seconds: float) -> dict[str, Any]:
        """Run one turn, again if messages were lost; what the source measured, and ``cpu`` in per cent.

        Raises:
            BenchError: if a process failed or messages were lost each time.
        """
        for _ in range(_ATTEMPTS):
            result = self._attempt(scenario, side, groups, seconds)
            if not result.get("lost") and not result.get("unasked"):
                return result
        raise BenchError(f"{scenario} {side}: {result['lost']} commands lost, {result['unasked']} too many")

    def turns(
        self, number: int, scenario: str, sides: tuple[str, ...], groups: tuple[str, ...], seconds: float
    ) -> dict[str, dict[str, Any]]:
        """Run the turns of all sides in round ``number``, every other time in the reverse order."""
        ordered = sides if number % 2 == 0 else sides[::-1]
        return {side: self.turn(scenario, side, groups, seconds) for side in ordered}

    def _attempt(self, scenario: str, side: str, groups: tuple[str, ...], seconds: float) -> dict[str, Any]:
        processes: list[subprocess.Popen[str]] = []
        for log in self.folder.glob("*.log"):
            log.unlink()
        try:
            for group in groups:
                processes.append(self._start(scenario, side, group, seconds))
            source = processes[-1]
            # The source is a bare driver, not part of what is measured, unless all share one process.
            measured = processes[:-1] or processes
            self._expect("begin", source)
            began, used = time.monotonic(), cpu_seconds(measured)
            result = self._expect("end", source)
            result["cpu"] = 100.0 * (cpu_seconds(measured) - used) / (time.monotonic() - began)
            if groups == TWO and side != BARE:
                processes[0].send_signal(signal.SIGINT)
                result["inside"] = self._expect("inside", processes[0])["durations"]
            return result
        finally:
            for process in reversed(processes):
                stop(process)

    def _start(self, scenario: str, side: str, group: str, seconds: float) -> subprocess.Popen[str]:
        script = Path(__file__).with_name("chain_nodes.py")
        command = [sys.executable, str(script), scenario, side, group, str(seconds)]
        with (self.folder / f"{group}.log").open("w") as log:
            return subprocess.Popen(
                command,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                start_new_session=True,  # Ctrl-C is for the parent, who ends them
            )

    def _expect(self, event: str, source: subprocess.Popen[str]) -> dict[str, Any]:
        """Read the next event of the source; it ends itself when it waits for too long.

        Libraries under the nodes may print lines of their own: an event is a line with a JSON object.
        """
        assert source.stdout is not None
        line = next((line for line in source.stdout if line.startswith("{")), "")
        if not line:
            logs = {log.stem: log.read_text().strip().splitlines() for log in sorted(self.folder.glob("*.log"))}
            last = " | ".join(f"{name}: {text[-1]}" for name, text in logs.items() if text) or "none"
            raise BenchError(f"no '{event}' from its process; last words: {last}")
        result: dict[str, Any] = json.loads(line)
        return result


def stop(process: subprocess.Popen[str]) -> None:
    """End a process with SIGINT; kill it if it does not listen."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    try:
        process.wait(timeout=_STOP_TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout is not None:
        process.stdout.close()


def cpu_seconds(processes: list[subprocess.Popen[str]]) -> float:
    """CPU time [s] of all threads of the processes so far, user and system."""
    # The clock of another process, as glibc's clock_getcpuclockid names it: to the ns, /proc/PID/stat has but 10 ms.
    return sum(time.clock_gettime((~process.pid << 3) | 2) for process in processes)


def percentile(values: list[float], share: float) -> float:
    """Smallest value that is not exceeded by ``share`` of ``values``."""
    return sorted(values)[max(math.ceil(share * len(values)) - 1, 0)]
