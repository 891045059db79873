"""The page: time, size and memory of reports, frames a second, and what ``diffbot watch`` costs the robot."""

from __future__ import annotations

import contextlib
import math
import statistics
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import browser
import graph
import numpy as np
from chains import CLOCKED, OURS, THREE, Chains, cpu_seconds, percentile
from costs import DIFFBOT, cost_of
from measures import OURS as ABSOLUTE
from measures import Measure, Pair
from websockets.sync.client import connect

from diffbot_bag.bag.encoding import ODOMETRY, POSE, Encoder, NumbersMessage
from diffbot_bag.bag.new_bag import new_bag
from diffbot_bag.bag.qos import Qos
from diffbot_tools.view.live_state import COLUMNS, LiveState
from diffbot_tools.view.server import Address, PageServer

RATE = 50
BEGIN = 1_700_000_000_000_000_000
REPORT, QUICK_REPORT = 7200.0, 5.0
"""[s] of the bag"""
ROUNDS, SECONDS, MOVING = 5, 6.0, 4.0
QUICK_SECONDS, QUICK_MOVING = 0.6, 0.5
MEASURES = (
    Measure("time", "report of 2 hours: time", "s", ABSOLUTE, at_most=60.0),
    Measure("size", "its file", "MB", ABSOLUTE, at_most=15.0),
    Measure("memory", "its memory", "MB", ABSOLUTE, at_most=500.0),
    Measure("view", "its first view in the browser", "s", ABSOLUTE, at_most=2.0),
    Measure("frames", "live page with 10 minutes of trail, moved in every frame", "frames/s", ABSOLUTE, at_least=30.0),
    Measure("elsewhere_period", "control period with three browsers elsewhere, p99, beside none", "ms", at_most=1.1),
    Measure("elsewhere_latency", "latency of the same, median", "ms"),
    Measure("elsewhere_cpu", "`diffbot watch` with them: CPU of one core", "%", ABSOLUTE, at_most=10.0),
    Measure("here_period", "control period with three browsers on this machine, p99, beside none", "ms", at_most=1.1),
    Measure("here_latency", "latency of the same, median", "ms"),
    Measure("here_cpu", "`diffbot watch` with them: CPU of one core", "%", ABSOLUTE, at_most=10.0),
)
MOVE = """new Promise((done) => {{
    const begin = [performance.now(), diffbotPage.frames];
    const move = (now) => {{
        const key = new KeyboardEvent("keydown", {{ key: now % 200 < 100 ? "ArrowLeft" : "ArrowRight" }});
        document.getElementById("map").dispatchEvent(key);
        if (now - begin[0] < {milliseconds}) requestAnimationFrame(move);
        else done((diffbotPage.frames - begin[1]) / (now - begin[0]) * 1000);
    }};
    requestAnimationFrame(move);
}})"""


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


def report(folder: Path, seconds: float, page: browser.Page) -> dict[str, Pair]:
    """Write a bag and its report, and open it."""
    bag, out = folder / "bag", folder / "report.html"
    write_noisy_bag(bag, seconds)
    cost = cost_of(*DIFFBOT, "report", bag, "-o", out)
    begin = time.monotonic()
    page.open(out.as_uri())
    view = time.monotonic() - begin
    size = out.stat().st_size / 1e6
    return {"time": Pair(cost.wall), "size": Pair(size), "memory": Pair(cost.memory), "view": Pair(view)}


def frames(seconds: float, page: browser.Page) -> float:
    """Return the frames a second of a live page with ten minutes of trail that is moved in every frame."""
    state = LiveState(["robot"])
    for step in range(12_000):
        angle = 0.01 * step
        row = (0.05 * step, 5 * math.cos(angle) * math.sin(angle / 9), 5 * math.sin(angle), angle % 6.0 - 3.0)
        state.put_row("robot", "estimate", (*row, 0.01, 0.0, 0.01, 0.01))
        state.put_row("robot", "truth", (*row, 0.5, 0.5))
        state.put_row("robot", "law", (row[0], *[1.0 + math.sin(angle)] * (len(COLUMNS["law"]) - 1)))
    constants = {"xy_tolerance": 0.1, "yaw_tolerance": 0.1, "limits": {}}
    server = PageServer(state, constants, lambda *_: None, print, Address())
    server.start()
    try:
        page.open(server.url)
        page.wait("diffbotPage.robot.curves.estimate?.rows > 5000", "the trail")
        page.tab.locator("#map").focus()
        return float(page.get(MOVE.format(milliseconds=1000 * seconds)))
    finally:
        server.stop()


@contextlib.contextmanager
def browsers_here(url: str) -> Iterator[None]:
    """Have three browsers on this machine, which draw without a graphics card."""
    with browser.chromium() as new_page:
        pages = [new_page().open(url) for _ in range(3)]
        yield
        assert all(page.errors == [] for page in pages)


@contextlib.contextmanager
def browsers_elsewhere(url: str) -> Iterator[None]:
    """Have three connections like those of browsers on other machines: nothing is drawn here."""
    address = url.split("/")[2]
    with contextlib.ExitStack() as stack:
        for _ in range(3):
            reader = connect(f"ws://{address}/ws?{url.split('?')[1]}", origin=f"http://{address}", compression=None)
            threading.Thread(target=lambda reader=reader: list(reader), daemon=True).start()
            stack.callback(reader.close)
        yield


@contextlib.contextmanager
def watched(browsers: Any) -> Iterator[subprocess.Popen[str]]:
    """Run ``diffbot watch`` with browsers while the ``with`` block lasts."""
    command = [*DIFFBOT, "watch", "--port", "0"]
    process = subprocess.Popen(
        command, env=graph.environment(), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    try:
        url = process.stdout.readline().split()[-1]
        with browsers(url):
            yield process
    finally:
        process.terminate()
        process.wait(10.0)
        process.stdout.close()


def watch(number: int, chains: Chains, seconds: float) -> dict[str, Pair]:
    """Compare the chain at 50 Hz with ``diffbot watch`` and browsers to that without."""
    bare, found = chains.turn(CLOCKED, OURS, THREE, seconds), {}
    kinds = [("elsewhere", browsers_elsewhere), ("here", browsers_here)]
    for name, browsers in kinds if number % 2 == 0 else kinds[::-1]:
        with watched(browsers) as process:
            used, begin = cpu_seconds([process]), time.monotonic()
            seen = chains.turn(CLOCKED, OURS, THREE, seconds)
            share = 100.0 * (cpu_seconds([process]) - used) / (time.monotonic() - begin)
        found |= {
            f"{name}_period": Pair(*(percentile(one["periods"], 0.99) for one in (seen, bare))),
            f"{name}_latency": Pair(*(statistics.median(one["latencies"]) for one in (seen, bare))),
            f"{name}_cpu": Pair(share),
        }
    return found


def measure(quick: bool, folder: Path) -> Iterator[dict[str, Pair]]:
    """Yield the report, the frames, and the rounds with browsers."""
    with browser.chromium() as new_page:
        yield report(folder, QUICK_REPORT if quick else REPORT, new_page())
        yield {"frames": Pair(frames(QUICK_MOVING if quick else MOVING, new_page()))}
    chains = Chains(folder)
    for number in range(1 if quick else ROUNDS):
        yield watch(number, chains, QUICK_SECONDS if quick else SECONDS)
