"""Speed and memory of the compiled closed loop: a part of ``make bench``.

The machine is shared and noisy: both sides of a ratio are measured right after each other and the median of the rounds
counts; what runs in one thread is measured in CPU time.
"""

from __future__ import annotations

import math
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from diffbot_core.geometry import Pose
from diffbot_lab.paper.experiment import SETTINGS, case_of, starts_of
from diffbot_sim.compiled.batch import HISTORY_COLUMNS, Starts, run_batch
from diffbot_sim.compiled.closed_loop import run_loop

ROUNDS, QUICK_ROUNDS = 9, 3
STEPS = 300
CASE = case_of("law 17", SETTINGS[0])
FILTERED = case_of("law 17", SETTINGS[1])
START = starts_of("a")

FIRST_RUN = """
from diffbot_sim.compiled.batch import run_batch
from diffbot_lab.paper.experiment import SETTINGS, case_of, starts_of

run_batch(case_of("law 17", SETTINGS[0]), starts_of("a"), 1, 0, 1)
"""


@njit(nogil=True, error_model="numpy")
def _wrap(angle):
    if -math.pi < angle <= math.pi:
        return angle
    angle = angle % (2.0 * math.pi)
    return angle - 2.0 * math.pi if angle > math.pi else angle


@njit(nogil=True, error_model="numpy")
def _philox(a, b, c, d, key_low, key_high):
    for _ in range(10):
        first, second = 0xD2511F53 * a, 0xCD9E8D57 * c
        a, b = ((second >> 32) & 0xFFFFFFFF) ^ b ^ key_low, second & 0xFFFFFFFF
        c, d = ((first >> 32) & 0xFFFFFFFF) ^ d ^ key_high, first & 0xFFFFFFFF
        key_low, key_high = (key_low + 0x9E3779B9) & 0xFFFFFFFF, (key_high + 0xBB67AE85) & 0xFFFFFFFF
    unit = 2.0**-32
    return (2.0 * a + 1.0) * unit - 1.0, (2.0 * b + 1.0) * unit - 1.0, (2.0 * c + 1.0) * unit - 1.0


@njit(nogil=True, error_model="numpy")
def reference_kernel(start, seed, first, steps, outcomes):
    """Simulation A under law (17) with the paper's noise, written by hand for this one case: plain numbers only."""
    gamma, k, h, k_2, t_s, radius = 1.3, 1.0, 0.17, 2.7, 0.1, 0.5
    for index in range(len(outcomes)):
        run = first + index
        x, y, theta = start[0], start[1], start[2]
        last_outside, path, effort, local_time, switches, region = -1, 0.0, 0.0, math.nan, 0, 0
        seen_x = seen_y = 0.0
        for step in range(steps + 1):
            a, b, c = _philox(step, 1, run & 0xFFFFFFFF, run >> 32, seed & 0xFFFFFFFF, seed >> 32)
            seen_x, seen_y, seen_theta = x + 0.3 * a, y + 0.3 * b, _wrap(theta + 0.17 * c)
            rho = math.hypot(seen_x, seen_y)
            beta = math.atan2(0.0 - seen_y, 0.0 - seen_x)
            alpha = _wrap(beta - seen_theta)
            near = 1 if (rho <= radius if region == 1 else rho < radius) else 0
            switches += near != region
            region = near
            cosine, tangent = math.cos(alpha), math.tanh(rho)
            v = gamma * tangent * cosine
            if region == 1:
                omega = -k_2 * seen_theta
            else:
                sinc = math.sin(alpha) / alpha if abs(alpha) >= 1e-4 else 1.0 - alpha * alpha / 6.0
                slope = tangent / rho if rho >= 1e-4 else 1.0 - rho * rho / 3.0
                omega = k * alpha + gamma * sinc * slope * cosine * (alpha + h * beta)
            if math.hypot(x, y) > 0.4 or abs(theta) > 0.1:
                last_outside = step
            if region == 1 and math.isnan(local_time):
                local_time = step * t_s
            if step < steps:
                effort += (v * v + omega * omega) * t_s
                a, b, c = _philox(step, 0, run & 0xFFFFFFFF, run >> 32, seed & 0xFFFFFFFF, seed >> 32)
                forward = t_s * (v + 0.065 * a)
                dx, dy = forward * math.cos(theta), forward * math.sin(theta)
                x, y, theta = x + dx, y + dy, _wrap(theta + t_s * (omega + 0.2167 * b))
                path += math.hypot(dx, dy)
        row = outcomes[index]
        row[0], row[1], row[2] = x, y, theta
        row[3] = (last_outside + 1) * t_s if last_outside < steps else math.nan
        row[4], row[5], row[6], row[7] = path, effort, switches, local_time
        row[8] = math.hypot(seen_x - x, seen_y - y)


def reference(count: int) -> Any:
    """Do ``count`` runs with the hand-written kernel."""
    outcomes = np.empty((count, 9))
    reference_kernel(START.poses[0], 1, 0, STEPS, outcomes)
    return outcomes


def row(
    measure: str, unit: str, ours: float, other: float | None, compared: float, target: str, met: bool
) -> dict[str, Any]:
    """Return one row; the target is compared with the ratio where there is another side."""
    ratio = compared if other is not None else None
    return {
        "measure": measure,
        "unit": unit,
        "ours": ours,
        "reference": other,
        "ratio": ratio,
        "target": target,
        "met": met,
    }


def seconds(call: Callable[[], Any], clock: Callable[[], float] = time.perf_counter) -> float:
    """Time one call."""
    begin = clock()
    call()
    return clock() - begin


def against_python(quick: bool) -> dict[str, Any]:
    """Compare all threads with the same loop as plain Python."""
    count, nothing = 4000, np.empty((0, len(HISTORY_COLUMNS)))
    ours, others, ratios = [], [], []
    for _ in range(QUICK_ROUNDS if quick else ROUNDS):
        mine = seconds(lambda: run_batch(CASE, START, 1, 0, count)) / (count * STEPS)
        other = seconds(lambda: run_loop(CASE, 1, 0, Pose(*START.poses[0]), nothing)) / STEPS
        ours.append(1e9 * mine)
        others.append(1e9 * other)
        ratios.append(other / mine)
    ratio = statistics.median(ratios)
    name = "closed loop without filter: plain Python over compiled, all threads"
    return row(name, "ns/step", statistics.median(ours), statistics.median(others), ratio, ">= 70 x", ratio >= 70.0)


def against_kernel(quick: bool) -> dict[str, Any]:
    """Compare one thread with a kernel written by hand for one case."""
    count = 1000
    np.testing.assert_allclose(reference(20), run_batch(CASE, START, 1, 0, 20), rtol=1e-9, atol=1e-9)
    ours, others, ratios = [], [], []
    for _ in range(QUICK_ROUNDS if quick else 2 * ROUNDS):
        mine = seconds(lambda: run_batch(CASE, START, 1, 0, count, threads=1), time.process_time) / (count * STEPS)
        other = seconds(lambda: reference(count), time.process_time) / (count * STEPS)
        ours.append(1e9 * mine)
        others.append(1e9 * other)
        ratios.append(mine / other)
    ratio = statistics.median(ratios)
    name = "closed loop without filter, one thread: over a kernel written by hand"
    return row(name, "ns/step", statistics.median(ours), statistics.median(others), ratio, "<= 1.25 x", ratio <= 1.25)


def two_threads(quick: bool) -> dict[str, Any]:
    """Compare two threads with one."""
    count = 6000
    ours, others, ratios = [], [], []
    for _ in range(QUICK_ROUNDS if quick else ROUNDS):
        one, two = (seconds(lambda n=n: run_batch(CASE, START, 1, 0, count, threads=n)) for n in (1, 2))
        ours.append(1e9 * two / (count * STEPS))
        others.append(1e9 * one / (count * STEPS))
        ratios.append(one / two)
    ratio = statistics.median(ratios)
    name = "closed loop without filter: one thread over two"
    return row(name, "ns/step", statistics.median(ours), statistics.median(others), ratio, ">= 1.8 x", ratio >= 1.8)


def with_filter(quick: bool) -> dict[str, Any]:
    """Steps per second with the EKF in the loop."""
    count = 4000
    rates = []
    for _ in range(QUICK_ROUNDS if quick else ROUNDS):
        rates.append(1e-6 * count * STEPS / seconds(lambda: run_batch(FILTERED, START, 1, 0, count)))
    rate = statistics.median(rates)
    return row("closed loop with EKF, all threads", "M steps/s", rate, None, rate, ">= 3 M steps/s", rate >= 3.0)


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


def peak_memory(command: list[str]) -> int:
    """Run a command; return the largest sum [byte] of what it and its children held, what they share counted twice."""
    peak = 0
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        done = threading.Event()
        while process.poll() is None:
            peak = max(peak, sum(map(_resident, _tree(process.pid))))
            done.wait(0.01)
    if process.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} failed")
    return peak


def memory(quick: bool) -> dict[str, Any]:
    """Peak of a campaign of very many short runs with its two workers."""
    runs = 10**6 if quick else 10**7
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "diffbot_lab.cli", "campaign", "--runs", str(runs), "--duration", "0.1"]
        peak = peak_memory([*command, "--workers", "2", "--out", folder]) / 2**30
    return row(f"campaign of {runs:.0e} runs, 2 workers: memory", "GiB", peak, None, peak, "< 1 GiB", peak < 1.0)


def _first_run(cache: str) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "XDG_CACHE_HOME": cache}
    environment.pop("NUMBA_CACHE_DIR", None)
    subprocess.run([sys.executable, "-c", FIRST_RUN], check=True, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def compilation(quick: bool) -> list[dict[str, Any]]:
    """From nothing to the first run done, without and with the cache."""
    cold, warm = [], []
    for _ in range(1 if quick else 3):
        with tempfile.TemporaryDirectory() as cache:
            cold.append(_first_run(cache))
            warm.append(_first_run(cache))
    first, again = statistics.median(cold), statistics.median(warm)
    return [
        row("start and first run, empty cache: CPU", "s", first, None, first, "<= 3 s", first <= 3.0),
        row("start and first run, warm cache: CPU", "s", again, None, again, "", True),
    ]


def experiments(quick: bool) -> dict[str, Any]:
    """Time the paper's experiments with all figures."""
    runs = 10 if quick else 100
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable,
            "-m",
            "diffbot_lab.cli",
            "experiment",
            "a",
            "b",
            "--runs",
            str(runs),
            "--out",
            folder,
        ]
        took = seconds(lambda: subprocess.run(command, check=True, capture_output=True))
    name = f"experiments a and b, {runs} runs of each start, all figures"
    return row(name, "s", took, None, took, "<= 30 s", took <= 30.0)


def run(quick: bool) -> list[dict[str, Any]]:
    """Measure all: rows with measure, unit, ours, reference, ratio, target, met."""
    run_batch(CASE, Starts(START.poses), 1, 0, 2)
    run_batch(FILTERED, Starts(START.poses), 1, 0, 2)
    rows = [part(quick) for part in (against_python, against_kernel, two_threads, with_filter, memory, experiments)]
    return rows + compilation(quick)


def main() -> None:
    """Print the rows."""
    for one in run("--quick" in sys.argv):
        other = "" if one["reference"] is None else f"{one['reference']:.4g} {one['unit']}"
        ratio = "" if one["ratio"] is None else f"{one['ratio']:.2f}"
        met = "yes" if one["met"] else "NO"
        ours = f"{one['ours']:.4g} {one['unit']}"
        print(f"{one['measure']:<72}{ours:>20}{other:>20}{ratio:>9}  {one['target']:<16}{met}")


if __name__ == "__main__":
    main()
