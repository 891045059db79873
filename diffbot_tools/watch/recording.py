"""The record button of the page: starts and stops a recorder process, which ends together with this process."""

from __future__ import annotations

import contextlib
import datetime
import io
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

from diffbot_core.errors import DiffbotError
from diffbot_tools.arguments import ros_parameters
from diffbot_tools.processes import BOUND, STOP_TIMEOUT
from diffbot_tools.view.server import Reply

RECORDER = (sys.executable, "-m", "diffbot_core.launcher", "diffbot_bag.recorder_node")
READY_TIMEOUT = 60.0
"""[s] A recorder that has created no bag after this time has failed; a busy machine starts processes slowly."""
MAX_WAITING = 8
"""Number of requests in the queue. Further requests are refused."""
_CHECK_PERIOD = 0.2
_POLL = 0.02
_LINES, _MAX_LINE = 20, 200
"""Number of log lines that are kept, and largest number of characters of a line that are shown."""


class PageRecording:
    """Records all topics, each time into a new bag.

    A single thread starts and stops all recorders, and lives as long as this object, since the system ends a bound
    process together with the thread that started it.
    """

    def __init__(self, folder: Path, on_change: Callable[[], None], command: Sequence[str] = RECORDER) -> None:
        """Start the thread.

        Args:
            folder: each bag is a new folder in this folder.
            on_change: called in the thread when :attr:`is_on` or :attr:`problem` may have changed.
            command: command of the recorder; ROS arguments are appended.
        """
        self._folder, self._on_change, self._command = folder, on_change, command
        self._requests: queue.Queue[tuple[bool, Reply]] = queue.Queue(MAX_WAITING)
        self._closed = threading.Event()
        self._recorder: _Recorder | None = None
        self._starter: Reply | None = None
        self.problem = ""
        """one line about the last recording if it failed; else empty"""
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    @property
    def is_on(self) -> bool:
        """True while a recorder runs and has created its bag."""
        return self._recorder is not None

    def add(self, is_on: bool, reply: Reply) -> None:
        """Queue a request to start or to stop, and return at once. ``reply`` is called when the request is done."""
        try:
            self._requests.put_nowait((is_on, reply))
        except queue.Full:
            reply("busy: the recorder is still starting or stopping, try again", 1)

    def close(self) -> None:
        """Stop the recorder if it runs, and end the thread."""
        self._closed.set()
        self._thread.join(timeout=STOP_TIMEOUT + 5.0)

    def _run(self) -> None:
        while not self._closed.is_set():
            try:
                is_on, reply = self._requests.get(timeout=_CHECK_PERIOD)
            except queue.Empty:
                self._check()
                continue
            try:
                text = self._start() if is_on else self._stop()
                self._starter = reply
                reply(text, 0)
            except DiffbotError as error:
                reply(str(error), 2)
            self._on_change()
        if self._recorder is not None:
            with contextlib.suppress(DiffbotError):
                self._stop()

    def _check(self) -> None:
        """If the recorder has ended by itself, report it to the browser that started it."""
        if self._recorder is None or self._recorder.is_running:
            return
        recorder, self._recorder = self._recorder, None
        error = self._failure(f"recording to {recorder.bag} ended: {recorder.stop()}")
        if self._starter is not None:
            self._starter(str(error), 2)
        self._on_change()

    def _failure(self, text: str) -> DiffbotError:
        self.problem = text
        return DiffbotError(text)

    def _start(self) -> str:
        self._check()
        if self._recorder is not None:
            raise DiffbotError(f"already recording to {self._recorder.bag}")
        bag = self._folder / datetime.datetime.now().astimezone().strftime("bag_%Y-%m-%d_%H-%M-%S")
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            recorder = _Recorder(bag, self._command)
        except OSError as error:
            raise self._failure(f"cannot record to {bag}: {error.strerror}") from error
        deadline = time.monotonic() + READY_TIMEOUT
        while not recorder.is_ready:
            is_late = time.monotonic() > deadline
            if is_late or not recorder.is_running or self._closed.wait(_POLL):
                late = f" after {READY_TIMEOUT:g} s" if is_late else ""
                raise self._failure(f"cannot record to {bag}: no bag{late}, {recorder.stop()}")
        self._recorder, self.problem = recorder, ""
        return f"recording to {bag}"

    def _stop(self) -> str:
        self._check()
        if self._recorder is None:
            raise DiffbotError(self.problem or "not recording")
        recorder, self._recorder = self._recorder, None
        end = recorder.stop()
        if not recorder.is_complete:
            raise self._failure(f"the bag {recorder.bag} is not complete: {end}")
        return f"recorded {recorder.bag}"


class _Recorder:
    """A recorder process. Its output is passed to the log of this process."""

    def __init__(self, bag: Path, command: Sequence[str]) -> None:
        """Start the process.

        Raises:
            OSError: if the process cannot be started.
        """
        self.bag = bag
        self._process = subprocess.Popen(
            [*BOUND, str(os.getpid()), *command, "--ros-args", *ros_parameters({"uri": str(bag)})],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        self._lines: deque[str] = deque(maxlen=_LINES)
        self._reader = threading.Thread(target=self._read, name="recorder's log", daemon=True)
        self._reader.start()

    @property
    def is_ready(self) -> bool:
        """True if the bag exists. From this time on, the recorder closes its bag after a signal."""
        return any(self.bag.glob("*.mcap"))

    @property
    def is_running(self) -> bool:
        """True until the process has ended."""
        return self._process.poll() is None

    @property
    def is_complete(self) -> bool:
        """True if the process has ended without an error and has closed its bag."""
        return self._process.returncode == 0 and (self.bag / "metadata.yaml").is_file()

    def stop(self) -> str:
        """Stop the process, and kill it after STOP_TIMEOUT; return a text about its end."""
        if self.is_running:
            self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(timeout=STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(timeout=1.0)
        errors = [line for line in self._lines if "[ERROR]" in line or "[FATAL]" in line or line.startswith("error:")]
        words = (errors or list(self._lines) or ["it logged nothing"])[-1]
        shown = words if len(words) <= _MAX_LINE else words[:_MAX_LINE] + "..."
        return f"the recorder ended with status {self._process.returncode}: {shown}"

    def _read(self) -> None:
        with self._process.stdout or io.StringIO() as output:
            for line in output:
                if line.strip():
                    self._lines.append(line.strip())
                # The recorder has to continue even if this process cannot write its own log.
                with contextlib.suppress(OSError, ValueError):
                    print(line, end="", file=sys.stderr, flush=True)
