"""Latency and CPU time of the nodes at 50 Hz, and steps per second in lock-step, compared with relays.

The latency is the time from the start of the driver's step to the driver's callback for the command. The reference is
two rclpy relays that compute nothing, Odometry -> Odometry -> Twist. The CPU time of one process includes the driver.
Each measurement starts new processes (chain.py). The order of the sides alternates from round to round.
"""

from __future__ import annotations

import json
import math
import os
import signal
import statistics
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

from rounds import Table, cpu_seconds, is_quick, start
from tqdm import tqdm

from diffbot_tools.processes import PrivateDomain, graph_environment

ONE = ("source,filter,control",)
TWO = ("filter,control", "source")
THREE = ("filter", "control", "source")
"""The nodes of each process. The source is started last, because it starts the measurement."""
ROUNDS, SECONDS, LOCKSTEP_SECONDS = 5, 3.0, 1.0
_ATTEMPTS = 3
_STOP_TIMEOUT = 5.0


def turn(scenario: str, side: str, groups: tuple[str, ...], seconds: float) -> dict[str, Any]:
    """Measure once, and again if messages were lost; return the report of the source, and ``cpu`` in per cent."""
    for _ in range(_ATTEMPTS):
        result = attempt(scenario, side, groups, seconds)
        if not result.get("lost") and not result.get("unasked"):
            return result
    raise SystemExit(f"{scenario} {side}: {result['lost']} commands lost, {result['unasked']} too many")


def attempt(scenario: str, side: str, groups: tuple[str, ...], seconds: float) -> dict[str, Any]:
    """Measure once."""
    processes = []
    with tempfile.TemporaryDirectory(prefix="diffbot-bench-") as folder:
        environment = {**os.environ, "ROS_LOG_DIR": folder}
        try:
            for group in groups:
                command = [str(Path(__file__).with_name("chain.py")), scenario, side, group, str(seconds)]
                processes.append(start(command, environment, Path(folder, f"{group}.log")))
            source = processes[-1]
            # The CPU time of the source does not count, unless all nodes are in one process.
            measured = processes[:-1] or processes
            read(source, Path(folder))
            began, used = time.monotonic(), cpu_seconds(measured)
            result = read(source, Path(folder))
            result["cpu"] = 100.0 * (cpu_seconds(measured) - used) / (time.monotonic() - began)
            if groups == TWO and side != "bare":
                processes[0].send_signal(signal.SIGINT)
                result |= read(processes[0], Path(folder))
            return result
        finally:
            for process in reversed(processes):
                stop(process)


def read(process: subprocess.Popen[str], folder: Path) -> dict[str, Any]:
    """Return the next JSON line of a process. Other lines may come from libraries."""
    line = next((line for line in process.stdout or () if line.startswith("{")), "")
    if not line:
        logs = "".join(f"--- {log.name}\n{log.read_text()[-1000:]}" for log in sorted(folder.glob("*.log")))
        raise SystemExit(f"a process of the chain ended before it reported\n{logs}")
    return dict(json.loads(line))


def stop(process: subprocess.Popen[str]) -> None:
    """End a process by SIGINT, or kill it after a timeout."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    try:
        process.wait(timeout=_STOP_TIMEOUT)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def p99(values: list[float]) -> float:
    """Return the smallest value that 99 % of the values do not exceed."""
    return sorted(values)[math.ceil(0.99 * len(values)) - 1]


def measure_round(table: Table, number: int, seconds: float, lockstep_seconds: float) -> None:
    """Measure each arrangement of processes once."""

    def turns(scenario: str, sides: tuple[str, ...], groups: tuple[str, ...], seconds: float) -> dict[str, Any]:
        ordered = sides if number % 2 == 0 else sides[::-1]
        return {side: turn(scenario, side, groups, seconds) for side in ordered}

    def compare(name: str, ours: dict[str, Any], bare: dict[str, Any]) -> None:
        medians = (statistics.median(one["latencies"]) for one in (ours, bare))
        table.add(f"{name}: latency, median [ms]", *medians)
        table.add(f"{name}: latency, p99 [ms]", *(p99(one["latencies"]) for one in (ours, bare)))
        table.add(f"{name}: CPU of one core [%]", ours["cpu"], bare["cpu"])

    for name, groups in (("one process", ONE), ("three processes", THREE)):
        found = turns("clocked", ("ours", "bare"), groups, seconds)
        compare(name, found["ours"], found["bare"])
    found = turns("clocked", ("robot", "bare", "ours"), TWO, seconds)
    compare("robot_node, driver in another process", found["robot"], found["bare"])
    inside = (statistics.median(found[side]["inside"]) for side in ("robot", "ours"))
    table.add("robot_node, odometry's callback to cmd_vel sent, reference: two nodes [ms]", *inside)
    for name, groups in (("one process", ONE), ("three processes", THREE)):
        found = turns("lockstep", ("ours", "bare"), groups, lockstep_seconds)
        table.add(f"lock-step, {name} [steps/s]", found["ours"]["rate"], found["bare"]["rate"])


def main() -> None:
    """Measure, and print the table."""
    quick, table, domain = is_quick(__doc__.splitlines()[0]), Table(), PrivateDomain()
    os.environ |= graph_environment(domain.id)
    for number in tqdm(range(1 if quick else ROUNDS), "latency", unit=" rounds", leave=False, disable=None):
        measure_round(table, number, *((0.6, 0.4) if quick else (SECONDS, LOCKSTEP_SECONDS)))
    domain.release()
    table.show()


if __name__ == "__main__":
    main()
