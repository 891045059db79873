"""Test files are left out only where a package is missing, and never in the environment of `make setup`."""

import importlib.metadata
import subprocess
import sys
from pathlib import Path

import requirements
from packaging.requirements import Requirement

TESTS = Path(__file__).resolve().parents[1]
BLOCKED = """
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {names!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Blocked())
import importlib.util
find_spec = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: None if name in {names!r} else find_spec(name, *more)
import pytest
raise SystemExit(pytest.main({arguments!r}))
"""


def collect(names, *arguments):
    """Collect tests in an interpreter that finds none of ``names``; return the exit status and the report."""
    options = ["--collect-only", "-q", "-p", "no:cacheprovider", *arguments]
    program = BLOCKED.format(names=set(names), arguments=options)
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=TESTS.parent, capture_output=True, text=True, timeout=280, check=False)
    return done.returncode, done.stdout + done.stderr


def test_nothing_is_left_out_here_unless_there_is_no_browser():
    """A browser is no package of the environment: `make test` installs one only as root."""
    assert requirements.missing_packages() - {requirements.BROWSER} == set()
    assert requirements.left_out(set()) == {}
    assert requirements.summary({}) == ""


def test_tests_of_the_page_need_a_browser():
    lacking = requirements.left_out({requirements.BROWSER})
    assert {"lab/view/test_page.py", "graph/test_watch.py"} <= set(lacking)
    assert set(map(frozenset, lacking.values())) == {frozenset({requirements.BROWSER})}


def test_files_without_their_package_are_left_out_and_the_others_are_not():
    lacking = requirements.left_out({"numba", "rosbags"})
    assert lacking["sim/compiled/test_batch.py"] == {"numba"}
    assert lacking["bag/test_reader.py"] == {"rosbags"}
    assert not {"control/law/test_lyapunov_law.py", "bag/test_encoding.py", "graph/test_driving.py"} & set(lacking)


def test_one_line_names_packages_and_numbers_of_files():
    line = requirements.summary({"a.py": {"numba"}, "b.py": {"numba", "rosbags"}})
    assert line.startswith("2 test files are left out")
    assert line.endswith(": numba (2), rosbags (1)")


def test_the_rest_is_collected_without_errors():
    status, report = collect(["numba", "rosbags"], "test/bag", "test/core", "test/sim/compiled")
    assert status == 0, report
    assert "test_encoding.py" in report
    assert "test_reader.py" not in report
    (line,) = [line for line in report.splitlines() if "left out" in line]
    assert all(f"{name} (" in line for name in ("numba", "rosbags"))


def test_every_package_of_the_tests_is_known():
    """Those of the extra test that are imported: a missing plug-in of pytest is no reason to leave a file out."""
    extra = {
        requirement.name
        for requirement in map(Requirement, importlib.metadata.distribution("diffbot").requires)
        if requirement.marker is not None and requirement.marker.evaluate({"extra": "test"})
    }
    assert {name for name in extra if not name.startswith("pytest")} <= set(requirements.PACKAGES.values())
