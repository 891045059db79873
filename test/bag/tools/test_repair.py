"""Repair: every message of every undamaged chunk is saved, by the count of the mcap library and of rosbags."""

import functools
import io
import os
import random
import re
import shutil
import signal
import struct
import subprocess
import sys
from collections import Counter

import cut_bags
import damaged_bags
import pytest
from bag_makers import BEGIN, HASHES, MS, POINT, write_mcap
from damaged_bags import TOPICS
from mcap.opcode import Opcode
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from diffbot_bag.bag.file_lock import take_lock
from diffbot_bag.bag.reader import BagReader
from diffbot_bag.bag.writer import BagWriter
from diffbot_bag.mcap.chunks import BagLimits
from diffbot_bag.tools import check_result, output_file
from diffbot_bag.tools.repair import PASSES, repair_bag, repair_in_place, size_of
from diffbot_core.errors import DiffbotError


@pytest.fixture(scope="module", params=["zstd", "lz4", "none"])
def whole(request):
    return damaged_bags.original(damaged_bags.mcap_file(request.param, 900))


@pytest.fixture
def repair(tmp_path):
    """Repair the bytes of a file; return the result, and the messages that the mcap library finds in it."""

    def run(content, **limits):
        source = tmp_path / "broken.mcap"
        source.write_bytes(content)
        out = tmp_path / "fixed"
        shutil.rmtree(out, ignore_errors=True)
        result = repair_bag(source, out, **limits)
        return result, damaged_bags.messages_of((out / "fixed_0.mcap").read_bytes(), validate_crcs=True)

    return run


def without_topic(messages):
    counted = Counter()
    for message, count in messages.items():
        counted[message[1:]] += count
    return counted


def test_every_message_of_every_undamaged_chunk_is_saved(whole, repair, tmp_path):
    generator = random.Random(len(whole.content))
    for number in range(12):
        content, changed, cut = damaged_bags.damage(whole, generator)
        result, saved = repair(content)
        kept = damaged_bags.surviving(whole, changed, cut)
        if result.files[0].salvaged.loss.unknown or result.files[0].salvaged.loss.doubtful:
            assert without_topic(saved) >= without_topic(kept)
            assert without_topic(saved) <= without_topic(whole.messages)
            continue
        assert saved >= kept
        assert saved <= whole.messages
        if number % 4:
            continue
        with AnyReader([tmp_path / "fixed"]) as other:
            assert other.message_count == result.message_count == saved.total()
            assert sum(1 for _ in other.messages()) == saved.total()
            times = [message[1] for message in saved]
            assert not times or (other.start_time, other.end_time) == (min(times), max(times) + 1)


def test_a_complete_bag_stays_as_it_is(whole, repair, tmp_path):
    result, saved = repair(whole.content)
    assert saved == whole.messages
    loss = result.files[0].salvaged.loss
    assert (loss.bytes, loss.chunks, loss.messages, loss.spans, loss.is_cut) == (0, 0, {}, (), False)
    fixed = (tmp_path / "fixed" / "fixed_0.mcap").read_bytes()
    # Chunks are copied byte by byte.
    chunks = [whole.content[begin:end] for begin, end, _ in whole.chunks]
    assert [fixed[begin:end] for begin, end, _ in damaged_bags.original(fixed).chunks] == chunks
    reader = make_reader(io.BytesIO(fixed))
    (attachment,) = reader.iter_attachments()
    assert (attachment.name, attachment.create_time, attachment.data) == ("parameters.yaml", 5, b"gain: 1.0\n" * 50)
    assert [record.name for record in reader.iter_metadata()] == ["robot", "rosbag2"]
    # Readers find the messages of a range by the index.
    found = [message.log_time for *_, message in reader.iter_messages(["/b"], starting_at=BEGIN + 700 * MS)]
    assert found == [BEGIN + index * MS for index in range(700, 900) if index % 3 == 1]
    cut_bags.check_metadata(tmp_path / "fixed")
    with BagReader(tmp_path / "fixed") as bag:
        assert bag.warning == ""
        assert {(topic.type, topic.type_hash) for topic in bag.topics.values()} == {(POINT, HASHES[POINT])}
        assert [bag.topics[name].qos[0].is_latched for name in TOPICS] == [False, False, True]


def test_a_damaged_head_of_a_chunk_or_attachment_does_not_cost_its_messages(whole, repair):
    begin = whole.chunks[3][0]
    opcode, length, first_time, last_time = begin, begin + 2, begin + 12, begin + 20
    attachment = whole.content.index(b"gain: 1.0") + 3
    for place in (opcode, length, first_time, last_time, attachment):
        content = bytearray(whole.content)
        content[place] ^= 0x21
        result, saved = repair(bytes(content))
        assert saved == whole.messages
        assert not result.files[0].salvaged.loss.chunks
        assert (result.files[0].salvaged.loss.bytes > 500) is (place == attachment)


def test_the_messages_at_the_beginning_of_an_incomplete_chunk_are_saved(repair):
    whole = damaged_bags.original(damaged_bags.mcap_file("zstd", 8000, 400_000))
    _, end, last = whole.chunks[0]
    result, saved = repair(whole.content[: end - 2000])
    # zstd has blocks of 128 KiB: those before the cut can be unpacked.
    assert saved <= last
    assert saved.total() == result.files[0].salvaged.loss.unverified > 1500
    ((start, until),) = result.files[0].salvaged.loss.spans
    assert (start, until) == (max(time for _, time, *_ in saved), max(time for _, time, *_ in last))


@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_channels_whose_description_is_lost_keep_their_messages(repair, compression):
    whole = damaged_bags.original(damaged_bags.mcap_file(compression))
    unknown = {f"/unknown/channel_{number}" for number in (1, 2, 3)}
    # The library describes channels in the first chunk and in the index: the first is damaged, the other cut off.
    content = bytearray(whole.content[: whole.chunks[-1][1]])
    begin, end, messages = whole.chunks[0]
    content[end - 5] ^= 0x10
    result, saved = repair(bytes(content))
    loss = result.files[0].salvaged.loss
    assert without_topic(saved) == without_topic(whole.messages - messages)
    assert (set(loss.doubtful), set(loss.unknown)) == (
        (set(TOPICS), set()) if compression == "none" else (set(), unknown)
    )
    content[begin + 30 : end] = bytes(end - begin - 30)
    result, saved = repair(bytes(content))
    assert set(result.files[0].salvaged.loss.unknown) == unknown
    assert without_topic(saved) == without_topic(whole.messages - messages)


def test_messages_outside_of_chunks_are_saved_and_packed_without_a_damaged_qos(repair):
    content = damaged_bags.mcap_file(use_chunking=False)
    sent = damaged_bags.messages_of(content)
    broken = bytearray(content[: len(content) // 2])
    place = broken.index(b"\x05" + (22 + 28).to_bytes(8, "little"), len(broken) // 2)
    broken[place + 3] ^= 0x40
    broken[broken.index(b"- history")] = ord("{")
    result, saved = repair(bytes(broken))
    assert saved <= sent
    assert saved.total() > 700
    assert sent.total() // 2 - saved.total() < 10
    assert result.files[0].salvaged.loss.without_qos == ("/a",)
    with BagReader(result.path) as reader:
        assert [len(topic.qos) for topic in reader.topics.values()] == [0, 1, 1]
        assert len(list(reader.messages())) == saved.total()


def test_bags_of_several_files_and_their_data(tmp_path):
    folder = tmp_path / "run"
    writer = BagWriter(folder)
    writer.write(writer.add_topic("/a", POINT), b"\0\1\0\0" + bytes(24), BEGIN - 5, BEGIN)
    writer.close({"lost_messages": "7"})
    for number in (2, 10):
        (folder / f"run_{number}.mcap").write_bytes(damaged_bags.mcap_file(count=300 * number, seed=number)[:-50])
    steps = []
    result = repair_bag(folder, tmp_path / "fixed", progress=steps.append)
    assert 0.8 * PASSES * size_of(folder) < sum(steps) <= PASSES * size_of(folder)
    assert [(file.source.name, file.path.name, file.salvaged.message_count) for file in result.files] == [
        ("run_0.mcap", "fixed_0.mcap", 1),
        ("run_2.mcap", "fixed_1.mcap", 600),
        ("run_10.mcap", "fixed_2.mcap", 3000),
    ]
    assert (result.start, result.end) == (BEGIN - 5, BEGIN + 2999 * MS)
    with BagReader(tmp_path / "fixed") as reader, AnyReader([tmp_path / "fixed"]) as other:
        assert reader.metadata.custom_data == {"lost_messages": "7"}
        assert reader.message_count == other.message_count == 3601
        assert reader.topics["/a"].message_count == 1201
        assert (other.start_time, other.end_time) == (BEGIN - 5, BEGIN + 2999 * MS + 1)
        starts = [(one.start, one.message_count) for one in reader.metadata.file_information]
        assert starts == [(BEGIN - 5, 1), (BEGIN, 600), (BEGIN, 3000)]


def test_missing_files_and_a_damaged_metadata_yaml_are_reported(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "run_0.mcap").write_bytes(damaged_bags.mcap_file())
    assert repair_bag(folder, tmp_path / "one").note == "metadata.yaml is missing"
    stored = (tmp_path / "one" / "metadata.yaml").read_text().replace("one_0.mcap", "run_0.mcap")
    (folder / "metadata.yaml").write_text(stored.replace("- run_0.mcap", "- run_0.mcap\n  - run_1.mcap"))
    result = repair_bag(folder, tmp_path / "two")
    assert (result.missing, result.note, result.message_count) == (["run_1.mcap"], "", 1500)
    (folder / "metadata.yaml").write_text("a: {b\n")
    assert "is not a YAML file" in repair_bag(folder, tmp_path / "three").note


def test_in_place(tmp_path):
    folder, lone = tmp_path / "run", tmp_path / "lone.mcap"
    folder.mkdir()
    (folder / "ekf.yaml").write_text("kept")
    for path in (folder / "run_0.mcap", lone):
        path.write_bytes(damaged_bags.mcap_file()[:-80])
    lone.chmod(0o640)
    (tmp_path / "link").symlink_to(folder)
    repair_in_place(tmp_path / "link")
    repair_in_place(lone)
    assert sorted(path.name for path in folder.iterdir()) == ["ekf.yaml", "metadata.yaml", "run_0.mcap"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "lone.mcap", "run"]
    assert lone.stat().st_mode & 0o777 == 0o640
    for path in (folder, lone):
        with BagReader(path) as reader:
            assert (reader.message_count, reader.warning) == (1500, "")


def refused(tmp_path, source, out=None, **options):
    """The line with which a repair is refused; nothing is left of it."""
    before = sorted(tmp_path.rglob("*"))
    repair = repair_in_place if out is None else functools.partial(repair_bag, out=out)
    with pytest.raises(DiffbotError) as error:
        repair(source, **options)
    assert str(error.value).isprintable()
    assert sorted(tmp_path.rglob("*")) == before
    return str(error.value)


KILLED = """
import os, signal, sys
from pathlib import Path
from diffbot_bag.tools.repair import repair_in_place
repair_in_place(Path(sys.argv[1]), progress=lambda _: os.kill(os.getpid(), signal.SIGKILL))
"""


def test_what_a_killed_repair_left_is_deleted_by_the_next_one(tmp_path):
    source = tmp_path / "run.mcap"
    source.write_bytes(damaged_bags.mcap_file()[:-80])
    assert subprocess.run([sys.executable, "-c", KILLED, source], check=False).returncode == -signal.SIGKILL
    assert len(list(tmp_path.glob(".run.mcap.*.part"))) == 1
    kept = [".run.mcap.99999999.part", ".run.mcap.old.part", "run.mcap"]
    for name in kept[:2]:
        (tmp_path / name).mkdir()
    living = os.open(tmp_path / kept[0], os.O_RDONLY)
    assert take_lock(living)
    repair_in_place(source)
    assert sorted(path.name for path in tmp_path.iterdir()) == kept
    os.close(living)
    repair_in_place(source)
    assert sorted(path.name for path in tmp_path.iterdir()) == kept[1:]


@pytest.mark.parametrize("chunk_size", [100, 10**6])
def test_messages_with_an_impossible_log_time_are_left_out_and_counted(tmp_path, chunk_size):
    messages = [("/a", time, bytes(28)) for time in (1, 2, 2**62, 2**62 + 1, 2**63)]
    source = write_mcap(tmp_path / "run.mcap", messages, chunk_size=chunk_size)
    with pytest.raises(DiffbotError, match="log time 9223372036854775808 ns: must be <= "):
        BagReader(source)
    result = repair_bag(source, tmp_path / "fixed")
    assert (result.message_count, result.files[0].salvaged.loss.beyond, result.end) == (3, 2, 2**62)
    with BagReader(result.path) as reader:
        assert [message.log_time for message in reader.messages()] == [1, 2, 2**62]


def test_a_result_that_readers_do_not_agree_on_does_not_appear(tmp_path, monkeypatch):
    source = tmp_path / "broken.mcap"
    source.write_bytes(damaged_bags.mcap_file()[:-80])
    content = source.read_bytes()
    finish = output_file.OutputFile.finish

    def forget_a_chunk(self):
        self.end_chunk()
        del self._indexes[Opcode.CHUNK_INDEX][3]
        finish(self)

    monkeypatch.setattr(output_file.OutputFile, "finish", forget_a_chunk)
    for out in (tmp_path / "fixed", None):
        assert "the result" in refused(tmp_path, source, out)
    assert source.read_bytes() == content
    monkeypatch.undo()
    monkeypatch.setattr(check_result, "_by_mcap", lambda *_: Counter({"/a": 1}))
    assert "mcap reads 1 messages of 1 topics, written were 1500 of 3" in refused(tmp_path, source, tmp_path / "fixed")


def test_existing_same_and_wrong_names(tmp_path):
    source = tmp_path / "run.mcap"
    source.write_bytes(damaged_bags.mcap_file(count=30))
    (tmp_path / "taken").mkdir()
    os.mkfifo(tmp_path / "pipe.mcap")
    (tmp_path / "foreign.mcap").write_bytes(bytes(5000))
    for given, out, words in (
        (source, "taken", "exists already"),
        (source, "run.mcap", "must not end with .mcap"),
        (source, "run.mcap/below", "cannot write the bag"),
        (source, "x" * 300, "File name too long"),
        (tmp_path / "none", "fixed", "no such file"),
        (tmp_path / "taken", "fixed", "has no MCAP file"),
        (tmp_path / ("x" * 300), "fixed", "File name too long"),
        (tmp_path / "pipe.mcap", "fixed", "not a regular file"),
        (tmp_path / "foreign.mcap", "fixed", "is not an MCAP file"),
    ):
        assert words in refused(tmp_path, given, tmp_path / out)


def test_a_file_that_grows_or_a_full_disk_leaves_nothing(tmp_path, monkeypatch):
    source = tmp_path / "run.mcap"
    source.write_bytes(damaged_bags.mcap_file()[:-80])

    def grow(_):
        with source.open("ab") as stream:
            stream.write(b"more")

    def fill(_):
        raise OSError(27, "File too large")

    for out in (tmp_path / "fixed", None):
        assert "is it still being recorded?" in refused(tmp_path, source, out, progress=grow)
    monkeypatch.setattr(output_file.OutputFile, "finish", fill)
    for out in (tmp_path / "fixed", None):
        assert re.fullmatch(r"cannot write the bag .*: File too large", refused(tmp_path, source, out))


def test_a_bomb_and_endless_false_chunks_are_refused(tmp_path):
    messages = (("/a", index, bytes(20 * 2**20)) for index in range(4))
    source = write_mcap(tmp_path / "run.mcap", messages, chunk_size=15 * 2**20)
    source.write_bytes(source.read_bytes()[:-20])
    assert "max_compression_ratio" in refused(tmp_path, source, tmp_path / "fixed")
    result = repair_bag(source, tmp_path / "fixed", BagLimits(1e9, 2**20))
    assert (result.message_count, result.files[0].salvaged.loss.chunks) == (0, 4)
    # Heads of chunks that overlap: opcode, length, first and last time, size and checksum.
    size = 3 * 2**20
    head = struct.pack("<BQQQQI", 6, 0, 1, 2, size // 2, 1) + bytes(4) + (size // 2).to_bytes(8, "little")
    source.write_bytes(b"\x89MCAP0\r\n" + head * (size // len(head)))
    assert "too many false chunks" in refused(tmp_path, source, tmp_path / "more")
