"""Trials of one promise: values, the scheduler's share in them, and the results of several processes as JSON."""

import json
import math
import os
import time
from contextlib import contextmanager

from promises import PROMISES

COUNTS = ("processes", "deaths", "tracebacks", "messages", "non_finite")
SLACK = 10.0
"""times its bound for a value of the short suite, which runs beside other tests: it finds what is broken, and the full
suite measures"""


class Trials:
    """The trials of one promise, or a share of them; iterating gives their numbers."""

    def __init__(self, key, full, share, note):
        """Start with no result; ``share``: (k, n) for every n-th trial from number k on; ``note`` gets the results."""
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
