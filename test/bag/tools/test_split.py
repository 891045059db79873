"""Split: all files together are the bag, each file is within its limit and can be used alone."""

import io

import cut_bags
import pytest
from cut_bags import BEGIN, STEP, Given, by_rosbags, check_metadata, facts, files_of
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from diffbot_bag.tools import cut, source_bag, split_bag
from diffbot_bag.tools.source_bag import SourceBag
from diffbot_bag.tools.split_bag import FileLimits
from diffbot_core.errors import DiffbotError


@pytest.fixture(scope="module", params=("lz4", "no chunks", "no message index", "rosbags"))
def bag(request, tmp_path_factory):
    return cut_bags.write_bag(tmp_path_factory.mktemp("bags") / "run", request.param)


@pytest.fixture(scope="module")
def zstd_bag(tmp_path_factory):
    return cut_bags.write_bag(tmp_path_factory.mktemp("bags") / "run", "zstd")


def split(path, out, **limits):
    done = []
    with SourceBag(path) as one:
        new = cut.split(one, FileLimits(**limits))
        new.write(out, done.append)
    assert sum(done) == new.size
    found = check_metadata(out)
    assert sorted(by_rosbags(out)) == sorted((one.topic, one.log_time, one.data) for one in found)
    return [facts(file) for file in files_of(out)]


def without_heads(files, given):
    """The messages of the files without those at their heads, which are checked against ``given``."""
    rest = []
    for number, file in enumerate(files):
        latest = [one for one in rest if one.topic == "/map"][-1:] if number else []
        assert [one._replace(log_time=0) for one in file[: len(latest)]] == [one._replace(log_time=0) for one in latest]
        rest += file[len(latest) :]
        if latest:
            assert file[0].log_time <= file[1].log_time
    assert rest == given
    return [len(file) - (1 if any(one in given for one in file) and file[0] not in given else 0) for file in files]


@pytest.mark.parametrize("count", [150, 77])
def test_by_count(bag, tmp_path, count):
    files = split(bag, tmp_path / "parts", messages=count)
    assert without_heads(files, facts(bag)) == [count] * (402 // count) + ([402 % count] if 402 % count else [])


@pytest.mark.parametrize("steps", [60, 33])
def test_by_duration(bag, tmp_path, steps):
    """The files begin at multiples of the duration after the first message."""
    files = split(bag, tmp_path / "parts", duration=steps * STEP)
    given = facts(bag)
    without_heads(files, given)
    for number, file in enumerate(files):
        begin = BEGIN + number * steps * STEP
        assert all(begin <= one.log_time < begin + steps * STEP for one in file)
        inside = [one for one in given if begin <= one.log_time < begin + steps * STEP]
        assert file[-len(inside) :] == inside


@pytest.mark.parametrize("size", [10**9, 12_345])
def test_by_size(tmp_path, size):
    path = cut_bags.write_mcap(tmp_path / "run.mcap", cut_bags.drive(), extras=("notes",))
    files = split(path, tmp_path / "parts", size=size)
    without_heads(files, facts(path))
    sizes = [file.stat().st_size for file in files_of(tmp_path / "parts")]
    assert max(sizes) <= size
    assert len(sizes) == 1 or min(sizes[:-1]) > size / 2
    # Each file can be used alone.
    for file in files_of(tmp_path / "parts"):
        reader = make_reader(io.BytesIO(file.read_bytes()))
        assert [(one.name, one.data) for one in reader.iter_attachments()] == [("notes", b"content of notes")]
        assert next(reader.iter_metadata()).metadata == {"key": "value"}


def test_a_message_larger_than_the_size_has_a_file_of_its_own(tmp_path):
    messages = [Given("/text", BEGIN + number, bytes(20_000)) for number in range(3)]
    path = cut_bags.write_mcap(tmp_path / "a.mcap", messages, chunk_size=200_000, compression="none")
    assert [len(file) for file in split(path, tmp_path / "parts", size=20_000)] == [1, 1, 1]


def test_only_chunks_that_are_divided_are_unpacked(zstd_bag, tmp_path, monkeypatch):
    unpacked = []
    real = source_bag.verified_chunk
    monkeypatch.setattr(source_bag, "verified_chunk", lambda *given: unpacked.append(given[1]) or real(*given))
    files = split(zstd_bag, tmp_path / "parts", duration=60 * STEP)
    assert len(files) == 4
    borders = [BEGIN + number * 60 * STEP for number in (1, 2, 3)]
    with files_of(zstd_bag)[0].open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    divided = {
        one.chunk_start_offset
        for one in chunks
        if any(one.message_start_time < at <= one.message_end_time for at in borders)
    }
    found = {one.chunk_start_offset for one in unpacked}
    assert 0 < len(divided) < len(chunks) / 2
    assert found >= divided
    # Of the others, at most the one with the latched message before the first border.
    assert len(unpacked) <= len(divided) + 1


def test_too_many_files_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(split_bag, "MAX_FILES", 20)
    path = cut_bags.write_mcap(tmp_path / "a.mcap", [Given("/point", BEGIN + n, b"") for n in range(22)])
    with SourceBag(path) as one, pytest.raises(DiffbotError, match="more than 20 files"):
        cut.split(one, FileLimits(messages=1)).write(tmp_path / "parts", lambda count: None)
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap"]


ROWS = st.lists(st.tuples(st.sampled_from(["/point", "/map"]), st.integers(0, 100)), min_size=1, max_size=50)


@settings(max_examples=15)
# Chunks of equal times that stand in the file in the other order than by their first message.
@example([("/point", 1), ("/point", 0), ("/point", 1)], 0, 0, 0, 60)
@example([("/point", 1), ("/point", 0), ("/map", 1)], 0, 7, 0, 120)
@given(ROWS, st.integers(0, 12), st.sampled_from([0, 7, 30]), st.sampled_from([0, 4000, 5000]), st.integers(60, 600))
def test_messages_in_any_order_and_limits_together(tmp_path_factory, rows, messages, duration, size, chunk_size):
    folder = tmp_path_factory.mktemp("any")
    given = [Given(topic, 100 + time, b"", number, 7) for number, (topic, time) in enumerate(rows)]
    path = cut_bags.write_mcap(folder / "a.mcap", given, chunk_size=chunk_size)
    files = split(path, folder / "parts", messages=messages or 13, duration=duration, size=size)
    rest = []
    for file in files:
        heads = sum(one.topic == "/map" for one in rest) > 0
        if heads:
            (latest,) = [one for one in rest if one.topic == "/map"][-1:]
            assert latest._replace(log_time=0) in [one._replace(log_time=0) for one in file]
            file.remove(next(one for one in file if one.sequence == latest.sequence))
        assert 0 < len(file) <= (messages or 13)
        rest += file
    assert rest == facts(path)


def test_a_gap_makes_no_empty_files_and_the_parts_can_be_split(tmp_path):
    messages = [Given("/point", BEGIN + time, b"1234") for time in (0, 5, 1005, 1009, 10**12)]
    path = cut_bags.write_mcap(tmp_path / "a.mcap", messages)
    files = split(path, tmp_path / "parts", duration=10)
    assert [[one.log_time - BEGIN for one in file] for file in files] == [[0, 5], [1005, 1009], [10**12]]
    assert [len(file) for file in split(tmp_path / "parts", tmp_path / "more", messages=4)] == [4, 1]
