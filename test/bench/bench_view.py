"""The page: time, size and memory of reports, what ``diffbot watch`` costs the robot, frames per second.

``python test/bench/bench_view.py``, also run by ``make bench``; ``--long`` adds the report of two hours, whose bag
takes minutes to write. Figures against the targets of docs/results/browser.md; a missed target is reported, and
is no error.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import browser
import numpy as np
from bench_graph import CLOCKED, OURS, THREE, Chains, cpu_seconds, percentile
from bench_table import BenchError
from websockets.sync.client import connect

from diffbot_bag.encoding import ODOMETRY, POSE, Encoder, NumbersMessage
from diffbot_bag.new_bag import new_bag
from diffbot_bag.qos import Qos
from diffbot_lab.demo.processes import PrivateDomain
from diffbot_lab.view.live_state import COLUMNS, LiveState
from diffbot_lab.view.server import Address, PageServer

RATE = 50
BEGIN = 1_700_000_000_000_000_000
DIFFBOT = (sys.executable, "-m", "diffbot_lab.cli")


def write_noisy_bag(folder: Path, seconds: float) -> None:
    """Write truth, estimate, odometry, fixes and commands at 50 Hz, with noise in every number: nothing packs well."""
    rng = np.random.default_rng(1)
    topics = {"/pose": POSE, "/ground_truth": ODOMETRY, "/odom": ODOMETRY, "/global_pose": POSE}
    twist = Encoder()
    with new_bag(folder) as writer:
        qos = (Qos(reliability="reliable", durability="volatile"),)
        messages = [
            (writer.add_topic(name, kind, qos), NumbersMessage(kind, "map", "base_link"))
            for name, kind in topics.items()
        ]
        commands = writer.add_topic("/cmd_vel", "geometry_msgs/msg/Twist", qos)
        for step in range(int(seconds * RATE)):
            stamp = BEGIN + step * 10**9 // RATE
            angle = 0.1 * step / RATE
            for channel, message in messages:
                noise = 0.02 * rng.standard_normal(5)
                message.position[:2] = 20 * math.cos(angle) + noise[0], 20 * math.sin(angle) + noise[1]
                message.orientation[2:] = math.sin(0.5 * angle + noise[2]), math.cos(0.5 * angle + noise[2])
                message.pose_covariance[[0, 7, 35]] = 0.01 + noise[3:] @ noise[3:]
                if message.type == ODOMETRY:
                    message.twist[[0, 5]] = noise[:2]
                writer.write(channel, message.encode(stamp), stamp, stamp)
            command = {"linear": {"x": 1.0 + noise[0]}, "angular": {"z": noise[1]}}
            writer.write(commands, twist.encode("geometry_msgs/msg/Twist", command), stamp, stamp)


def bench_report(name: str, folder: Path, seconds: float, bounds: tuple[float, float, float]) -> None:
    """Write a bag and its report; print time, size, memory and the time to the first view."""
    bag, out = folder / name, folder / f"{name}.html"
    write_noisy_bag(bag, seconds)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begin = time.monotonic()
    subprocess.run([*DIFFBOT, "report", str(bag), "-o", str(out)], check=True, capture_output=True)
    took, after = time.monotonic() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    size = out.stat().st_size / 1e6
    show(f"report of {name}: time", took, "s", bounds[0], f"{used:.1f} s CPU")
    show(f"report of {name}: file", size, "MB", bounds[1])
    show(f"report of {name}: memory", after.ru_maxrss / 1024, "MB", bounds[2])
    with browser.chromium() as new_page:
        page = new_page()
        begin = time.monotonic()
        page.open(out.as_uri())
        show(f"report of {name}: first view", time.monotonic() - begin, "s", 2.0)


def bench_frames() -> None:
    """Ten minutes of trail in a live page that is moved in every frame."""
    state = LiveState(["robot"])
    for step in range(12_000):
        angle = 0.01 * step
        row = (0.05 * step, 5 * math.cos(angle) * math.sin(angle / 9), 5 * math.sin(angle), angle % 6.0 - 3.0)
        state.put_row("robot", "estimate", (*row, 0.01, 0.0, 0.01, 0.01))
        state.put_row("robot", "truth", (*row, 0.5, 0.5))
        state.put_row("robot", "law", (row[0], *[1.0 + math.sin(angle)] * (len(COLUMNS["law"]) - 1)))
    server = PageServer(state, {"xy_tolerance": 0.1, "yaw_tolerance": 0.1, "limits": {}}, lambda *_: None, Address())
    server.start()
    try:
        with browser.chromium() as new_page:
            page = new_page().open(server.url)
            page.wait("diffbotPage.robot.curves.estimate?.rows > 5000", "the trail")
            page.tab.locator("#map").focus()
            frames = page.get(
                """new Promise((done) => {
                    const begin = [performance.now(), diffbotPage.frames];
                    const move = (now) => {
                        const key = new KeyboardEvent("keydown", { key: now % 200 < 100 ? "ArrowLeft" : "ArrowRight" });
                        document.getElementById("map").dispatchEvent(key);
                        if (now - begin[0] < 4000) requestAnimationFrame(move);
                        else done((diffbotPage.frames - begin[1]) / (now - begin[0]) * 1000);
                    };
                    requestAnimationFrame(move);
                })"""
            )
            show("live page with 10 minutes of trail: frames", frames, "/s", 30.0, at_least=True)
    finally:
        server.stop()


@contextlib.contextmanager
def three_pages(url: str) -> Iterator[None]:
    """Have three browsers on this machine, which draw without a graphics card."""
    with browser.chromium() as new_page:
        pages = [new_page().open(url) for _ in range(3)]
        yield
        assert all(page.errors == [] for page in pages)


@contextlib.contextmanager
def three_readers(url: str) -> Iterator[None]:
    """Have three connections like those of browsers on other machines: nothing is drawn here."""
    address = url.split("/")[2]
    with contextlib.ExitStack() as stack:
        for _ in range(3):
            reader = connect(f"ws://{address}/ws?{url.split('?')[1]}", origin=f"http://{address}", compression=None)
            threading.Thread(target=lambda reader=reader: list(reader), daemon=True).start()
            stack.callback(reader.close)
        yield


@contextlib.contextmanager
def watched(chains: Chains, browsers: Any) -> Iterator[subprocess.Popen[str]]:
    """Run ``diffbot watch`` with browsers while the ``with`` block lasts."""
    process = subprocess.Popen(
        [*DIFFBOT, "watch", "--port", "0"],
        env=chains.environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        url = process.stdout.readline().split()[-1]
        with browsers(url):
            yield process
    finally:
        process.terminate()
        process.wait(10.0)


def bench_watch(folder: Path, rounds: int, seconds: float, browsers: Any, what: str) -> None:
    """Period and latency of the commands at 50 Hz with ``diffbot watch``, against the same without it; in pairs."""
    domain = PrivateDomain()
    chains = Chains(domain.id, folder)
    periods, p99s, medians, shares = [], [], [], []
    try:
        for _ in range(rounds):
            try:
                bare = chains.turn(CLOCKED, OURS, THREE, seconds)
                with watched(chains, browsers) as process:
                    used, begin = cpu_seconds([process]), time.monotonic()
                    seen = chains.turn(CLOCKED, OURS, THREE, seconds)
                    share = 100.0 * (cpu_seconds([process]) - used) / (time.monotonic() - begin)
            except BenchError as error:
                print(f"NOT MEASURED: a round of the live page: {error}", file=sys.stderr)
                continue
            shares.append(share)
            periods.append(percentile(seen["periods"], 0.99) / percentile(bare["periods"], 0.99))
            p99s.append(percentile(seen["latencies"], 0.99) / percentile(bare["latencies"], 0.99))
            medians.append(statistics.median(seen["latencies"]) / statistics.median(bare["latencies"]))
    finally:
        domain.release()
    if not shares:
        return
    for name, ratios, bound in (
        (f"control period at 50 Hz with {what}, p99, to that without", periods, 1.1),
        ("latency of the same, p99", p99s, None),
        ("latency of the same, median", medians, None),
    ):
        show(name, statistics.median(ratios), "x", bound, f"{min(ratios):.2f} .. {max(ratios):.2f}")
    show(f"diffbot watch with {what}, CPU of one core", statistics.median(shares), "%", 10.0)


def show(what: str, value: float, unit: str, bound: float | None, note: str = "", at_least: bool = False) -> None:
    """Print a figure, its target and whether it is met."""
    met = "" if bound is None else "yes" if (value >= bound if at_least else value <= bound) else "NO"
    target = "" if bound is None else f"{'>=' if at_least else '<='} {bound:g} {unit}"
    print(f"| {what} | {value:.3g} {unit} | {target} | {met} | {note} |", flush=True)


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one short round, no reports of long bags")
    parser.add_argument("--long", action="store_true", help="also the report of two hours")
    options = parser.parse_args()
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    print("| measure | value | target | met | note |\n| --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory(prefix="diffbot-bench-") as scratch:
        folder = Path(scratch)
        if not options.quick:
            bench_report("10 minutes", folder, 600.0, (10.0, 6.0, 500.0))
        if options.long:
            bench_report("2 hours", folder, 7200.0, (60.0, 15.0, 500.0))
        bench_frames()
        rounds, seconds = (1, 2.0) if options.quick else (5, 6.0)
        bench_watch(folder, rounds, seconds, three_readers, "three browsers elsewhere")
        bench_watch(folder, rounds, seconds, three_pages, "three browsers here")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
