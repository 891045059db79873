"""Interrupted and disturbed campaigns have the same results, and files of others are never changed."""

import json
import os
import resource
import signal
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor

import distributed
import pytest
from project_files import files_read_by

from diffbot_control.law.registry import resolve_law
from diffbot_core.errors import DiffbotError
from diffbot_lab.campaign import report, spec
from diffbot_lab.campaign import runner as module
from diffbot_lab.campaign.journal import JOURNAL, Journal, decode_line, encode_line
from diffbot_lab.campaign.runner import cluster_executor, open_chunks, run_campaign, run_chunk
from diffbot_lab.campaign.spec import make_campaign
from diffbot_lab.campaign.statistics import CellStatistics, count_outcomes
from diffbot_sim.batch import run_batch
from diffbot_sim.jit import PACKAGES
from diffbot_tools import cli

SMALL = {
    "runs": 60,
    "duration": 12.0,
    "feedback": "raw",
    "start": {"box": {"x": [-2.0, 2.0], "y": [-2.0, 2.0]}},
    "set": {"preset": "paper"},
    "grid": {"k": [1.0, 4.0], "eps_P": [0.1, 0.5]},
}


@pytest.fixture(scope="module", autouse=True)
def small_chunks():
    """Split the 60 runs of a cell, of 120 steps each, into 8 chunks of 7 runs and one of 4."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(spec, "_STEPS_PER_CHUNK", 7 * 120)
        yield


def flags(description, out):
    listed = [f"--{name}={description[name]}" for name in ("runs", "duration", "feedback")]
    listed += ["--start", json.dumps(description["start"])]
    listed += ["--set", *(f"{name}={value}" for name, value in description.get("set", {}).items())]
    return [*listed, "--grid", *(f"{name}={values}" for name, values in description["grid"].items()), "--out", str(out)]


def two_threads():
    return ThreadPoolExecutor(2)


def run(folder, description=SMALL, make_executor=two_threads):
    campaign = make_campaign(description)
    journal = Journal(folder / JOURNAL, campaign)
    try:
        run_campaign(campaign, journal, make_executor, 2)
    finally:
        journal.close()
    return journal


def summaries(journal):
    return [one.summary() for one in journal.statistics]


def assert_complete(folder, expected):
    """Check that the journal on the disk contains every chunk, so that no chunk is run."""
    assert summaries(run(folder, SMALL, lambda: Failing(AssertionError("nothing to run")))) == expected


@pytest.fixture(scope="module")
def expected():
    campaign = make_campaign(SMALL)
    found = []
    for cell in campaign.cells:
        found.append(CellStatistics())
        found[-1].add(count_outcomes(run_batch(cell.case, campaign.starts, 1, 0, 60, law=resolve_law(cell.law))))
    return [one.summary() for one in found]


def test_a_campaign_continues_from_a_journal_cut_anywhere(tmp_path, expected):
    run(tmp_path)
    whole = (tmp_path / JOURNAL).read_bytes()
    header = whole.index(b"\n") + 1
    for end in (17, header - 1, header + 500, len(whole) - 1):
        (tmp_path / JOURNAL).write_bytes(whole[:end])
        assert summaries(run(tmp_path)) == expected
        assert_complete(tmp_path, expected)


def damaged_lines(lines):
    yield from (b"null\n", b"\x00\xff\n", lines[2][:50] + b"\n", b"[" * 9999 + b"\n")
    yield json.dumps(decode_line(lines[2])).encode() + b"\n"  # without a checksum
    yield lines[2].replace(b'"runs":7', b'"runs":6')
    yield encode_line({"cell": 0})


def test_the_runs_of_a_damaged_line_are_repeated(tmp_path, expected):
    run(tmp_path)
    path = tmp_path / JOURNAL
    lines = path.read_bytes().splitlines(keepends=True)
    for line in damaged_lines(lines):
        path.write_bytes(b"".join([*lines[:2], line, *lines[3:]]))
        journal = run(tmp_path)
        assert journal.damaged == 1
        assert summaries(journal) == expected
        assert path.read_bytes().splitlines(keepends=True)[-1] == lines[2]
    path.write_bytes(b"".join([*lines, lines[2]]))  # a chunk twice counts once
    assert_complete(tmp_path, expected)


def assert_refused(folder, capsys, text):
    """Check that the command fails with one line and changes no file."""
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert cli.main(["campaign", *flags(SMALL, folder)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert text in error
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize("content", [b"hello", bytes(range(256)), encode_line({"format": 999})])
def test_a_file_that_is_not_a_journal_is_not_changed(content, tmp_path, capsys):
    (tmp_path / JOURNAL).write_bytes(content)
    assert_refused(tmp_path, capsys, "is not a journal of a campaign (format 3): choose another --out")


def test_the_journal_of_another_campaign_is_not_changed(tmp_path, capsys):
    path = tmp_path / JOURNAL
    Journal(path, make_campaign(SMALL)).close()
    header = decode_line(path.read_bytes())
    for key, message in (
        ("identity", "belongs to another campaign"),
        ("sources", "another version of the code"),
    ):
        path.write_bytes(encode_line({**header, key: "0" * 16}))
        assert_refused(tmp_path, capsys, message)


@pytest.mark.parametrize("name", ["results.json", "results.csv"])
def test_results_of_another_command_are_not_overwritten(name, tmp_path, capsys):
    (tmp_path / name).write_text("of another command")
    assert_refused(tmp_path, capsys, f"{name} was not written by a campaign: choose another --out")


def test_two_campaigns_with_one_journal_count_each_chunk_once(tmp_path, expected):
    other = Journal(tmp_path / JOURNAL, make_campaign(SMALL))
    run(tmp_path)
    run_campaign(make_campaign(SMALL), other, two_threads, 2)
    other.close()
    assert summaries(other) == expected
    assert_complete(tmp_path, expected)


def test_a_full_disk_is_one_error_line_and_finished_chunks_are_kept(tmp_path, expected):
    campaign = make_campaign(SMALL)
    journal = Journal(tmp_path / JOURNAL, campaign)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (12_000, limits[1]))
    try:
        with pytest.raises(DiffbotError, match=r"cannot write .*campaign\.jsonl: File too large"):
            run_campaign(campaign, journal, two_threads, 1)
    finally:
        journal.close()
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (tmp_path / JOURNAL).stat().st_size == 12_000
    assert len(journal.done) > 2
    assert summaries(run(tmp_path)) == expected


def test_the_size_of_chunks_is_limited_by_steps_and_by_runs(monkeypatch):
    monkeypatch.setattr(spec, "_STEPS_PER_CHUNK", 2_000_000)
    chunks = list(open_chunks(make_campaign({"runs": 10**7, "duration": 0.1}), set()))
    assert sum(chunk.number for chunk in chunks) == 10**7
    assert max(chunk.number for chunk in chunks) < 10**6  # all outcomes of a chunk are in memory
    long = make_campaign({"runs": 3, "duration": 1e5, "set": {"sampling_time": 0.01}})
    assert [chunk.number for chunk in open_chunks(long, set())] == [1, 1, 1]


def test_a_worker_of_another_version_is_refused():
    chunk = next(open_chunks(make_campaign(SMALL), set()))
    assert run_chunk(chunk)["runs"] == 7
    with pytest.raises(DiffbotError, match="another version of the code"):
        run_chunk(chunk._replace(sources="0" * 16))


def _die():
    os._exit(1)


@pytest.mark.graph
def test_a_campaign_ends_if_its_workers_keep_dying(tmp_path, expected):
    pools = []

    def make_executor():
        pools.append(ProcessPoolExecutor(1, initializer=_die))
        return pools[-1]

    with pytest.raises(DiffbotError, match="workers were killed again and again") as caught:
        run(tmp_path, SMALL, make_executor)
    assert "\n" not in str(caught.value)
    assert 2 <= len(pools) <= 5
    assert summaries(run(tmp_path)) == expected


class Failing(Executor):
    """An executor whose workers fail."""

    def __init__(self, error):
        self.error = error

    def submit(self, *_arguments, **_options):
        future = Future()
        future.set_exception(self.error)
        return future


def test_a_failing_worker_is_one_error_line(tmp_path):
    with pytest.raises(DiffbotError, match=r"a worker failed: RuntimeError lost worker; finished chunks are kept$"):
        run(tmp_path, SMALL, lambda: Failing(RuntimeError("lost\nworker")))


def test_an_unreachable_scheduler_is_one_error_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(module, "_CONNECT_TIMEOUT", 0.5)
    assert cli.main(["campaign", *flags(SMALL, tmp_path / "out"), "--scheduler", "tcp://127.0.0.1:1"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("diffbot: no scheduler at tcp://127.0.0.1:1: ")
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_the_version_includes_all_files_that_a_campaign_reads():
    read = files_read_by(
        "from diffbot_lab.campaign import report\nfrom diffbot_lab.campaign.spec import make_campaign\n"
        "make_campaign({'runs': 5, 'set': {'preset': 'precise'}})"
    )
    names = set(map(str, read))
    assert {"diffbot_control/filter/config.py", "diffbot_lab/cases.py", "diffbot_sim/plant.py"} < names
    assert {path.parts[0] for path in read} == {*PACKAGES, "diffbot_tools", "diffbot_lab"}


@pytest.mark.graph
def test_a_cluster_with_a_killed_worker_has_the_same_results(tmp_path, expected, monkeypatch):
    monkeypatch.setattr(module, "_CONNECT_TIMEOUT", 60.0)
    journal, add = Journal(tmp_path / JOURNAL, make_campaign(SMALL)), Journal.add
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        cluster_executor(cluster.scheduler_address) as (make_executor, workers),
    ):
        assert workers == 1
        (worker,) = cluster.workers.values()
        pid, kills = worker.process.process.pid, []

        def add_and_kill(*entry):
            add(*entry)
            if len(journal.done) == 2:
                os.kill(pid, signal.SIGKILL)
                kills.append(pid)

        monkeypatch.setattr(Journal, "add", add_and_kill)
        run_campaign(make_campaign(SMALL), journal, make_executor, 2)
        journal.close()
        assert kills == [pid]
        assert summaries(journal) == expected
    with pytest.raises(Exception, match="closed"):
        make_executor().submit(abs, -1).result(60.0)


def test_an_interrupted_campaign_writes_the_same_bytes(tmp_path, capsys, monkeypatch, kept_signal_handlers):
    monkeypatch.setattr(report, "process_pool", ThreadPoolExecutor)
    monkeypatch.setattr(report, "save", lambda _figure, path: path.touch())
    one, two = tmp_path / "one", tmp_path / "two"
    add = Journal.add

    def interrupted(journal, *entry):
        add(journal, *entry)
        if len(journal.done) % 10 == 0:
            signal.raise_signal(interrupts[0])

    monkeypatch.setattr(Journal, "add", interrupted)
    command = ["campaign", *flags(SMALL, one), "--workers", "2"]
    interrupts = [signal.SIGINT, signal.SIGTERM]
    for kept in (10, 20):
        assert cli.main(command) == 130
        assert "of 240 runs are kept" in capsys.readouterr().err
        assert (one / JOURNAL).read_bytes().count(b"\n") == 1 + kept
        assert [path.name for path in one.iterdir()] == [JOURNAL]
        interrupts.reverse()
    monkeypatch.setattr(Journal, "add", add)
    assert cli.main(command) == 0
    # Another number of workers only changes the order of the lines of the journal.
    assert cli.main(["campaign", *flags(SMALL, two), "--workers", "1"]) == 0
    found, wanted = ({path.name: path.read_bytes() for path in folder.iterdir()} for folder in (one, two))
    assert len(found) == 6
    assert sorted(found.pop(JOURNAL).splitlines()) == sorted(wanted.pop(JOURNAL).splitlines())
    assert found == wanted
