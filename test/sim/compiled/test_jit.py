"""The cache of compiled code is named by all code that can decide a result."""

import fcntl
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest
from project_files import SITE

from diffbot_control.law.controller import SwitchingLaw
from diffbot_sim.compiled import batch
from diffbot_sim.compiled.jit import PACKAGES, code_version, one_compiler


def test_one_process_compiles_at_a_time(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    with one_compiler("version"):
        (lock,) = tmp_path.rglob("*.lock")
        with lock.open() as other, pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    with lock.open() as other:
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_without_a_folder_for_the_cache_it_compiles_in_one_of_its_own(tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.touch()
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(file))
    with one_compiler("version"):
        assert file.read_bytes() == b""
        assert Path(numba.config.CACHE_DIR).stat().st_mode & 0o077 == 0


CACHE = """
import numba  # first, as a user's program may have it
from pathlib import Path
from diffbot_control.filter import options
from diffbot_control.law.controller import SwitchingLaw
from diffbot_sim.compiled import batch, jit

assert str(Path(options.__file__).parents[2]) == str(Path.cwd())
print(jit.code_version(), batch._kernels.newest(SwitchingLaw).stats.cache_path, str(numba.config.CACHE_DIR), sep="\\n")
"""


def test_another_default_of_the_filter_is_compiled_into_another_folder(tmp_path):
    copied = tmp_path / "site"
    for package in PACKAGES:
        shutil.copytree(SITE / package, copied / package, ignore=shutil.ignore_patterns("__pycache__"))
    environment = {**os.environ, "PYTHONPATH": str(copied), "XDG_CACHE_HOME": str(tmp_path)}
    environment.pop("NUMBA_CACHE_DIR", None)
    options = copied / "diffbot_control" / "filter" / "options.py"
    found = []
    for more in ("", "\n_CONSTANT = 2.0\n"):
        options.write_text(options.read_text() + more)
        command = [sys.executable, "-c", CACHE]
        result = subprocess.run(command, check=True, env=environment, cwd=copied, capture_output=True, text=True)
        version, cache, untouched = result.stdout.splitlines()
        assert f"{tmp_path}/diffbot/{version}/" in cache
        assert version not in untouched
        found.append(version)
    assert found[0] == code_version()
    assert found[1] != found[0]
    assert f"/{code_version()}/" in batch._kernels.newest(SwitchingLaw).stats.cache_path


SUMS = """
import sys
import numpy as np
from diffbot_sim.compiled.jit import compile_kernel, make_callable

def sum_of(record, more):
    found = more  # so long, and called so often, that it is not put into its callers
    for i in range(len(record["x"])):
        found += record["x"][i] + 0.0 * np.sin(record["x"][i]) * np.cos(record["x"][i])
    for i in range(len(record["x"])):
        found += 0.0 * np.tan(record["x"][i]) * np.arctan(record["x"][i]) + 0.0 * np.log(record["x"][i])
    return found

def sums(records):
    first = sum_of(records[0], 0.0) + 100.0 * sum_of(records[0], 0.0)
    return first if first < 0.0 else sum_of(records[0], 3.0) + 100.0 * sum_of(records[0], 5.0)

make_callable(sum_of, inline=False)
kernel = compile_kernel(sums)
for n in map(int, sys.argv[1:]):
    records = np.zeros(1, np.dtype([("x", float, (n,)), ("y", float)]))
    records["x"] = 1.0
    print(kernel(records))
"""


def test_kernels_that_two_processes_compiled_are_right_in_a_third(tmp_path):
    """Their records differ in size, and numba has the same number for both in processes of their own."""
    program = tmp_path / "sums.py"
    program.write_text(SUMS)
    for sizes, expected in (("6", "1109"), ("10", "1513"), ("6 10", "1109 1513")):
        command = [sys.executable, str(program), *sizes.split()]
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
        result = subprocess.run(command, check=True, env=environment, capture_output=True, text=True)
        assert [float(one) for one in result.stdout.split()] == [float(one) for one in expected.split()]
