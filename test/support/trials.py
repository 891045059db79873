"""Trials of one promise: values, the scheduler's share in them, and the results of a whole run as JSON."""

import fcntl
import json
import math
import os
import platform
import statistics
from contextlib import contextmanager

from promises import PROMISES
from tqdm import tqdm

from diffbot_core.files import write_json

COUNTS = ("processes", "deaths", "tracebacks", "messages", "non_finite")
SLACK = 10.0
"""times its bound for a value of the short suite, which runs beside other tests: it finds what is broken, and the full
suite measures"""


class Trials:
    """The trials of one promise; iterating gives their numbers and shows a progress bar."""

    def __init__(self, key, full, shown):
        """Start without a result.

        Args:
            key: of PROMISES.
            full: all trials, not the short form.
            shown: context in which output reaches the terminal.
        """
        self.key, self.promise = key, PROMISES[key]
        self._full = full
        self.count = self.promise.full if full else self.promise.short
        self._shown = shown
        self.results = []
        """of each trial: value or None, allowance for the scheduler, whether it is kept with it, and without"""

    def __iter__(self):
        """Return the numbers of the trials."""
        return iter(self._shown_progress([1] * self.count))

    def shares(self, size=500):
        """Return the numbers of trials, ``size`` or less, that are made together."""
        return self._shown_progress([min(size, self.count - begin) for begin in range(0, self.count, size)])

    def _shown_progress(self, sizes):
        with self._shown():
            bar = tqdm(total=self.count, desc=self.key, unit="trial", leave=False, disable=not self._full)
        for number, size in enumerate(sizes):
            yield number if size == 1 else size
            with self._shown():
                bar.update(size)
        with self._shown():
            bar.close()

    def measure(self, value, kept=True, delay=0.0):
        """Add a value; ``delay`` [s], what the scheduler may have added, is allowed on top of the bound."""
        self.add(value, delay, kept)

    def add(self, value=None, allowance=0.0, kept=True):
        """Add a result."""
        bound = self.promise.bound
        slack = 1.0 if self._full else SLACK
        bounds = [math.inf, math.inf] if bound is None else [slack * bound + allowance, bound]
        within, strictly = (value is None or value <= most for most in bounds)
        self.results.append((value, allowance, bool(kept and within), bool(kept and strictly)))

    def add_many(self, count, kept):
        """Add the same result ``count`` times."""
        self.results += [(None, 0.0, bool(kept), bool(kept))] * count

    def check(self):
        """Fail if the promise was broken once."""
        broken = [result for result in self.results if not result[2]]
        assert self.results, f"{self.key}: not tried"
        assert not broken, f"{self.key}: bound {self.promise.bound}, (value, allowance, ...): {broken[:10]}"

    def summary(self):
        """Return the row of the JSON file."""
        values = [value for value, *_ in self.results if value is not None]
        worst = max(self.results, key=lambda result: result[0]) if values else (None, 0.0)
        return {
            "fault": self.promise.fault,
            "promise": self.promise.text,
            "unit": self.promise.unit,
            "bound": self.promise.bound,
            "trials": len(self.results),
            "kept": sum(strictly for *_, strictly in self.results),
            "kept_with_allowance": sum(kept for _, _, kept, _ in self.results),
            "median": statistics.median(values) if values else None,
            "worst": worst[0],
            "allowance_of_worst": worst[1],
        }


class Record:
    """The results of a run, and what holds for the suite as a whole."""

    def __init__(self):
        """Start empty."""
        self.rows = {}
        self.suite = {}
        """counts of the processes and messages of each file of tests"""

    def counts(self, name):
        """Return the counts of one file of tests, to be added to."""
        return self.suite.setdefault(name, dict.fromkeys(COUNTS, 0))

    @contextmanager
    def trials(self, key, *options):
        """Give the trials of one promise; at the end they are recorded, then checked."""
        running = Trials(key, *options)
        try:
            yield running
        finally:
            if running.results:
                self.rows[key] = running.summary()
        running.check()

    def write(self, path):
        """Write the JSON file; rows of faults that were not tried stay."""
        # Several workers write their rows, each at its end.
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            fcntl.flock(folder, fcntl.LOCK_EX)
            self._write(path)
        finally:
            os.close(folder)

    def _write(self, path):
        content = json.loads(path.read_text()) if path.is_file() else {}
        rows = content.get("faults", {}) | self.rows
        content["faults"] = {key: rows[key] for key in PROMISES if key in rows}
        content["suite"] = content.get("suite", {}) | self.suite
        content["machine"] = {
            "processors": os.cpu_count(),
            "python": platform.python_version(),
            "load": round(os.getloadavg()[2], 1),
        }
        write_json(path, content)
