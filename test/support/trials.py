"""Trials of one promise: values, the scheduler's share in them, and the results of several processes as JSON."""

import json
import math
import os
import platform
import statistics
import time
from contextlib import contextmanager

from promises import PROMISES

from diffbot_core.files import write_json

COUNTS = ("processes", "deaths", "tracebacks", "messages", "non_finite")
SLACK = 10.0
"""times its bound for a value of the short suite, which runs beside other tests: it finds what is broken, and the full
suite measures"""


class Trials:
    """The trials of one promise, or a share of them; iterating gives their numbers."""

    def __init__(self, key, full, share, note):
        """Start without a result.

        Args:
            key: of PROMISES.
            full: all trials, not the short form.
            share: (k, n) for every n-th trial from number k on.
            note: called with the key, each result, and how often there is one.
        """
        self.key, self.promise = key, PROMISES[key]
        self._full, self._note = full, note
        first, step = share
        self._numbers = range(first, self.promise.full if full else self.promise.short, step)
        self.results = []
        """of each trial: value or None, allowance for the scheduler, whether it is kept with it, and without"""

    @property
    def count(self):
        """How many trials there are."""
        return len(self._numbers)

    def __iter__(self):
        """Return the numbers of the trials."""
        return iter(self._numbers)

    def batches(self, size=500):
        """Yield the numbers of trials, ``size`` or less, that are made together."""
        for begin in range(0, self.count, size):
            yield min(size, self.count - begin)

    def measure(self, value, kept=True, delay=0.0):
        """Add a value; ``delay`` [s], what the scheduler may have added, is allowed on top of the bound."""
        self.add(value, delay, kept)

    def add(self, value=None, allowance=0.0, kept=True, count=1):
        """Add a result, or the same one ``count`` times."""
        bound = self.promise.bound
        slack = 1.0 if self._full else SLACK
        bounds = [math.inf, math.inf] if bound is None else [slack * bound + allowance, bound]
        within, strictly = (value is None or value <= most for most in bounds)
        result = value, allowance, bool(kept and within), bool(kept and strictly)
        self.results += [result] * count
        self._note({"fault": self.key, "result": result, "count": count})

    def check(self):
        """Fail if the promise was broken once."""
        broken = [result for result in self.results if not result[2]]
        assert self.results or not self.count, f"{self.key}: not tried"
        assert not broken, f"{self.key}: bound {self.promise.bound}, (value, allowance, ...): {broken[:10]}"


def summary(key, results, seconds):
    """Return the row of the JSON file; ``seconds`` are those that the trials took, whatever ran beside them."""
    promise = PROMISES[key]
    values = [value for value, *_ in results if value is not None]
    worst = max(results, key=lambda result: result[0]) if values else (None, 0.0)
    return {
        "fault": promise.fault,
        "promise": promise.text,
        "unit": promise.unit,
        "bound": promise.bound,
        "trials": len(results),
        "kept": sum(strictly for *_, strictly in results),
        "kept_with_allowance": sum(kept for _, _, kept, _ in results),
        "median": statistics.median(values) if values else None,
        "worst": worst[0],
        "allowance_of_worst": worst[1],
        "seconds": round(seconds, 1),
    }


class Record:
    """What a process of tests has found; with a file, each result is a line there at once."""

    def __init__(self, full, share, path):
        """Start empty, see :class:`Trials`; ``path`` is a file that other processes may write to as well, or None."""
        self._full, self._share, self._path = full, share, path
        self.suite = {}
        """counts of the processes and messages of each file of tests"""

    def counts(self, name):
        """Return the counts of one file of tests, to be added to."""
        return self.suite.setdefault(name, dict.fromkeys(COUNTS, 0))

    @contextmanager
    def trials(self, key):
        """Give the trials of one promise; at the end they are checked."""
        running, begin = Trials(key, self._full, self._share, self._note), time.monotonic()
        try:
            yield running
        finally:
            self._note({"fault": key, "seconds": time.monotonic() - begin})
        running.check()

    def finish(self):
        """Note the counts."""
        for name, counts in self.suite.items():
            self._note({"suite": name, "counts": counts})

    def _note(self, entry):
        if self._path is None:
            return
        # A line goes into the file as a whole, whoever else writes to it.
        file = os.open(self._path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        try:
            os.write(file, json.dumps(entry).encode() + b"\n")
        finally:
            os.close(file)


def merge(lines, path):
    """Write the JSON file from the lines of all processes; rows of faults that were not tried stay."""
    results, seconds, suite = {}, {}, {}
    for entry in map(json.loads, lines):
        if "result" in entry:
            results.setdefault(entry["fault"], []).extend([entry["result"]] * entry["count"])
        elif "seconds" in entry:
            seconds[entry["fault"]] = seconds.get(entry["fault"], 0.0) + entry["seconds"]
        else:
            counts = suite.setdefault(entry["suite"], dict.fromkeys(COUNTS, 0))
            for name, count in entry["counts"].items():
                counts[name] += count
    content = json.loads(path.read_text()) if path.is_file() else {}
    rows = content.get("faults", {})
    rows |= {key: summary(key, found, seconds.get(key, 0.0)) for key, found in results.items()}
    content["faults"] = {key: rows[key] for key in PROMISES if key in rows}
    content["suite"] = content.get("suite", {}) | suite
    content["machine"] = {
        "processors": os.cpu_count(),
        "python": platform.python_version(),
        "load": round(os.getloadavg()[2], 1),
    }
    write_json(path, content)
