"""Start and memory of a node beside a bare rclpy node: seconds from exec to its line ``ready``, resident set then.

Both processes of a round are started right after each other, the bare one first in every second round. The bare node
(:data:`BARE`) is what rclpy alone needs: interpreter, import, context, a node with its parameter services, one line
of log.
"""

from __future__ import annotations

import os
import re
import selectors
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

from bench_table import BenchError, Pair

NODES = ("controller", "plant", "recorder", "ekf", "robot")
"""``robot``: robot_node with plant and recorder in its process."""
BARE = """
import rclpy
from rclpy.node import Node
rclpy.init()
node = Node("bare")
node.get_logger().info("ready")
try:
    rclpy.spin(node)
except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
    pass
"""
_READY = re.compile(rb"\bready\b")
_TIMEOUT = 30.0
"""[s] within which a node must be up, and within which it must have ended."""


class Start(NamedTuple):
    """One process that came up."""

    seconds: float
    """from its start to the line ``ready``"""
    resident: float
    """resident set at that moment [MB]"""


def executable(name: str) -> list[str]:
    """Return the command of a node as its users start it."""
    if name == "robot":
        return [str(Path(sys.executable).with_name("diffbot")), "run", "robot", "--with", "plant", "recorder"]
    return [str(Path(sys.executable).with_name(f"{name}_node"))]


def measure_start(command: list[str], environment: dict[str, str], folder: Path) -> Start:
    """Start a node, wait for ``ready``, end it.

    Raises:
        BenchError: if the node ends or is not ready within the time limit.
    """
    began = time.perf_counter()
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment, cwd=folder
    ) as process:
        try:
            output = _read_until_ready(process, began + _TIMEOUT)
            seconds = time.perf_counter() - began
            if not _READY.search(output):
                raise BenchError(f"{command[0]} did not get ready: {output.decode(errors='replace').strip()}")
            resident = _resident(process.pid)
            process.send_signal(signal.SIGINT)
            process.wait(_TIMEOUT)
        except subprocess.TimeoutExpired:
            raise BenchError(f"{command[0]} did not end within {_TIMEOUT:g} s") from None
        finally:
            if process.poll() is None:
                process.kill()
    return Start(seconds, resident)


def first_pose_round(environment: dict[str, str], folder: Path) -> dict[str, Pair]:
    """Measure from the start of the filter, with a state file, to its first pose at a subscriber; return the row.

    Raises:
        BenchError: if it does not come.
    """
    program = Path(__file__).with_name("bench_first_pose.py")
    ours = subprocess.run(
        [sys.executable, str(program), "--starts", "1"], env=environment, cwd=folder, capture_output=True, check=False
    )
    if ours.returncode:
        raise BenchError(" ".join(ours.stderr.decode(errors="replace").split()))
    bare = measure_start([sys.executable, "-c", BARE], environment, folder)
    return {"first_pose_ekf": Pair(float(ours.stdout), bare.seconds)}


def _read_until_ready(process: subprocess.Popen[bytes], deadline: float) -> bytes:
    """Return what the process wrote up to ``ready``, its end or the deadline (of ``time.perf_counter``)."""
    assert process.stdout is not None
    descriptor, output = process.stdout.fileno(), b""
    with selectors.DefaultSelector() as selector:
        selector.register(descriptor, selectors.EVENT_READ)
        while not _READY.search(output) and selector.select(max(deadline - time.perf_counter(), 0.0)):
            part = os.read(descriptor, 65536)
            if not part:
                break
            output += part
    return output


def _resident(pid: int) -> float:
    """Return the resident set of a process [MB]."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    (kilobytes,) = (line.split()[1] for line in lines if line.startswith("VmRSS:"))
    return int(kilobytes) / 1024.0


def start_round(name: str, environment: dict[str, str], folder: Path, number: int) -> dict[str, Pair]:
    """Measure one node and the bare one; return the rows of start and memory.

    Raises:
        BenchError: if one of them does not come up.
    """
    commands = {"ours": executable(name), "bare": [sys.executable, "-c", BARE]}
    if name in ("recorder", "robot"):
        commands["ours"] += ["--ros-args", "-p", f"recorder:uri:={folder / f'bag_{name}_{number}'}"]
    order = ("ours", "bare") if number % 2 else ("bare", "ours")
    starts = {side: measure_start(commands[side], environment, folder) for side in order}
    ours, bare = starts["ours"], starts["bare"]
    return {
        f"start_{name}": Pair(ours.seconds, bare.seconds),
        f"memory_{name}": Pair(ours.resident, bare.resident),
    }
