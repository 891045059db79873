"""Compare latency and CPU time of the nodes at 50 Hz, and their steps per second in lock-step, with plain relays.

The latency is the time from the start of the driver's step to its callback for the command. The reference is two rclpy
relays, Odometry -> Odometry -> Twist, which do not compute anything. If all nodes share one process, its CPU time
includes the driver. Each run starts new processes (chain.py). The order of the two sides alternates between rounds.
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
"""The nodes of each process. The source is last, because it begins the measurement."""
ROUNDS, SECONDS, LOCKSTEP_SECONDS = 5, 3.0, 1.0
_ATTEMPTS = 3
_STOP_TIMEOUT = 5.0


def run_chain(scenario: str, side: str, groups: tuple[str, ...], seconds: float) -> dict[str, Any]:
    """Run a chain, and repeat it if messages were lost; return the results of the source, and ``cpu`` [%]."""
    for _ in range(_ATTEMPTS):
        result = run_once(scenario, side, groups, seconds)
        if not result.get("lost") and not result.get("surplus"):
            return result
    counts = f"{result['lost']} lost and {result['surplus']} surplus commands in the last attempt"
    raise SystemExit(f"{scenario} {side}: {_ATTEMPTS} attempts failed, with {counts}")


def run_once(scenario: str, side: str, groups: tuple[str, ...], seconds: float) -> dict[str, Any]:
    """Run a chain once, in the ROS domain of this process."""
    processes = []
    with tempfile.TemporaryDirectory(prefix="diffbot-bench-") as folder:
        environment = {**os.environ, "ROS_LOG_DIR": folder}
        try:
            for group in groups:
                command = [str(Path(__file__).with_name("chain.py")), scenario, side, group, str(seconds)]
                processes.append(start(command, environment, Path(folder, f"{group}.log")))
            source = processes[-1]
            # A source in a process of its own is only a driver, whose CPU time does not count.
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
    """Return the next JSON line of a process; other lines, which libraries print, are skipped."""
    line = next((line for line in process.stdout or () if line.startswith("{")), "")
    if not line:
        logs = "".join(f"--- {log.name}\n{log.read_text()[-1000:]}" for log in sorted(folder.glob("*.log")))
        raise SystemExit(f"a process of the chain ended before it had measured\n{logs}")
    return dict(json.loads(line))


def stop(process: subprocess.Popen[str]) -> None:
    """End a process with SIGINT; kill it after _STOP_TIMEOUT."""
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

    def run_sides(scenario: str, sides: tuple[str, ...], groups: tuple[str, ...], seconds: float) -> dict[str, Any]:
        ordered = sides if number % 2 == 0 else sides[::-1]
        return {side: run_chain(scenario, side, groups, seconds) for side in ordered}

    def compare(name: str, ours: dict[str, Any], bare: dict[str, Any]) -> None:
        medians = (statistics.median(one["latencies"]) for one in (ours, bare))
        table.add(f"{name}: latency, median [ms]", *medians)
        table.add(f"{name}: latency, p99 [ms]", *(p99(one["latencies"]) for one in (ours, bare)))
        table.add(f"{name}: CPU of one core [%]", ours["cpu"], bare["cpu"])

    for name, groups in (("one process", ONE), ("three processes", THREE)):
        found = run_sides("clocked", ("ours", "bare"), groups, seconds)
        compare(name, found["ours"], found["bare"])
    found = run_sides("clocked", ("robot", "bare", "ours"), TWO, seconds)
    compare("robot_node, separate driver", found["robot"], found["bare"])
    inside = (statistics.median(found[side]["inside"]) for side in ("robot", "ours"))
    table.add("robot_node, odometry callback until cmd_vel is sent; reference: two nodes [ms]", *inside)
    for name, groups in (("one process", ONE), ("three processes", THREE)):
        found = run_sides("lockstep", ("ours", "bare"), groups, lockstep_seconds)
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
