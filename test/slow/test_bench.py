"""Each benchmark runs in its short form and prints finite figures; speeds are not tested."""

import math
import re
import subprocess
import sys

import pytest
from source_files import ROOT


@pytest.mark.slow
@pytest.mark.parametrize("name", ["latency", "recorder", "batch"])
def test_a_benchmark_prints_a_table_of_finite_figures(name):
    command = [sys.executable, str(ROOT / "bench" / f"{name}.py"), "--quick"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    header, *rows = done.stdout.splitlines()
    assert header.split() == ["measure", "ours", "reference", "ratio", "range", "rounds"]
    assert len(rows) >= 4
    for row in rows:
        ours, *rest = re.split(r"  +", row)[1:]
        assert all(math.isfinite(float(one)) for one in (ours, *rest[:-2], *rest[-2].split(" to "))), row
