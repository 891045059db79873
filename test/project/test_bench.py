"""Each part of the benchmarks runs in its short form, with plausible figures; no speed is asserted."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest
import requirements
import run

ROOT = Path(__file__).resolve().parents[2]
PARTS = tuple(part for part in run.PARTS if part != "page" or requirements.browser() is not None)
EXACT = {("recorder", "missing"): 0, ("recorder", "latched"): 0, ("replay", "wrong"): 0, ("replay", "inexact"): 0}
"""What does not depend on the machine: messages and files that are wrong."""

pytestmark = pytest.mark.graph


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """Run the short form of all parts once; return its result."""
    out = tmp_path_factory.mktemp("bench") / "new" / "bench.json"
    command = [sys.executable, str(ROOT / "bench" / "run.py"), "--quick", "--out", str(out), *PARTS]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return json.loads(out.read_text()), done


def test_parts_run(quick):
    result, done = quick
    assert done.returncode == 0, done.stderr
    assert {name: part["error"] for name, part in result["parts"].items()} == dict.fromkeys(PARTS, "")


@pytest.mark.parametrize("part", PARTS)
def test_figures_are_plausible(quick, part):
    rows = quick[0]["parts"][part]["rows"]
    assert rows
    for key, row in rows.items():
        if (part, key) in EXACT:
            assert row["ours"] == EXACT[part, key], key
            continue
        given = [row[name] for name in ("ours", "reference", "ratio") if row[name] is not None]
        assert all(0.0 < one < math.inf for one in (*given, *row["spread"])), key
        if row["rounds"] == 1 and row["ratio"] is not None:
            assert row["ratio"] == pytest.approx(row["ours"] / row["reference"]), key
