"""Start nodes as processes on a private DDS domain, and stop them cleanly."""

from __future__ import annotations

import contextlib
import fcntl
import os
import random
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import yaml

from diffbot_core.errors import DiffbotError
from diffbot_core.files import runtime_folder

DOMAINS = range(1, 102)
"""Domain ids whose ports are below the ephemeral ports of Linux."""
_BIND = (
    "import ctypes, os, sys; ctypes.CDLL(None).prctl(1, 15); "
    "os.getppid() == int(sys.argv[1]) and os.execv(sys.argv[2], sys.argv[2:])"
)
BOUND = [sys.executable, "-I", "-S", "-c", _BIND]
"""Beginning of a command ``[*BOUND, parent id, program, ...]`` whose program gets SIGTERM when its parent ends.

The kernel sends the signal (PR_SET_PDEATHSIG is 1, SIGTERM is 15) even if the parent is killed, so that a recorder can
still close its bag. If the parent died before the call, the kernel sends nothing; therefore the parent id is compared
after the call. This small Python program replaces itself with the actual program. Popen's preexec_fn could do the same
but is unsafe in a process with threads. The options -I and -S make Python start quickly.
"""
_FAST_DDS = ("", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")
"""Values of RMW_IMPLEMENTATION that select Fast DDS; the empty default does, too."""
STOP_TIMEOUT = 15.0
"""[s] time from SIGINT to SIGKILL"""


class PrivateDomain:
    """A ROS_DOMAIN_ID that no other participant on this machine uses.

    A lock file reserves the domain among the programs of this user until :meth:`release`. Programs of other users are
    detected by their ports.
    """

    def __init__(self) -> None:
        """Find a free domain and lock it.

        Raises:
            DiffbotError: if all domains are in use.
        """
        for domain in random.sample(DOMAINS, len(DOMAINS)):
            lock = self._lock(domain)
            if lock is not None:
                if _is_quiet(domain):
                    self.id, self._held = domain, lock
                    return
                lock.close()
        raise DiffbotError(f"all values of ROS_DOMAIN_ID from {DOMAINS[0]} to {DOMAINS[-1]} are in use on this machine")

    @staticmethod
    def _lock(domain: int) -> IO[str] | None:
        path = runtime_folder() / f"domain-{domain}.lock"
        try:
            lock = path.open("a")
        except OSError:
            return None
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            lock.close()
            return None
        return lock

    def release(self) -> None:
        """Release the lock."""
        self._held.close()


def _is_quiet(domain: int) -> bool:
    """True if the unicast discovery port of the first participant is free (DDSI-RTPS 9.6.1: 7400 + 250 d + 10)."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", 7400 + 250 * domain + 10))
        except OSError:
            return False
    return True


def localhost_discovery() -> dict[str, str]:
    """Return the environment variables that keep a graph on this machine.

    For Fast DDS they select a profile that uses only UDP. LOCALHOST would add shared memory, and a process that was
    stopped for a second or more may receive nothing through it afterwards.
    """
    if os.environ.get("RMW_IMPLEMENTATION", "") not in _FAST_DDS:
        return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(Path(__file__).with_name("localhost_udp.xml")),
    }


def graph_environment(domain: int) -> dict[str, str]:
    """Return the environment variables of a process whose graph stays on this machine."""
    return {
        **os.environ,
        **localhost_discovery(),
        "ROS_DOMAIN_ID": str(domain),
        "RCUTILS_COLORIZED_OUTPUT": "0",
        "PYTHONUNBUFFERED": "1",
    }


@contextlib.contextmanager
def _ignored_signals() -> Iterator[None]:
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class NodeProcesses:
    """The processes of one graph; leaving the ``with`` block stops them, the newest first.

    If this process is killed, or the thread that started the nodes ends, the nodes get SIGTERM.
    """

    def __init__(self, domain: int, folder: Path, namespace: str = "") -> None:
        """Store the settings.

        Args:
            domain: ROS_DOMAIN_ID.
            folder: existing folder for the log and the parameter file of each node.
            namespace: namespace of the nodes.
        """
        self._namespace = namespace
        self._environment = graph_environment(domain)
        self._folder = folder
        self._running: dict[str, subprocess.Popen[str]] = {}
        self._logs: list[IO[str]] = []

    def start(self, name: str, module: str, parameters: dict[str, Any], **options: Any) -> subprocess.Popen[str]:
        """Start the node ``name`` of ``module`` with ROS parameters; pass ``options`` to Popen."""
        file = self._folder / f"{name}.yaml"
        file.write_text(yaml.safe_dump({f"{self._namespace}/{name}": {"ros__parameters": parameters}}))
        log = (self._folder / f"{name}.log").open("w")
        self._logs.append(log)
        launcher = sys.executable, "-m", "diffbot_core.launcher", module
        command = [*BOUND, str(os.getpid()), *launcher, "--ros-args", "--params-file", str(file)]
        if self._namespace:
            command += ["-r", f"__ns:={self._namespace}"]
        options = {"stdout": log, "stderr": log, "text": True, "stdin": subprocess.DEVNULL, **options}
        process = subprocess.Popen(command, env=self._environment, **options)
        self._running[name] = process
        return process

    def failed(self) -> str:
        """Return one line about a node that has ended by itself; empty if all nodes are running."""
        for name, process in self._running.items():
            if process.poll() is not None:
                return f"{name} ended with status {process.returncode}: {self.last_log_line(name)}"
        return ""

    def last_log_line(self, name: str) -> str:
        """Return the last line of a node's log."""
        lines = (self._folder / f"{name}.log").read_text().strip().splitlines()
        return lines[-1] if lines else "its log is empty"

    def stop(self, name: str) -> int:
        """Stop a node with SIGINT, or with SIGKILL after STOP_TIMEOUT; return its exit status."""
        process = self._running.pop(name)
        if process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                process.send_signal(signal.SIGINT)
        try:
            return process.wait(timeout=STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            return process.wait()

    def __enter__(self) -> NodeProcesses:
        """Return self."""
        return self

    def __exit__(self, *error: object) -> None:
        """Stop all nodes that are still running."""
        # A second Ctrl-C must not leave nodes running.
        with _ignored_signals():
            for name in reversed(list(self._running)):
                self.stop(name)
        for log in self._logs:
            log.close()
