"""Campaigns end with the same results whatever happens on the way, and never touch files of others."""

import json
import os
import resource
import signal
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor

import distributed
import pytest
from project_files import files_read_by

from diffbot_control.goals.registry import resolve_law
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


def do(folder, description=SMALL, make_executor=two_threads):
    campaign = make_campaign(description)
    journal = Journal(folder / JOURNAL, campaign)
    try:
        run_campaign(campaign, journal, make_executor, 2)
    finally:
        journal.close()
    return journal


def summaries(journal):
    return [one.summary() for one in journal.statistics]


@pytest.fixture(scope="module")
def expected():
    campaign = make_campaign(SMALL)
    found = []
    for cell in campaign.cells:
        found.append(CellStatistics())
        found[-1].add(count_outcomes(run_batch(cell.case, campaign.starts, 1, 0, 60, law=resolve_law(cell.law))))
    return [one.summary() for one in found]


def test_the_journal_of_a_campaign_cut_anywhere_goes_on(tmp_path, expected):
    do(tmp_path)
    whole = (tmp_path / JOURNAL).read_bytes()
    header = whole.index(b"\n") + 1
    for end in (0, 1, 17, header // 2, header - 1, header, header + 1, header + 500, len(whole) // 2, len(whole) - 1):
        (tmp_path / JOURNAL).write_bytes(whole[:end])
        assert summaries(do(tmp_path)) == expected
        # Not only in memory: what stands there now is whole too.
        assert summaries(do(tmp_path, SMALL, lambda: Failing(AssertionError("nothing to do")))) == expected


def damaged_lines(lines):
    yield from (b"5\n", b"null\n", b"{}\n", b"\n", b"\x00\xff\n", lines[2][:50] + b"\n", b"[" * 9999 + b"\n")
    yield json.dumps(decode_line(lines[2])).encode() + b"\n"  # without a checksum
    yield lines[2].replace(b'"runs":7', b'"runs":6')
    yield encode_line({"cell": 0})


def test_a_line_that_is_damaged_in_the_middle_is_run_again(tmp_path, expected):
    do(tmp_path)
    path = tmp_path / JOURNAL
    lines = path.read_bytes().splitlines(keepends=True)
    for line in damaged_lines(lines):
        path.write_bytes(b"".join([*lines[:2], line, *lines[3:]]))
        journal = do(tmp_path)
        assert journal.damaged == 1
        assert summaries(journal) == expected
        assert path.read_bytes().splitlines(keepends=True)[-1] == lines[2]
    path.write_bytes(b"".join([*lines, lines[2]]))  # a chunk twice counts once
    assert summaries(do(tmp_path, SMALL, lambda: Failing(AssertionError("nothing to do")))) == expected


def assert_refused(folder, capsys, text):
    """In one line; nothing in the folder changes."""
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert cli.main(["campaign", *flags(SMALL, folder)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert text in error
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize(
    "content",
    [b"hello", bytes(range(256)), b'{"format":3,"iden\n', b'{"format":3,"x', encode_line({"format": 999}), b"\n"],
)
def test_what_is_no_journal_is_not_touched(content, tmp_path, capsys):
    (tmp_path / JOURNAL).write_bytes(content)
    assert_refused(tmp_path, capsys, "is not a journal of a campaign (format 3): choose another --out")


def test_another_campaigns_journal_is_not_touched(tmp_path, capsys):
    path = tmp_path / JOURNAL
    Journal(path, make_campaign(SMALL)).close()
    header = decode_line(path.read_bytes())
    for key, message in (
        ("identity", "belongs to another campaign"),
        ("sources", "another version of the code"),
    ):
        for changed in ({**header, key: "0" * 16}, {name: value for name, value in header.items() if name != key}):
            path.write_bytes(encode_line(changed))
            assert_refused(tmp_path, capsys, message)


def test_results_of_another_command_are_not_overwritten(tmp_path, capsys):
    (tmp_path / "results.json").write_text('{"experiment": "a"}')
    assert_refused(tmp_path, capsys, "results.json was not written by a campaign: choose another --out")


def test_two_at_a_time_count_each_chunk_once(tmp_path, expected):
    other = Journal(tmp_path / JOURNAL, make_campaign(SMALL))
    do(tmp_path)
    run_campaign(make_campaign(SMALL), other, two_threads, 2)
    other.close()
    assert summaries(other) == expected
    assert summaries(do(tmp_path, SMALL, lambda: Failing(AssertionError("nothing to do")))) == expected


def test_a_full_disk_is_one_line_and_costs_what_did_not_fit(tmp_path, expected):
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
    assert summaries(do(tmp_path)) == expected


def test_chunks_are_sized_by_their_steps(monkeypatch):
    monkeypatch.setattr(spec, "_STEPS_PER_CHUNK", 2_000_000)
    chunks = list(open_chunks(make_campaign({"runs": 10**7, "duration": 0.1}), set()))
    assert sum(chunk.number for chunk in chunks) == 10**7
    assert max(chunk.number for chunk in chunks) < 10**6  # rows of a chunk are all in memory
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
def test_workers_that_keep_dying_are_given_up(tmp_path, expected):
    pools = []

    def make_executor():
        pools.append(ProcessPoolExecutor(1, initializer=_die))
        return pools[-1]

    with pytest.raises(DiffbotError, match="the workers keep dying") as caught:
        do(tmp_path, SMALL, make_executor)
    assert "\n" not in str(caught.value)
    assert 2 <= len(pools) <= 5
    assert summaries(do(tmp_path)) == expected


class Failing(Executor):
    """Fails as the workers of a cluster may."""

    def __init__(self, error):
        self.error = error

    def submit(self, *_arguments, **_options):
        future = Future()
        future.set_exception(self.error)
        return future


def test_a_failing_worker_is_one_line(tmp_path):
    with pytest.raises(DiffbotError, match=r"a worker failed: RuntimeError lost worker; finished chunks are kept$"):
        do(tmp_path, SMALL, lambda: Failing(RuntimeError("lost\nworker")))


def test_an_unreachable_scheduler_is_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(module, "_CONNECT_TIMEOUT", 0.5)
    assert cli.main(["campaign", *flags(SMALL, tmp_path / "out"), "--scheduler", "tcp://127.0.0.1:1"]) == 1
    error = capsys.readouterr().err
    assert error.startswith("diffbot: no scheduler at tcp://127.0.0.1:1: ")
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_all_files_that_a_campaign_reads_name_the_version():
    read = files_read_by(
        "from diffbot_lab.campaign import report\nfrom diffbot_lab.campaign.spec import make_campaign\n"
        "make_campaign({'runs': 5, 'set': {'preset': 'precise'}})"
    )
    names = set(map(str, read))
    assert {"diffbot_control/filter/config.py", "diffbot_lab/cases.py", "diffbot_sim/plant.py"} < names
    assert {path.parts[0] for path in read} == {*PACKAGES, "diffbot_tools", "diffbot_lab"}


class Killer(Journal):
    """Kills one worker after the second chunk."""

    def __init__(self, path, campaign, worker):
        super().__init__(path, campaign)
        self._worker = worker
        self.killed = 0

    def add(self, cell, first, counts):
        super().add(cell, first, counts)
        if len(self.done) == 2:
            os.kill(self._worker, signal.SIGKILL)
            self.killed += 1


@pytest.mark.graph
def test_a_cluster_with_a_worker_killed_half_way_gives_the_same(tmp_path, expected, monkeypatch):
    monkeypatch.setattr(module, "_CONNECT_TIMEOUT", 60.0)
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        cluster_executor(cluster.scheduler_address) as (make_executor, workers),
    ):
        assert workers == 1
        campaign, (worker,) = make_campaign(SMALL), cluster.workers.values()
        journal = Killer(tmp_path / JOURNAL, campaign, worker.process.process.pid)
        run_campaign(campaign, journal, make_executor, 2)
        journal.close()
        assert journal.killed == 1
        assert summaries(journal) == expected
    # A client that stays behind asks for the cluster again and again, from a thread of its own.
    with pytest.raises(Exception, match="closed"):
        make_executor().submit(abs, -1).result(60.0)


def test_interrupted_and_gone_on_it_is_the_same_to_the_byte(tmp_path, capsys, monkeypatch, kept_signal_handlers):
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
    # With another number of workers: the lines of the journal stand in another order, all other files are the same.
    assert cli.main(["campaign", *flags(SMALL, two), "--workers", "1"]) == 0
    found, wanted = ({path.name: path.read_bytes() for path in folder.iterdir()} for folder in (one, two))
    assert len(found) == 6
    assert sorted(found.pop(JOURNAL).splitlines()) == sorted(wanted.pop(JOURNAL).splitlines())
    assert found == wanted
