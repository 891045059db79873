"""Split: all files together are the bag, each file is within its limit and can be used alone."""

import io

import cut_bags
import pytest
from cut_bags import BEGIN, Given, facts, files_of, write_new
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from diffbot_bag.tools import cut, split_bag
from diffbot_bag.tools.source_bag import SourceBag
from diffbot_bag.tools.split_bag import FileLimits
from diffbot_core.errors import DiffbotError


def split(path, out, **limits):
    with SourceBag(path) as one:
        write_new(cut.split(one, FileLimits(**limits)), out)
    return [facts(file) for file in files_of(out)]


def check_parts(files, given, messages):
    """All files together are the bag, but for the latest latched message at the head of each."""
    rest = []
    for file in files:
        latest = [one for one in rest if one.topic == "/map"][-1:]
        heads = [one for one in file if latest and one.sequence == latest[0].sequence and one.topic == "/map"]
        assert [one._replace(log_time=0) for one in heads[:1]] == [one._replace(log_time=0) for one in latest]
        own = [one for one in file if one not in heads[:1]]
        assert 0 < len(own) <= messages
        rest += own
    assert rest == given


@pytest.mark.parametrize("size", [10**9, 12_345])
def test_by_size_each_file_can_be_used_alone(tmp_path, size):
    path = cut_bags.write_file(tmp_path / "run.mcap", cut_bags.drive(), attached=("notes",))
    check_parts(split(path, tmp_path / "parts", size=size), facts(path), 402)
    parts = [file.read_bytes() for file in files_of(tmp_path / "parts")]
    assert max(map(len, parts)) <= size
    assert len(parts) == 1 or min(map(len, parts[:-1])) > size / 2
    for part in parts:
        reader = make_reader(io.BytesIO(part))
        assert [(one.name, one.data) for one in reader.iter_attachments()] == [("notes", b"content of notes")]
        assert next(reader.iter_metadata()).metadata == {"key": "value"}


ROWS = st.lists(st.tuples(st.sampled_from(["/point", "/map"]), st.integers(0, 100)), min_size=1, max_size=50)


@settings(max_examples=8)
# Chunks of equal times that stand in the file in the other order than by their first message.
@example([("/point", 1), ("/point", 0), ("/point", 1)], 13, 0, 0, 60)
@example([("/point", 1), ("/point", 0), ("/map", 1)], 13, 7, 0, 120)
@given(ROWS, st.integers(1, 13), st.sampled_from([0, 7, 30]), st.sampled_from([0, 4000, 5000]), st.integers(60, 600))
def test_messages_in_any_order_and_limits_together(tmp_path_factory, rows, messages, duration, size, chunk_size):
    folder = tmp_path_factory.mktemp("any")
    given = [Given(topic, 100 + time, b"", 7, number) for number, (topic, time) in enumerate(rows)]
    path = cut_bags.write_file(folder / "a.mcap", given, chunk_size=chunk_size)
    check_parts(split(path, folder / "parts", messages=messages, duration=duration, size=size), facts(path), messages)


def test_a_message_larger_than_the_size_has_a_file_of_its_own(tmp_path):
    messages = [Given("/text", BEGIN + number, bytes(20_000)) for number in range(3)]
    path = cut_bags.write_file(tmp_path / "a.mcap", messages, chunk_size=200_000, compression="none")
    assert [len(file) for file in split(path, tmp_path / "parts", size=20_000)] == [1, 1, 1]


def test_too_many_files_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(split_bag, "MAX_FILES", 20)
    path = cut_bags.write_file(tmp_path / "a.mcap", [Given("/point", BEGIN + n, b"") for n in range(22)])
    with SourceBag(path) as one, pytest.raises(DiffbotError, match="more than 20 files"):
        cut.split(one, FileLimits(messages=1)).write(tmp_path / "parts", lambda count: None)
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap"]
