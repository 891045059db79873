"""Repair: every message of every undamaged chunk is saved, by the count of the mcap library and of rosbags."""

import functools
import io
import random
import shutil
import signal
import subprocess
import sys
from collections import Counter

import cut_bags
import damaged_bags
import pytest
from bag_makers import BEGIN, HASHES, MS, POINT
from damaged_bags import TOPICS
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from diffbot_bag.bag.reader import BagReader
from diffbot_bag.bag.writer import BagWriter
from diffbot_bag.tools import output_file
from diffbot_bag.tools.repair import repair_bag, repair_in_place
from diffbot_core.errors import DiffbotError


@pytest.fixture(scope="module", params=["zstd", "none"])
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


def test_every_message_of_every_undamaged_chunk_is_saved(whole, repair):
    generator = random.Random(len(whole.content))
    for _ in range(8):
        content, changed, cut = damaged_bags.damage(whole, generator)
        result, saved = repair(content)
        kept = damaged_bags.surviving(whole, changed, cut)
        if result.files[0].salvaged.loss.unknown or result.files[0].salvaged.loss.doubtful:
            assert without_topic(saved) >= without_topic(kept)
            assert without_topic(saved) <= without_topic(whole.messages)
            continue
        assert saved >= kept
        assert saved <= whole.messages


def test_a_complete_bag_stays_as_it_is(whole, repair, tmp_path):
    result, saved = repair(whole.content)
    assert saved == whole.messages
    loss = result.files[0].salvaged.loss
    assert (loss.bytes, loss.chunks, loss.messages, loss.spans, loss.is_cut) == (0, 0, {}, (), False)
    fixed = (tmp_path / "fixed" / "fixed_0.mcap").read_bytes()
    reader = make_reader(io.BytesIO(fixed))
    (attachment,) = reader.iter_attachments()
    assert (attachment.name, attachment.create_time, attachment.data) == ("parameters.yaml", 5, b"gain: 1.0\n" * 50)
    assert [record.name for record in reader.iter_metadata()] == ["robot", "rosbag2"]
    cut_bags.check_metadata(tmp_path / "fixed")
    with BagReader(tmp_path / "fixed") as bag:
        assert bag.warning == ""
        assert {(topic.type, topic.type_hash) for topic in bag.topics.values()} == {(POINT, HASHES[POINT])}
        assert [bag.topics[name].qos[0].is_latched for name in TOPICS] == [False, False, True]


def test_channels_whose_description_is_lost_keep_their_messages(repair):
    whole = damaged_bags.original(damaged_bags.mcap_file())
    # The library describes channels in the first chunk and in the index: the first is damaged, the other cut off.
    content = bytearray(whole.content[: whole.chunks[-1][1]])
    _, end, messages = whole.chunks[0]
    content[end - 5] ^= 0x10
    result, saved = repair(bytes(content))
    assert set(result.files[0].salvaged.loss.unknown) == {f"/unknown/channel_{number}" for number in (1, 2, 3)}
    assert without_topic(saved) == without_topic(whole.messages - messages)


def test_bags_of_several_files_and_their_data(tmp_path):
    folder = tmp_path / "run"
    writer = BagWriter(folder)
    writer.write(writer.add_topic("/a", POINT), b"\0\1\0\0" + bytes(24), BEGIN - 5, BEGIN)
    writer.close({"lost_messages": "7"})
    for number in (2, 10):
        (folder / f"run_{number}.mcap").write_bytes(damaged_bags.mcap_file(count=300 * number, seed=number)[:-50])
    result = repair_bag(folder, tmp_path / "fixed")
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
    repair_in_place(source)
    assert list(tmp_path.iterdir()) == [source]


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
    assert refused(tmp_path, source).endswith(": File too large")
