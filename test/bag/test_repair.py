"""Repair: every message of every intact chunk is saved, as the mcap library reads it."""

import shutil

import pytest
from bag_makers import BEGIN, MS, POINT, chunks_of, facts, mcap_writing, point, write_mcap

from diffbot_bag.bag import BagReader
from diffbot_bag.repair import repair_bag
from diffbot_bag.writer import BagWriter
from diffbot_core.errors import DiffbotError

COUNT = 900
NOISE = bytes(range(256)) * 4


def write(path, **options):
    """Write two topics and an attachment; return the bytes and the chunks."""
    options = {"chunk_size": 20_000, **options}
    kinds = dict.fromkeys(("/a", "/b"), POINT)
    with path.open("wb") as stream, mcap_writing(stream, kinds, {"/a": "", "/b": ""}, **options) as (writer, channels):
        writer.add_attachment(5, 6, "parameters.json", "application/json", b'{"/ekf": {"gain": 1.0}}')
        for index in range(COUNT):
            # Part of it does not compress.
            data = point(index) + NOISE[index % 256 :][:200]
            writer.add_message(channels[f"/{'ab'[index % 2]}"], BEGIN + index * MS, data, BEGIN, index)
    return bytearray(path.read_bytes()), chunks_of(path)


def damage(content, chunks, kind):
    """Return damaged bytes, and the numbers of the messages that are in damaged chunks."""
    chunk, last_chunk = chunks[len(chunks) // 2], chunks[-1]
    begin, end = chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length
    first, last = ((time - BEGIN) // MS for time in (chunk.message_start_time, chunk.message_end_time))
    everything_before_the_index = last_chunk.chunk_start_offset + last_chunk.chunk_length
    lost = set()
    if kind == "killed":
        del content[everything_before_the_index:]
    elif kind == "a bit of the data":
        content[(begin + end) // 2] ^= 4
        lost = set(range(first, last + 1))
    elif kind == "a bit of the length":
        content[begin + 3] ^= 4
    elif kind == "head of zeros":
        content[begin : begin + 60] = bytes(60)
        lost = set(range(first, last + 1))
    elif kind == "tail of zeros":
        content[everything_before_the_index:] = bytes(10_000)
    elif kind == "cut in a chunk":
        del content[(begin + end) // 2 :]
        lost = set(range(first, COUNT))
    return content, lost


DAMAGES = {
    "killed": (0, True),
    "a bit of the data": (1, False),
    "a bit of the length": (0, False),
    "head of zeros": (1, False),
    "tail of zeros": (1, True),
    "cut in a chunk": (1, True),
}
"""Number of damaged places, and True if the file does not have an index."""


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_only_messages_of_the_damaged_chunk_are_lost(compression, tmp_path):
    source = tmp_path / "run.mcap"
    whole, chunks = write(source, compression=compression)
    for kind, (places, is_without_index) in DAMAGES.items():
        content, lost = damage(bytearray(whole), chunks, kind)
        source.write_bytes(content)
        repaired = repair_bag(source, tmp_path / "fixed")
        found = [one.sequence for one in facts(tmp_path / "fixed")]
        # Without compression, the messages of a chunk are found without its head or its end.
        if compression == "none" and kind in ("head of zeros", "cut in a chunk"):
            assert len(set(found) & lost) > 30, kind
            lost -= set(found)
        assert found == [number for number in range(COUNT) if number not in lost], kind
        # Without compression, the chunk and the message in which the file ends are two damaged places.
        is_cut_in_a_message = (kind, compression) == ("cut in a chunk", "none")
        assert len(repaired.damages) == places + is_cut_in_a_message, kind
        assert repaired.lost.total() == (0 if is_without_index else len(lost)), kind
        assert bool(repaired.without_index) == is_without_index, kind
        with BagReader(tmp_path / "fixed") as bag:
            assert (bag.warning, bag.message_count) == ("", len(found)), kind
            assert bag.node_parameters() == {"/ekf": {"gain": 1.0}}, kind
        shutil.rmtree(tmp_path / "fixed")


def test_messages_outside_chunks_are_found_after_a_damaged_place(tmp_path):
    source = tmp_path / "run.mcap"
    content, _ = write(source, use_chunking=False)
    half = len(content) // 2
    content[half : half + 500] = bytes(500)
    source.write_bytes(content[:-2000])
    repair_bag(source, tmp_path / "fixed")
    assert len(facts(tmp_path / "fixed")) >= COUNT - 15


def test_a_message_with_an_invalid_publish_time_is_saved(tmp_path):
    rows = [("/a", BEGIN + index, point(index), BEGIN if index else 2**64 - 1, index) for index in range(5)]
    repaired = repair_bag(write_mcap(tmp_path / "run.mcap", rows), tmp_path / "fixed")
    assert [one.data for one in facts(tmp_path / "fixed")] == [point(index) for index in range(5)]
    assert not repaired.lost


def damaged_own_bag(folder, count=200):
    """Write a bag of two files as the recorder does; damage the first chunk of each and cut off the index."""
    writer = BagWriter(folder, chunk_size=2000)
    channels = [writer.add_topic(f"/{name}", POINT) for name in "ba"]
    for index in range(count):
        writer.write(channels[index % 2], point(index), BEGIN + index * MS, BEGIN, index)
        if index == count // 2:
            writer.split()
    writer.custom_data = {"lost_messages": "7", "site": "hall"}
    writer.close()
    for path in folder.glob("*.mcap"):
        chunks = chunks_of(path)
        content = bytearray(path.read_bytes()[: chunks[-1].chunk_start_offset + chunks[-1].chunk_length])
        content[chunks[0].chunk_start_offset + chunks[0].chunk_length // 2] ^= 4
        path.write_bytes(content)


def test_lost_names_of_topics_are_taken_from_metadata_yaml(tmp_path):
    damaged_own_bag(tmp_path / "run")
    repaired = repair_bag(tmp_path / "run", tmp_path / "fixed")
    with BagReader(tmp_path / "fixed") as bag:
        names = {message.topic for message in bag.messages()}
        assert all(one.topic == f"/{'ba'[one.sequence % 2]}" for one in bag.messages())
        assert bag.custom_data == {"site": "hall"}, "the recorder has not counted the damage"
        assert {topic.type for topic in bag.topics.values()} == {POINT}
    assert (names, repaired.unknown) == ({"/a", "/b"}, [])
    (tmp_path / "run" / "metadata.yaml").unlink()
    (tmp_path / "run" / "run_1.mcap").unlink()
    repaired = repair_bag(tmp_path / "run", tmp_path / "unnamed")
    assert sorted(repaired.unknown) == ["/unknown/channel_1", "/unknown/channel_2"]


def test_files_that_metadata_yaml_names_and_that_are_missing_are_listed(tmp_path):
    damaged_own_bag(tmp_path / "run")
    text = (tmp_path / "run" / "metadata.yaml").read_text()
    (tmp_path / "run" / "metadata.yaml").write_text(text.replace("run_1.mcap", "a" * 300))
    (tmp_path / "run" / "run_1.mcap").unlink()
    assert repair_bag(tmp_path / "run", tmp_path / "fixed").missing == ["a" * 300]


def test_growing_missing_and_foreign_files_are_refused(tmp_path):
    source = tmp_path / "run.mcap"
    write(source)

    def grow(_):
        with source.open("ab") as stream:
            stream.write(b"more")

    for path, words, options in (
        (source, "is it still being recorded", {"progress": grow}),
        (tmp_path / "missing.mcap", "No such file", {}),
        (tmp_path, "already exists", {"target": tmp_path}),
    ):
        with pytest.raises(DiffbotError, match=words):
            repair_bag(path, **{"target": tmp_path / "fixed", **options})
    (tmp_path / "text.mcap").write_text("no bag at all")
    with pytest.raises(DiffbotError, match="is not an MCAP file"):
        repair_bag(tmp_path / "text.mcap", tmp_path / "fixed")
    assert sorted(one.name for one in tmp_path.iterdir()) == ["run.mcap", "text.mcap"]
