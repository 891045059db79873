"""The record button: a recorder process, which ends with this one."""

from __future__ import annotations

import datetime
import os
import signal
import subprocess
import sys
from pathlib import Path

from diffbot_core.errors import DiffbotError
from diffbot_tools.demo.processes import BOUND, STOP_TIMEOUT


class Recording:
    """Records all topics into a new bag at a time."""

    def __init__(self, folder: Path) -> None:
        """Bags become folders in ``folder``."""
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None
        self._bag = folder

    @property
    def is_on(self) -> bool:
        """True while a recorder runs."""
        return self._process is not None and self._process.poll() is None

    def start(self) -> str:
        """Start a recorder; return a line about it.

        Raises:
            DiffbotError: if one runs already, or it cannot be started.
        """
        if self.is_on:
            raise DiffbotError(f"already recording to {self._bag}")
        name = datetime.datetime.now().astimezone().strftime("bag_%Y-%m-%d_%H-%M-%S")
        self._bag = self._folder / name
        uri = f"uri:='{self._bag}'"
        command = [*BOUND, str(os.getpid()), sys.executable, "-m", "diffbot_bag.recorder_node", "--ros-args", "-p", uri]
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True)
        except OSError as error:
            raise DiffbotError(f"cannot record to {self._bag}: {error.strerror}") from error
        return f"recording to {self._bag}"

    def stop(self) -> str:
        """Stop the recorder, which closes its bag; return a line about it.

        Raises:
            DiffbotError: if none runs, or it failed.
        """
        if self._process is None:
            raise DiffbotError("not recording")
        process, self._process = self._process, None
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            status = process.wait(timeout=STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            status = process.wait()
        if status != 0:
            raise DiffbotError(f"the recorder ended with status {status}")
        return f"recorded {self._bag}"
