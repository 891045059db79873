"""The benchmark runs, and its table agrees with the documentation; no time is asserted."""

import json
import math
import subprocess
import sys
from pathlib import Path

import bench
import pytest
from bench_table import MEASURES, OURS, BenchError, Measure, Pair, make_row, make_rows

ROOT = Path(__file__).resolve().parents[2]
STEPS = (
    "controller_step",
    "supervisor_on_pose",
    "ekf_step",
    "default_filter_step",
    "fnn_step",
    "closed_loop_step",
)


def run_bench(*arguments):
    command = [sys.executable, str(ROOT / "test" / "bench" / "bench.py"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=280, check=False)


def test_quick_run_of_the_steps(tmp_path):
    out = tmp_path / "new" / "bench.json"
    result = run_bench("--quick", "--only", "steps", "--out", str(out))
    assert result.returncode == 0, result.stderr
    content = json.loads(out.read_text())
    assert content["complete"] is True
    assert content["errors"] == []
    assert [row["key"] for row in content["rows"]] == list(STEPS)
    for row in content["rows"]:
        numbers = [row["ours"], *row["spread"]]
        numbers += [row[key] for key in ("reference", "ratio") if row[key] is not None]
        assert all(math.isfinite(number) and number > 0.0 for number in numbers), row
        assert row["rounds"] == bench.QUICK.steps
        assert (row["met"] is None) == (row["target"] == "")
    by_key = {row["key"]: row for row in content["rows"]}
    assert by_key["ekf_step"]["reference"] is not None
    assert [path.name for path in out.parent.iterdir()] == ["bench.json"]
    for measure in MEASURES:
        assert (measure.text in result.stdout) == (measure.key in STEPS)


@pytest.mark.graph
def test_quick_run_of_the_starts(tmp_path):
    out = tmp_path / "bench.json"
    result = run_bench("--quick", "--only", "start", "--out", str(out))
    assert result.returncode == 0, result.stderr
    rows = {row["key"]: row for row in json.loads(out.read_text())["rows"]}
    nodes = ("controller", "plant", "recorder", "ekf", "robot")
    starts, memories = ([f"{kind}_{node}" for node in nodes] for kind in ("start", "memory"))
    assert list(rows) == [*starts, "first_pose_ekf", *memories]
    for name, row in rows.items():
        assert row["ratio"] == pytest.approx(row["ours"] / row["reference"]), name
        # An interpreter with rclpy needs tenths of a second and tens of megabytes, on any machine.
        low, high = (20.0, 500.0) if name.startswith("memory") else (0.05, 30.0)
        assert low < row["reference"] < high, name
        assert low < row["ours"] < high, name


def test_docs_are_only_written_from_a_whole_run():
    result = run_bench("--quick", "--write-docs")
    assert result.returncode == 2
    assert "--write-docs" in result.stderr


def test_docs_show_each_measure_between_the_markers():
    page = bench.DOCS.read_text(encoding="utf-8")
    assert page.count(bench.BEGIN) == page.count(bench.END) == 1
    table = page.split(bench.BEGIN)[1].split(bench.END)[0]
    assert [measure.text for measure in MEASURES if f"| {measure.text} |" not in table] == []


def test_write_docs_replaces_only_what_stands_between_the_markers(tmp_path, monkeypatch):
    page = tmp_path / "performance.md"
    page.write_text(f"before\n{bench.BEGIN}\nold\n{bench.END}\nafter\n")
    monkeypatch.setattr(bench, "DOCS", page)
    rows = make_rows({"ekf_step": [Pair(30.0, 20.0)]})
    bench.write_docs(rows, bench.machine())
    text = page.read_text()
    assert text.startswith(f"before\n{bench.BEGIN}\n")
    assert text.endswith(f"{bench.END}\nafter\n")
    assert "| 30 us | 20 us | 1.50 | <= 1.5 x | yes |" in text
    assert "old" not in text


def test_medians_are_of_the_ratios_of_the_rounds():
    measure = Measure("key", "text", "ms", at_most=1.0)
    row = make_row(measure, [Pair(1.0, 2.0), Pair(8.0, 2.0), Pair(3.0, 4.0)])
    assert (row.ours, row.reference, row.ratio) == (3.0, 2.0, 0.75)
    assert row.spread == (0.5, 4.0)
    assert row.met is True
    assert row.cells()[3:6] == ("0.75", "<= 1 x", "yes")


@pytest.mark.parametrize(
    ("measure", "pair", "met"),
    [
        (Measure("key", "text", "us", OURS, at_most=20.0), Pair(20.1, None), False),
        (Measure("key", "text", "us", OURS, at_most=20.0), Pair(19.9, None), True),
        (Measure("key", "text", "steps/s", at_least=0.75), Pair(700.0, 1000.0), False),
        (Measure("key", "text", "steps/s", at_least=0.75), Pair(800.0, 1000.0), True),
        (Measure("key", "text", "us"), Pair(1.0, 2.0), None),
    ],
)
def test_targets(measure, pair, met):
    assert make_row(measure, [pair]).met is met


def succeed():
    return {"ekf_step": Pair(40.0, 20.0)}


def fail():
    raise BenchError("no 'begin' from the source")


def interrupt():
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("jobs", "strict", "status", "rounds"),
    [
        ([succeed, succeed], False, 0, 2),
        ([succeed], True, 2, 1),
        ([fail, succeed], True, 1, 1),
        ([succeed, interrupt, succeed], False, 130, 1),
    ],
)
def test_failures_and_interrupts_keep_what_is_done(jobs, strict, status, rounds):
    outcome = bench.run([(job.__name__, job) for job in jobs])
    rows = make_rows(outcome.samples)
    assert [row.rounds for row in rows] == [rounds]
    assert bench.status(outcome, rows, strict) == status
    assert outcome.errors == (["fail: no 'begin' from the source"] if fail in jobs else [])
