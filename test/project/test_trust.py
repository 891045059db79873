"""``make trust`` on a small repository whose tests fail as planned: what it counts, keeps and ends."""

import json
import os
import subprocess
import sys
from pathlib import Path

import graph
import pytest
import trust
import trust_page

pytestmark = pytest.mark.install

MAKEFILE = """\
setup:
	@touch environment
test:
	@test -f environment && echo run >> runs && {python} -m pytest -q -p no:cacheprovider $(ARGS) test_it.py
"""
TESTS = """\
from pathlib import Path

def test_kept(): assert True

def test_second_run(): assert len(Path("runs").read_text().split()) != 2
"""


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A repository whose second run of the tests fails; results go to docs/results in it."""
    (tmp_path / "Makefile").write_text(MAKEFILE.format(python=sys.executable))
    (tmp_path / "test_it.py").write_text(TESTS)
    (tmp_path / "docs" / "results" / "data").mkdir(parents=True)
    for arguments in (["init", "-q"], ["add", "."], ["-c", "user.name=a", "-c", "user.email=a", "commit", "-qm", "a"]):
        subprocess.run(["git", *arguments], cwd=tmp_path, check=True)
    (tmp_path / "test_it.py").write_text("not committed")
    monkeypatch.setattr(trust, "ROOT", tmp_path)
    monkeypatch.setattr(trust, "RESULTS", tmp_path / "docs" / "results")
    monkeypatch.setattr(trust, "LOGS", tmp_path / "out")
    monkeypatch.setattr(trust, "LOOPS", 1)
    return tmp_path


def children():
    return set(Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())


def kept(project):
    return json.loads((project / "docs" / "results" / "data" / "trust.json").read_text())


def call(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["trust.py", *arguments])
    return trust.main()


def test_each_run_is_counted_and_the_log_of_a_failed_one_is_kept(project, monkeypatch):
    assert call(monkeypatch, "--runs", "3") == 1
    found = kept(project)["runs"]
    assert [(one["busy"], one["ok"], one["passed"], one["failed"]) for one in found] == [
        (False, True, 2, 0),
        (True, False, 1, 1),
        (False, True, 2, 0),
    ]
    assert found[1]["failing"] == ["test_it::test_second_run"]
    assert [path.name for path in (project / "out").glob("run-*")] == ["run-02.log"]
    assert "| `test_it::test_second_run` | 1 |" in (project / "docs" / "results" / "trust.md").read_text()


def test_an_interrupt_keeps_the_runs_so_far(project, monkeypatch):
    one_run = trust.one_run

    def interrupted(number, *arguments):
        if number == 2:
            raise KeyboardInterrupt
        return one_run(number, *arguments)

    monkeypatch.setattr(trust, "one_run", interrupted)
    assert call(monkeypatch, "--runs", "3", "ARGS=-k kept") == 130
    content = kept(project)
    assert [(one["passed"], one["failed"]) for one in content["runs"]] == [(1, 0)]
    assert "1 of 1 runs of `make test ARGS=-k kept` passed (3 were planned)" in trust_page.page(content)
    monkeypatch.setattr(trust, "one_run", one_run)
    subprocess.run(["git", "-c", "user.name=a", "-c", "user.email=a", "commit", "-qam", "b"], cwd=project, check=True)
    assert call(monkeypatch, "--runs", "2", "--resume") == 0, "of the first commit, and of the same tests"
    resumed = kept(project)
    assert (resumed["commit"], resumed["variables"]) == (content["commit"], content["variables"])
    assert [(one["run"], one["busy"], one["passed"]) for one in resumed["runs"]] == [(1, False, 1), (2, True, 1)]


def test_busy_loops_and_a_command_that_hangs_are_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(trust, "TIME_LIMIT", 0.5)
    before = children()
    with trust.busy_loops(2):
        assert len(children() - before) == 2
        assert trust.call(["sh", "-c", "sleep 600 & echo $!; wait"], tmp_path, tmp_path / "log") is None
    assert children() == before
    sleeper = Path("/proc", (tmp_path / "log").read_text().strip(), "cmdline")
    graph.wait_for(lambda: not sleeper.exists() or not sleeper.read_bytes(), what="the end of the sleeper")


def test_the_page_has_shares_with_intervals_and_times_by_load():
    """Wilson's 95 % intervals of 2 of 2, 1 of 2 and 3 of 4, as R's binom.confint gives them."""
    runs = [
        {"busy": busy, "ok": ok, "passed": 9, "failed": 0, "failing": [], "seconds": seconds, "load": [1.0, 2.0]}
        for busy, ok, seconds in ((False, True, 10.0), (True, False, 30.0), (False, True, 20.0), (True, True, 50.0))
    ]
    content = {"commit": "abc", "date": "today", "cores": 2, "python": "3", "loops": 4, "planned": 4, "variables": []}
    lines = trust_page.page({**content, "runs": runs}).splitlines()
    assert [line for line in lines if line.startswith("|")][2:] == [
        "| without busy loops | 2 | 2 | 34 to 100 % | 15 s | 20 s |",
        "| 4 busy loops | 2 | 1 | 9 to 91 % | 40 s | 50 s |",
        "| all | 4 | 3 | 30 to 95 % | 25 s | 50 s |",
    ]
