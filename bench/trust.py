"""Do the tests pass every time? ``python bench/trust.py [--runs N] [--resume] [NAME=VALUE ...]``.

Clones the committed HEAD into a temporary folder, runs ``make setup`` there once, and then ``make test`` again and
again, every second time with four busy loops beside it. Variables such as ``ARGS=test/core`` go to ``make test``.
After each run the data and the page docs/results/trust.md are written anew, so that Ctrl-C keeps what is done;
``--resume`` goes on with these runs, of their commit. The output of a failed run stays in out/trust. Exit status 1 if a
run failed, 130 after Ctrl-C.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from diffbot_core.files import write_json, write_text

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results"
LOGS = ROOT / "out" / "trust"
LOOPS = 4
BUSY_LOOP = "import select, sys\nwhile not select.select([sys.stdin], [], [], 0.0)[0]:\n    sum(range(100_000))"
"""Ends when its standard input does, with this process, however that ends."""
TIME_LIMIT = 3600.0
"""[s] of a run, after which it is ended and has failed"""
FOREIGN = ("MAKEFLAGS", "MAKELEVEL", "MFLAGS", "VIRTUAL_ENV", "PYTHONPATH", "PYTEST_ADDOPTS", "PYTEST_XDIST_WORKER")
"""Variables of the shell or the make that started this, not of a fresh clone."""


@contextlib.contextmanager
def busy_loops(count: int) -> Iterator[None]:
    """Keep ``count`` processes busy while the ``with`` block lasts.

    They share one session, as programs started in one shell do: Linux divides processors by sessions first, and then
    among the processes of each.
    """
    script = f"for _ in $(seq {count}); do '{sys.executable}' -c '{BUSY_LOOP}' <&0 & done; wait"
    loops = subprocess.Popen(["bash", "-c", script], stdin=subprocess.PIPE, start_new_session=True)
    try:
        yield
    finally:
        loops.communicate()


def call(command: list[str], folder: Path, log: Path) -> int | None:
    """Run a command with its output to ``log``; return its exit status, None if the time limit ended it.

    It has a session of its own: Ctrl-C reaches this process, which ends the command and what it has left running.
    """
    environment = {name: value for name, value in os.environ.items() if name not in FOREIGN}
    with log.open("w") as output:
        process = subprocess.Popen(
            command, cwd=folder, env=environment, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
        )
    try:
        in_time = _ends(process, TIME_LIMIT)
    except BaseException:
        os.killpg(process.pid, signal.SIGINT)
        _ends(process, 30.0)
        raise
    finally:
        # Until it is waited for, its id stands for its own group.
        os.killpg(process.pid, signal.SIGKILL)
        status = process.wait()
    return status if in_time else None


def _ends(process: subprocess.Popen[bytes], patience: float) -> bool:
    """Return if a process ends within so many seconds; it is left to be waited for."""
    deadline = time.monotonic() + patience
    while os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT | os.WNOHANG) is None:
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


def counts_of(report: Path) -> dict[str, Any]:
    """Return how many tests passed and failed, and the names of the failed ones, from a report in JUnit's format."""
    if not report.is_file():
        return {"passed": 0, "failed": 0, "failing": []}
    cases = list(ET.parse(report).getroot().iter("testcase"))
    failing = [case for case in cases if case.find("failure") is not None or case.find("error") is not None]
    skipped = sum(case.find("skipped") is not None for case in cases)
    names = sorted({f"{case.get('classname')}::{case.get('name')}" for case in failing})
    return {"passed": len(cases) - len(failing) - skipped, "failed": len(failing), "failing": names}


def one_run(number: int, clone: Path, variables: list[str]) -> dict[str, Any]:
    """Run the tests once; return what came of it."""
    busy = number % 2 == 0
    log, report = LOGS / f"run-{number:02d}.log", clone / "out" / "report.xml"
    report.unlink(missing_ok=True)
    given = dict(one.split("=", 1) for one in variables)
    given["ARGS"] = f"--junitxml={report} {given.get('ARGS', '')}".strip()
    before = os.getloadavg()[0]
    with busy_loops(LOOPS if busy else 0):
        begin = time.monotonic()
        status = call(["make", "test", *(f"{name}={value}" for name, value in given.items())], clone, log)
        seconds = time.monotonic() - begin
    counts = counts_of(report)
    ok = status == 0 and counts["passed"] > 0 and not counts["failed"]
    if ok:
        log.unlink()
    load = [round(before, 2), round(os.getloadavg()[0], 2)]
    return {
        "run": number,
        "busy": busy,
        "ok": ok,
        "status": status,
        **counts,
        "seconds": round(seconds, 1),
        "load": load,
    }


def prepare(clone: Path, revision: str) -> dict[str, Any]:
    """Clone a revision, make its environment; return the conditions."""
    commit = subprocess.check_output(["git", "-C", str(ROOT), "rev-parse", revision], text=True).strip()
    subprocess.run(["git", "clone", "--quiet", "--no-checkout", str(ROOT), str(clone)], check=True)
    subprocess.run(["git", "-C", str(clone), "checkout", "--quiet", "--detach", commit], check=True)
    log = LOGS / "setup.log"
    if call(["make", "setup"], clone, log) != 0:
        raise SystemExit(f"make setup failed, see {log}")
    return {
        "commit": commit[:12],
        "date": time.strftime("%Y-%m-%d"),
        "cores": len(os.sched_getaffinity(0)),
        "python": platform.python_version(),
        "loops": LOOPS,
    }


def write(content: dict[str, Any]) -> None:
    """Write data and page, each under a temporary name that is then changed."""
    import trust_page

    write_json(RESULTS / "data" / "trust.json", content)
    write_text(RESULTS / "trust.md", trust_page.page(content))


def main() -> int:
    """Run the tests; return the exit status."""
    parser = argparse.ArgumentParser(description="Run the tests of HEAD in a fresh clone, again and again.")
    parser.add_argument("--runs", type=int, default=20, help="(default: %(default)s)")
    parser.add_argument("--resume", action="store_true", help="go on with the runs of docs/results/data/trust.json")
    parser.add_argument("variables", nargs="*", metavar="NAME=VALUE", help="for make test, such as ARGS=test/core")
    options = parser.parse_args()
    if options.runs < 1 or not all("=" in one for one in options.variables):
        parser.error("--runs must be >= 1, and what follows NAME=VALUE")
    sys.path.append(str(ROOT / "docs"))
    LOGS.mkdir(parents=True, exist_ok=True)
    before: dict[str, Any] = json.loads((RESULTS / "data" / "trust.json").read_text()) if options.resume else {}
    runs, variables = before.get("runs", []), before.get("variables", options.variables)
    try:
        with tempfile.TemporaryDirectory(prefix="diffbot-trust-") as folder:
            clone = Path(folder) / "diffbot"
            revision = before.get("commit", "HEAD")
            print(f"Cloning {revision} and making its environment ...", flush=True)
            conditions = prepare(clone, revision)
            for name in ("cores", "python"):
                if before.get(name, conditions[name]) != conditions[name]:
                    raise SystemExit(f"{name}: {conditions[name]}, but {before[name]} in the runs before")
            content = {**conditions, "variables": variables, "planned": options.runs, "runs": runs}
            for number in range(len(runs) + 1, options.runs + 1):
                runs.append(one_run(number, clone, variables))
                write(content)
                print(line_of(runs[-1], options.runs), flush=True)
    except KeyboardInterrupt:
        print(f"Interrupted after {len(runs)} of {options.runs} runs", file=sys.stderr)
        return 130
    return int(not all(one["ok"] for one in runs))


def line_of(run: dict[str, Any], planned: int) -> str:
    """Say what came of a run."""
    kind = f"{LOOPS} busy loops" if run["busy"] else "quiet"
    text = f"{run['run']} of {planned}, {kind}: {run['passed']} passed, {run['failed']} failed, {run['seconds']:.0f} s"
    if run["ok"]:
        return text
    status = "time limit" if run["status"] is None else f"status {run['status']}"
    return "\n  ".join([f"{text}, {status}: out/trust/run-{run['run']:02d}.log", *run["failing"]])


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM):  # a shell starts its background with SIGINT ignored
        signal.signal(number, signal.default_int_handler)
    raise SystemExit(main())
