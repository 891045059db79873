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


NAMES = """
import sys
import numba
import numpy as np
from numba.core.itanium_mangler import mangle
from diffbot_sim.compiled import ekf, jit

for n in sys.argv[1:]:
    record = numba.typeof(np.zeros(1, ekf.belief_type(int(n)))).dtype
    print(n, mangle("f", [record]), mangle("f", [record.typeof("P")]))
"""


def test_functions_for_records_of_two_sizes_have_names_of_their_own_in_every_process():
    """The cache may hold both from two processes; of equal names, the first that is loaded would run for both."""
    found = set()
    for sizes in ("6", "10"), ("10", "6"):
        command = [sys.executable, "-P", "-c", NAMES, *sizes]
        found.update(subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines())
    assert len(found) == 2
    names = [name for line in found for name in line.split()[1:]]
    assert len(set(names)) == 4


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
