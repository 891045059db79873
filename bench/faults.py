"""Does each fault end as promised? ``python bench/faults.py [--json FILE] [--fraction N] [NAME ...]``.

Runs test/faults in its full form, in several processes: first what waits most of the time, several robots at once, each
in a domain of its own; then what keeps the processors busy; then what is measured alone. With ``--fraction`` only every
N-th trial, with names only the parts of that name. The output of each process is in out/faults. Ctrl-C keeps what is
done; exit status 1 if a promise was broken, 130 after Ctrl-C.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm
from trust import busy_loops

from diffbot_core.files import write_json

ROOT = Path(__file__).resolve().parents[1]
LOGS = ROOT / "out" / "faults"
sys.path.insert(0, str(ROOT / "test" / "support"))

from promises import PROMISES  # noqa: E402
from trials import COUNTS  # noqa: E402

LOWEST_PRIORITY = 19
MEMORY = Path("/dev/shm")
UNKNOWN = 30.0
"""[s] of a promise of which no earlier run says how long its trials take"""


class Part(NamedTuple):
    """Tests, and the number of processes that share their trials."""

    name: str
    processes: int
    tests: tuple[str, ...]


class Stage(NamedTuple):
    """Parts that may run side by side."""

    at_once: int
    """processes"""
    parts: tuple[Part, ...]
    beside: tuple[Part, ...] = ()
    """at the lowest priority, all processes at once: what the others leave of the processors; their files in memory"""
    loops: int = 0
    """busy loops beside it"""


def _selected(file: str, *tests: str) -> tuple[str, ...]:
    return tuple(f"test/faults/{file}.py::{one}" for one in tests)


_LAST = "test_last_command_is_zero_whichever_node_ends"
_FLOOD = "test_flood_of_goals_leaves_the_control_period"
_LONG = "test_others_are_answered_beside_calls_of_any_length"
_SIGNAL = "test_a_signal_ends_a_start_with_the_largest_of_files"
STAGES = (
    # A robot that drives takes up to half a processor.
    Stage(
        4,
        (
            Part("killed", 4, ("test/faults/test_killed.py",)),
            Part("deceived", 4, ("test/faults/test_deceived.py",)),
            Part("ended", 3, ("test/faults/test_ended.py", f"--deselect=test/faults/test_ended.py::{_LAST}")),
            Part("clock", 2, ("test/faults/test_clock.py",)),
            Part("network", 2, _selected("test_traffic", "test_goals_are_reached_over_a_bad_network")),
        ),
        beside=(Part("mutated bags", 2, _selected("test_bags", "test_mutated_bags")),),
    ),
    # Measured by processor time, or not at all.
    Stage(
        4,
        (
            # The longest of them.
            Part("page", 2, ("test/faults/test_page.py",)),
            Part("bags", 1, _selected("test_bags", "test_crafted_bags", "test_a_bag_that_is_being_recorded")),
            Part("replayed bags", 1, _selected("test_bags", "test_replayed_bags")),
            Part("messages", 2, ("test/faults/test_hostile.py",)),
            Part(
                "files",
                2,
                (
                    "test/faults/test_files.py",
                    *(f"--deselect=test/faults/test_files.py::{one}" for one in (_LONG, _SIGNAL)),
                ),
            ),
        ),
    ),
    Stage(4, (Part("last command", 4, _selected("test_ended", _LAST)),), loops=4),
    Stage(2, (Part("files, timed", 2, _selected("test_files", _LONG, _SIGNAL)),)),
    Stage(1, (Part("flood", 1, _selected("test_traffic", _FLOOD)),)),
)


class Progress:
    """A bar of the whole run: how much of each promise is done, by the time that it took before."""

    def __init__(self, results: Path, before: dict[str, dict[str, float]], keys: set[str], fraction: int) -> None:
        """Start at the beginning of the ``results``, the file with a line for each result."""
        self._results, self._read = results, 0
        rows = {key: before.get(key, {}) for key in keys}
        self._weights = {key: row.get("seconds", UNKNOWN) for key, row in rows.items()}
        trials = {key: PROMISES[key].full or row.get("trials", 1) for key, row in rows.items()}
        self._trials = {key: max(count / fraction, 1.0) for key, count in trials.items()}
        self._done = dict.fromkeys(keys, 0)
        self._bar = tqdm(
            total=1.0,
            disable=None,
            bar_format="{desc}{percentage:3.0f}%|{bar}| {elapsed}, about {remaining} left{postfix}",
        )

    def show(self, running: list[str]) -> None:
        """Show what is done now."""
        with self._results.open() as file:
            file.seek(self._read)
            for line in iter(file.readline, ""):
                entry = json.loads(line)
                if "result" in entry and entry["fault"] in self._done:
                    self._done[entry["fault"]] += entry["count"]
            self._read = file.tell()
        shares = {key: min(count / self._trials[key], 1.0) for key, count in self._done.items()}
        self._bar.n = sum(self._weights[key] * share for key, share in shares.items()) / sum(self._weights.values())
        self._bar.set_postfix_str(", ".join(sorted(set(running))))

    def close(self) -> None:
        """End the bar."""
        self._bar.close()


def run(stage: Stage, fraction: int, results: Path, progress: Progress) -> list[str]:
    """Run a stage; return the names of the processes that failed."""
    waiting = [(part, number) for part in stage.parts for number in range(part.processes)]
    running: dict[subprocess.Popen[bytes], tuple[str, str]] = {}
    failed: list[str] = []

    def start(part: Part, number: int, *beside: str) -> None:
        name = f"{part.name} {number}"
        running[_start(part, number, fraction, results, LOGS / f"{name}.log", beside)] = part.name, name

    with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as folder, busy_loops(stage.loops):
        try:
            for part in stage.beside:
                for number in range(part.processes):
                    start(part, number, f"--basetemp={folder}/{number}")
            beside = set(running)
            while waiting or running:
                while waiting and len(running.keys() - beside) < stage.at_once:
                    start(*waiting.pop(0))
                for process in [one for one in running if one.poll() is not None]:
                    _, name = running.pop(process)
                    if process.returncode:
                        failed.append(name)
                progress.show([part for part, _ in running.values()])
                time.sleep(0.2)
        finally:
            # After Ctrl-C, which has reached them too: they note what they have counted.
            for process in running:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(30.0)
                process.kill()
    return failed


def _start(
    part: Part, number: int, fraction: int, results: Path, log: Path, beside: tuple[str, ...]
) -> subprocess.Popen[bytes]:
    command = ["nice", f"-n{LOWEST_PRIORITY if beside else 0}", sys.executable, "-P", "-m", "pytest", "-q"]
    command += ["-p", "no:cacheprovider", "--faults=full", f"--faults-share={number}/{part.processes * fraction}"]
    command += [f"--faults-results={results}", *beside, *part.tests]
    with log.open("w") as output:
        return subprocess.Popen(command, cwd=ROOT, stdout=output, stderr=subprocess.STDOUT)


def _summary(key: str, results: list[list[Any]], seconds: float) -> dict[str, Any]:
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


def _merge(lines: Iterable[str], path: Path, minutes: float | None) -> None:
    """Write the JSON file from the lines of all processes; rows of faults that were not tried stay.

    ``minutes`` are those of the run if it was whole.
    """
    results: dict[str, list[list[Any]]] = {}
    seconds: dict[str, float] = {}
    suite: dict[str, dict[str, int]] = {}
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
    rows |= {key: _summary(key, found, seconds.get(key, 0.0)) for key, found in results.items()}
    content["faults"] = {key: rows[key] for key in PROMISES if key in rows}
    content["suite"] = content.get("suite", {}) | suite
    content["minutes"] = minutes
    content["machine"] = {
        "processors": os.cpu_count(),
        "python": platform.python_version(),
        "load": round(os.getloadavg()[2], 1),
    }
    write_json(path, content)


def main() -> int:
    """Run the stages and write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="of a part: %(default)s")
    parser.add_argument("--json", type=Path, default=ROOT / "docs" / "results" / "data" / "faults.json")
    parser.add_argument("--fraction", type=int, default=1, metavar="N", help="only every N-th trial")
    arguments = parser.parse_args()
    LOGS.mkdir(parents=True, exist_ok=True)
    results = LOGS / "results.jsonl"
    results.write_text("")
    before = json.loads(arguments.json.read_text())["faults"] if arguments.json.is_file() else {}
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    progress, failed, status = Progress(results, before, set(PROMISES), arguments.fraction), [], 0
    begin, whole = time.monotonic(), arguments.fraction == 1 and not arguments.names
    try:
        for stage in STAGES:
            parts, beside = (
                tuple(one for one in group if not arguments.names or one.name in arguments.names)
                for group in (stage.parts, stage.beside)
            )
            failed += run(stage._replace(parts=parts, beside=beside), arguments.fraction, results, progress)
    except KeyboardInterrupt:
        status = 130
    finally:
        progress.close()
        minutes = (time.monotonic() - begin) / 60.0
        _merge(results.read_text().splitlines(), arguments.json, round(minutes, 1) if whole and not status else None)
    for name in failed:
        print(f"--- {name}: see {LOGS / name}.log")
        print("\n".join((LOGS / f"{name}.log").read_text().splitlines()[-5:]))
    print(f"{len(failed)} processes with a broken promise, {minutes:.1f} minutes.")
    return status or int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
