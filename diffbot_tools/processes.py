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
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import yaml

from diffbot_core.errors import DiffbotError
from diffbot_core.files import runtime_folder

DOMAINS = range(1, 102)
"""Domain ids whose ports are below Linux's range of ephemeral ports."""
_BIND = (
    "import ctypes, os, sys; ctypes.CDLL(None).prctl(1, 15); "
    "os.getppid() == int(sys.argv[1]) and os.execv(sys.argv[2], sys.argv[2:])"
)
BOUND = [sys.executable, "-I", "-S", "-c", _BIND]
"""Begins the command ``[*BOUND, parent id, program, ...]``: the program gets SIGTERM when its parent has ended.

The kernel sends the signal (PR_SET_PDEATHSIG is 1, SIGTERM 15) even if the parent was killed, so that a recorder still
closes its bag. A parent that died before the call sends no signal, so the id is checked afterwards. The process becomes
the program. It is a process of its own because code between fork and exec of a process with threads is unsafe. The
options -I and -S make Python start quickly.
"""
_FAST_DDS = ("", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")
"""Values of RMW_IMPLEMENTATION; ROS's default is among them."""
STOP_TIMEOUT = 15.0
"""[s] between SIGINT and SIGKILL."""


class PrivateDomain:
    """A ROS_DOMAIN_ID that no participant on this machine uses, held by a lock file of this user until :meth:`release`.

    Another user's programs are noticed by their ports.
    """

    def __init__(self) -> None:
        """Find a free domain and lock it.

        Raises:
            DiffbotError: if all are taken.
        """
        for domain in random.sample(DOMAINS, len(DOMAINS)):
            lock = self._lock(domain)
            if lock is not None:
                if _is_quiet(domain):
                    self.id, self._held = domain, lock
                    return
                lock.close()
        raise DiffbotError("no free ROS_DOMAIN_ID on this machine")

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

    With Fast DDS this is a profile of UDP alone. LOCALHOST would add shared memory, by which a process that was stopped
    for a second or more may receive nothing afterwards.
    """
    if os.environ.get("RMW_IMPLEMENTATION", "") not in _FAST_DDS:
        return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(Path(__file__).with_name("localhost_udp.xml")),
    }


def graph_environment(domain: int) -> dict[str, str]:
    """Return the environment of a graph that stays on this machine."""
    return {
        **os.environ,
        **localhost_discovery(),
        "ROS_DOMAIN_ID": str(domain),
        "RCUTILS_COLORIZED_OUTPUT": "0",
        "PYTHONUNBUFFERED": "1",
    }


@contextlib.contextmanager
def _signals_ignored() -> Iterator[None]:
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class NodeProcesses:
    """The processes of one graph; leaving the ``with`` block stops them in reverse order of starting.

    If this process is killed, or the thread that started them ends, they get SIGTERM.
    """

    def __init__(self, domain: int, folder: Path, namespace: str = "") -> None:
        """Logs and the parameter file of each node go to ``folder``, which must exist."""
        self._namespace = namespace
        self._environment = graph_environment(domain)
        self._folder = folder
        self._running: dict[str, subprocess.Popen[str]] = {}
        self._logs: list[IO[str]] = []

    def start(self, name: str, module: str, parameters: dict[str, Any], **options: Any) -> subprocess.Popen[str]:
        """Start the node ``name`` of ``module`` with ROS parameters; ``options`` go to Popen."""
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
        """Return one line about a node that ended on its own; empty if all are running."""
        for name, process in self._running.items():
            if process.poll() is not None:
                return f"{name} ended with status {process.returncode}: {self.last_log_line(name)}"
        return ""

    def last_log_line(self, name: str) -> str:
        """Return the last line of a node's log."""
        lines = (self._folder / f"{name}.log").read_text().strip().splitlines()
        return lines[-1] if lines else "its log is empty"

    def stop(self, name: str) -> int:
        """Stop one node with SIGINT, after STOP_TIMEOUT with SIGKILL; return its exit status."""
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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop all nodes that are still running."""
        # A second Ctrl-C must not leave nodes running; a node that ignores SIGINT is killed after STOP_TIMEOUT.
        with _signals_ignored():
            for name in reversed(list(self._running)):
                self.stop(name)
        for log in self._logs:
            log.close()


def wait_until(condition: Any, timeout: float, poll: float = 0.02) -> bool:
    """Wait until ``condition()`` is true, at most ``timeout`` [s]; return whether it became true."""
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(poll)
    return True
