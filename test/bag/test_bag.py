"""Writing and reading bags, against rosbags and the mcap library."""

import io
import os
import time
from collections import Counter
from pathlib import Path
from random import Random

import pytest
import yaml
from bag_makers import (
    BEGIN,
    COMPRESSIONS,
    POINT,
    STORE,
    STRING,
    chunks_of,
    facts,
    files_of,
    mcap_writing,
    point,
    string,
    write_folder,
    write_mcap,
)
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from view_bags import command

from diffbot_bag import metadata
from diffbot_bag.bag import PARAMETERS, BagReader, MergedBags
from diffbot_bag.bag_files import BagFiles, FileLimits, LatchedRows, add_messages
from diffbot_bag.definitions import type_hash
from diffbot_bag.qos import Qos
from diffbot_bag.writer import BagWriteError, BagWriter, new_bag
from diffbot_core.errors import DiffbotError

LATCHED = Qos(durability="transient_local")
STEP = 10_000_000
"""[ns]"""


def write_bag(folder, count=300, **options):
    """Write a latched text, /a at every step and /b half a step later; each /b is written before its /a."""
    writer = BagWriter(folder, chunk_size=2000, **options)
    a, b = (writer.add_topic(name, POINT, [Qos(), Qos(reliability="best_effort")]) for name in ("/a", "/b"))
    writer.write(writer.add_topic("/text", STRING, [LATCHED]), string("robot"), BEGIN, BEGIN - 5, 9)
    for index in range(count):
        time = BEGIN + index * STEP
        writer.write(b, point(-index), time + STEP // 2, time, index)
        writer.write(a, point(index), time, time - 1, index)
    writer.custom_data = {"lost_messages": "3"}
    writer.close()
    return folder


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bags") / "run")


def error_of(path):
    """Return the error that opening or reading a bag raises."""
    with pytest.raises(DiffbotError) as error, BagReader(path) as reader:
        list(reader.messages())
    assert str(error.value).isprintable()
    return str(error.value)


def texts(path, topic="/data"):
    return [STORE.deserialize_cdr(one.data, one.type).data for one in facts(path) if one.topic == topic]


def check_metadata(folder):
    """Compare metadata.yaml and the statistics of each file with the messages; return the messages."""
    content = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert content["relative_file_paths"] == [file.name for file in files_of(folder)]
    assert [entry["path"] for entry in content["files"]] == content["relative_file_paths"]
    of_file = {file.name: facts(file) for file in files_of(folder)}
    everything = [one for found in of_file.values() for one in found]
    for entry in [*content["files"], {**content, "path": None}]:
        found = of_file[entry["path"]] if entry["path"] else everything
        times = [one.log_time for one in found]
        assert entry["message_count"] == len(found)
        assert entry["starting_time"]["nanoseconds_since_epoch"] == min(times, default=0)
        assert entry["duration"]["nanoseconds"] == (max(times) - min(times) if times else 0)
    counts = {one["topic_metadata"]["name"]: one["message_count"] for one in content["topics_with_message_count"]}
    assert Counter(counts) == Counter(one.topic for one in everything)
    for file in files_of(folder):
        with file.open("rb") as stream:
            summary = make_reader(stream).get_summary()
        counts = summary.statistics.channel_message_counts.items()
        found = {summary.channels[number].topic: count for number, count in counts if count}
        assert found == Counter(one.topic for one in of_file[file.name])
    return everything


def test_rosbags_reads_the_messages_hashes_and_qos_of_a_written_bag(bag):
    with AnyReader([bag]) as reader:
        assert reader.message_count == 601
        by_topic = {connection.topic: connection for connection in reader.connections}
        # rosbags has compared this with the hash that it computes itself.
        assert by_topic["/a"].digest == type_hash(POINT)
        assert by_topic["/text"].ext.offered_qos_profiles[0].durability == QosDurability.TRANSIENT_LOCAL
        assert len(by_topic["/a"].ext.offered_qos_profiles) == 2
        found = [(time, reader.deserialize(data, POINT).x) for _, time, data in reader.messages([by_topic["/a"]])]
        assert found == [(BEGIN + index * STEP, float(index)) for index in range(300)]


def test_metadata_yaml_has_all_fields_of_rosbag2(bag):
    none = {"sec": 9223372036, "nsec": 854775807}
    profile = {
        "history": "unknown", "depth": 0, "reliability": "reliable", "durability": "transient_local",
        "deadline": none, "lifespan": none, "liveliness": "automatic", "liveliness_lease_duration": none,
        "avoid_ros_namespace_conventions": False,
    }  # fmt: skip
    content = yaml.safe_load((bag / "metadata.yaml").read_text())
    topics = content["rosbag2_bagfile_information"].pop("topics_with_message_count")
    duration = {"nanoseconds": 299 * STEP + STEP // 2}
    times = {"starting_time": {"nanoseconds_since_epoch": BEGIN}, "duration": duration}
    assert content == {
        "rosbag2_bagfile_information": {
            "version": 9, "storage_identifier": "mcap", **times, "message_count": 601,
            "compression_format": "", "compression_mode": "", "relative_file_paths": ["run_0.mcap"],
            "files": [{"path": "run_0.mcap", **times, "message_count": 601}],
            "custom_data": {"lost_messages": "3"}, "ros_distro": "jazzy",
        }
    }  # fmt: skip
    assert [topic["message_count"] for topic in topics] == [300, 300, 1]
    assert topics[2]["topic_metadata"] == {
        "name": "/text", "type": STRING, "serialization_format": "cdr", "offered_qos_profiles": [profile],
        "type_description_hash": type_hash(STRING),
    }  # fmt: skip
    with (bag / "run_0.mcap").open("rb") as stream:
        (record,) = make_reader(stream, validate_crcs=True).iter_metadata()
    assert yaml.safe_load(record.metadata["serialized_metadata"])["message_count"] == 601


def test_messages_are_read_in_the_order_of_log_time(bag):
    with BagReader(bag) as reader, BagReader(bag / "run_0.mcap") as file:
        assert (reader.start, reader.end) == (BEGIN, BEGIN + 299 * STEP + STEP // 2)
        assert (reader.message_count, reader.warning) == (601, "")
        assert {name: (one.type, one.message_count, len(one.qos)) for name, one in reader.topics.items()} == {
            "/a": (POINT, 300, 2), "/b": (POINT, 300, 2), "/text": (STRING, 1, 1),
        }  # fmt: skip
        messages = list(reader.messages(["/a", "/b"]))
        assert list(reader.messages(["/a", "/b"], reverse=True)) == messages[::-1]
        assert list(file.messages(["/a", "/b"])) == messages
        assert [one.content.x for one in reader.decoded(["/a"])] == list(range(300))
    assert [message.log_time for message in messages] == [BEGIN + half * STEP // 2 for half in range(600)]
    assert [message.data for message in messages[::2]] == [point(index) for index in range(300)]
    assert [message.topic for message in messages[:3]] == ["/a", "/b", "/a"]
    assert (messages[8].publish_time, messages[8].sequence) == (BEGIN + 4 * STEP - 1, 4)


def test_messages_are_selected_by_topic_and_time(bag):
    with BagReader(bag) as reader:
        times = [message.log_time for message in reader.messages(["/a"], BEGIN + 7 * STEP, BEGIN + 10 * STEP)]
        assert times == [BEGIN + index * STEP for index in (7, 8, 9, 10)]
        assert len(list(reader.messages(("/b", "/none"), end=BEGIN + 2 * STEP))) == 2
        assert not list(reader.messages(start=reader.end + 1))
        assert not list(reader.messages(start=BEGIN + 1, end=BEGIN))
        assert not list(reader.messages([]))
        assert [message.topic for message in reader.messages("/a", end=BEGIN + STEP)] == ["/a", "/a"]
        found = reader.latched_before(BEGIN + 10 * STEP, ["/b", "/a", "/text", "/none"])
        assert [(message.topic, message.log_time - BEGIN) for message in found] == [
            ("/text", 0), ("/a", 9 * STEP), ("/b", 9 * STEP + STEP // 2),
        ]  # fmt: skip
        assert reader.latched_before(BEGIN, ["/a"]) == reader.latched_before(BEGIN + STEP, []) == []


@pytest.mark.parametrize(
    "options", [*({"compression": name} for name in COMPRESSIONS), {"use_chunking": False}, {"use_statistics": False}]
)
@pytest.mark.parametrize("cut", [None, 0.6])
def test_files_of_the_mcap_library_are_read_in_order_up_to_their_last_whole_record(tmp_path, options, cut):
    rows = [("/a", BEGIN + (37 * index) % 101, point(index), index, index) for index in range(101)]
    path = write_mcap(tmp_path / "plain.mcap", rows, chunk_size=500, **options)
    if cut:
        path.write_bytes(path.read_bytes()[: int(path.stat().st_size * cut)])
    with BagReader(path) as reader:
        found = [(one.topic, one.log_time, one.data, one.publish_time, one.sequence) for one in reader.messages()]
        assert found == sorted(rows[: len(found)], key=lambda row: row[1])
        assert list(reader.messages(reverse=True)) == list(reader.messages())[::-1]
        assert len(found) == reader.message_count == reader.topics["/a"].message_count
        assert (len(found) == 101) if cut is None else (0 < len(found) < 101)
        assert ("no index" in reader.warning) is (cut is not None)


@pytest.mark.parametrize("share", [0.0001, 0.5, 0.9999])
def test_an_unfinished_file_is_read_up_to_its_last_whole_chunk(bag, tmp_path, share):
    content, path = (bag / "run_0.mcap").read_bytes(), tmp_path / "broken.mcap"
    size = max(9, int(len(content) * share))
    path.write_bytes(content[:size])
    chunks = chunks_of(bag / "run_0.mcap")
    last = max((one.message_end_time for one in chunks if one.chunk_start_offset + one.chunk_length <= size), default=0)
    with BagReader(bag) as reader, BagReader(path) as unfinished:
        assert list(unfinished.messages()) == list(reader.messages(end=last))
        assert unfinished.end == last
        assert "broken.mcap is unfinished: broken.mcap has no index" in unfinished.warning


def test_a_flipped_byte_is_an_error_or_does_not_change_the_messages(bag, tmp_path):
    content, path, lines = (bag / "run_0.mcap").read_bytes(), tmp_path / "broken.mcap", []
    with BagReader(bag) as reader:
        whole = list(reader.messages())
    for position in range(20, len(content) - 3000, len(content) // 40):
        flipped = bytearray(content)
        flipped[position] ^= 0x55
        path.write_bytes(flipped)
        try:
            with BagReader(path) as reader:
                # Message indexes are not used, nor texts of the header.
                assert list(reader.messages()) == whole
        except DiffbotError as error:
            lines.append(str(error))
    assert len(lines) > 10
    assert all("is damaged (" in line and line.isprintable() for line in lines)


def test_invalid_bags_are_refused_with_the_reason(tmp_path):
    assert "no such file or folder" in error_of(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    assert "neither metadata.yaml nor an MCAP file" in error_of(tmp_path / "empty")
    (tmp_path / "foreign.mcap").write_bytes(b"#ROSBAG V2.0\n")
    assert "is not an MCAP file" in error_of(tmp_path / "foreign.mcap")
    (tmp_path / "nothing.mcap").touch()
    assert "is an empty file" in error_of(tmp_path / "nothing.mcap")
    path = write_folder(tmp_path / "run", [("/a", 5, 0, command(0.0, 0.0))]) / "metadata.yaml"
    content = yaml.safe_load(path.read_text())["rosbag2_bagfile_information"]
    for changes, words in (
        ({"files": "now"}, "is incomplete"),
        ({"compression_mode": "FILE"}, "compression_mode = 'FILE': must be empty"),
        ({"storage_identifier": "sqlite3"}, "storage_identifier = 'sqlite3': must be mcap"),
        ({"relative_file_paths": ["\x1b[31m\n"]}, "cannot open"),
        ({"relative_file_paths": ["../nothing.mcap"]}, "is outside"),
        ({"relative_file_paths": [str(tmp_path / "run" / "run_0.mcap")]}, "is outside"),
    ):
        path.write_text(yaml.safe_dump({"rosbag2_bagfile_information": content | changes}))
        assert words in error_of(path.parent)


def test_a_topic_with_two_types_or_encodings_is_refused(tmp_path):
    (tmp_path / "run").mkdir()
    write_mcap(tmp_path / "run" / "a.mcap", [("/a", 5, point(1))], POINT)
    write_mcap(tmp_path / "run" / "b.mcap", [("/a", 6, string("x"))], STRING)
    assert f"/a is both {POINT} and {STRING}" in error_of(tmp_path / "run")
    with pytest.raises(DiffbotError, match=f"/a is both {POINT} and {STRING}"):
        MergedBags([tmp_path / "run" / "a.mcap", tmp_path / "run" / "b.mcap"])
    with (tmp_path / "c.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        channel = writer.register_channel("/a", "json", writer.register_schema(POINT, "jsonschema", b"{}"))
        writer.add_message(channel, 7, b'{"x": 1}', 7)
        writer.finish()
    with pytest.raises(DiffbotError, match="/a is both cdr and json"):
        MergedBags([tmp_path / "run" / "a.mcap", tmp_path / "c.mcap"])
    with BagReader(tmp_path / "c.mcap") as reader:
        assert (reader.topics["/a"].encoding, reader.schemas["/a"].data, reader.definitions) == ("json", b"{}", {})
        with pytest.raises(DiffbotError, match="/a is encoded as json: must be cdr"):
            list(reader.decoded())


def test_several_bags_are_read_as_one(bag, tmp_path):
    other = write_mcap(tmp_path / "b.mcap", [("/a", BEGIN + STEP, point(9)), ("/c", BEGIN - 7, point(8))])
    merged = MergedBags([bag, other])
    assert (merged.start, merged.end, merged.message_count) == (BEGIN - 7, BEGIN + 299 * STEP + STEP // 2, 603)
    assert merged.topics["/a"].message_count == 301
    found = [(one.topic, one.data) for one in merged.messages(["/a", "/c"], end=BEGIN + STEP)]
    assert found == [("/c", point(8)), ("/a", point(0)), ("/a", point(1)), ("/a", point(9))]
    assert len(merged.latched_before(BEGIN + 2 * STEP, ["/a"])) == 2, "one of each bag"
    merged.close()
    with pytest.raises(DiffbotError, match="this bag is given twice"):
        MergedBags([bag, bag])


def test_a_message_that_cannot_be_decoded_is_named_and_can_be_read_raw(tmp_path):
    writer = BagWriter(tmp_path / "parents" / "are made" / "run")
    writer.write(writer.add_topic("/a", POINT), b"\0\1\0\0too short", BEGIN, BEGIN)
    writer.write(writer.add_topic("/b", "my_msgs/msg/A"), b"\0\1\0\0", BEGIN, BEGIN)
    with pytest.raises(DiffbotError, match="log time -1, publish time 0: must be in"):
        writer.write(1, b"", -1, 0)
    writer.close()
    with BagReader(writer.folder) as reader:
        with pytest.raises(DiffbotError, match=f"/a at {BEGIN} ns: cannot decode 13 bytes as {POINT}"):
            list(reader.decoded(["/a"]))
        with pytest.raises(DiffbotError, match=r"my_msgs/msg/A: share/my_msgs/msg/A\.msg is not installed"):
            list(reader.decoded(["/b"]))
        assert len(list(reader.messages())) == 2
        assert (reader.schemas["/b"].name, reader.schemas["/b"].data) == ("my_msgs/msg/A", b"")


def test_a_bag_may_have_more_files_than_a_process_may_open(tmp_path):
    for number in range(1100):
        write_mcap(tmp_path / f"run_{number:04}.mcap", [("/a", BEGIN + number, point(number))])
    with BagReader(tmp_path) as reader:
        assert (len(reader.files), reader.message_count) == (1100, 1100)
        assert [one.data for one in reader.messages()] == [point(number) for number in range(1100)]


def test_each_file_after_a_split_begins_with_the_latched_messages_and_attachments(tmp_path):
    writer = BagWriter(tmp_path / "run", chunk_size=1000)
    data, latched = writer.add_topic("/data", STRING, [Qos()]), writer.add_topic("/map", STRING, [LATCHED])
    assert not writer.split(), "an empty file"
    writer.note_publishers(latched, 2)
    for content, number in (("a1", 1), ("b8", 8), ("a2", 2), ("map a", 3), ("map b", 9)):
        writer.write(latched, string(content), BEGIN, BEGIN - 5, number)
    writer.attach("a.json", "application/json", b"first")
    for number in range(11):
        writer.write(data, string(f"data {number}"), BEGIN + number * STEP, BEGIN, number)
        if number in (4, 9):
            assert writer.split()
            assert not writer.split()
            writer.attach("a.json", "application/json", b"second")
    assert (writer.count, writer.is_latched(latched), writer.is_latched(data)) == (16, True, False)
    writer.close()
    files = [writer.folder / f"run_{index}.mcap" for index in range(3)]
    expected = [[f"data {number}" for number in numbers] for numbers in (range(5), range(5, 10), range(10, 11))]
    assert [texts(file) for file in files] == expected
    assert [texts(file, "/map") for file in files[1:]] == [["map a", "map b"]] * 2, "the last one of each publisher"
    # At the head of the file, with its time, but as it was published.
    with files[1].open("rb") as stream:
        _, channel, message = next(make_reader(stream).iter_messages(log_time_order=False))
    assert (channel.topic, message.log_time, message.publish_time) == ("/map", BEGIN + 5 * STEP, BEGIN - 5)
    for file, content in zip(files, (b"first", b"second", b"second"), strict=True):
        with BagReader(file) as reader:
            assert (reader.attachment("a.json"), reader.attachment("b.json")) == (content, None)
            assert set(reader.topics) == {"/data", "/map"}


def test_a_latched_topic_may_be_added_while_a_file_begins(tmp_path):
    """The worker thread begins the file, and the calling thread adds the topic."""
    files = BagFiles(tmp_path, CompressionType.NONE, FileLimits(), dict)

    class Adding(LatchedRows):
        @property
        def rows(self):
            files.latched[2] = LatchedRows(1)
            return []

        @rows.setter
        def rows(self, _rows):
            pass

    files.latched[1] = Adding(1)
    files.write([(3, BEGIN, point(1), BEGIN, 1)])
    files.end()
    assert metadata.read(tmp_path).message_count == 1


def trickle(folder, **limits):
    """Record 4 MB of hexadecimal digits, with a flush every 4 kB; return the files."""
    random, writer = Random(1), BagWriter(folder, limits=FileLimits(**limits))
    writer.custom_data = {"lost_messages": "7"}
    channel = writer.add_topic("/data", STRING, [Qos()])
    for number in range(2000):
        stamp = BEGIN + number * 10 * STEP
        writer.write(channel, string(random.randbytes(1000).hex()), stamp, stamp, number)
        if number % 2:
            writer.flush()
    deadline = time.monotonic() + 60.0
    while writer.unflushed:
        assert time.monotonic() < deadline
        time.sleep(0.001)
    # metadata.yaml names existing files before the end, too, so that a killed recorder leaves a readable bag.
    named = metadata.read(folder)
    assert all((folder / one.name).is_file() for one in named.files)
    assert [one.name for one in named.topics] == ["/data"]
    writer.close()
    assert metadata.read(folder).custom_data == {"lost_messages": "7"}
    return files_of(folder)


def test_size_duration_and_number_of_files_are_limited_even_if_chunks_are_small(tmp_path):
    size = 2**19
    *full, last = [path.stat().st_size for path in trickle(tmp_path / "all", max_size=size)]
    # The digits take half of their size in the file, which is what counts.
    assert 3 <= len(full) <= 5
    assert all(size <= found < 1.05 * size for found in full)
    assert last < 1.05 * size
    assert len(check_metadata(tmp_path / "all")) == 2000
    kept = trickle(tmp_path / "newest", max_size=size, max_files=2)
    assert [path.name for path in kept] == [f"newest_{number}.mcap" for number in (len(full) - 1, len(full))]
    assert check_metadata(tmp_path / "newest")[-1].sequence == 1999
    seconds = trickle(tmp_path / "timed", max_duration=50 * 10**9)
    assert len(seconds) == 4
    assert [len(facts(path)) for path in seconds] == [500] * 4


@pytest.mark.parametrize("content", [b"[1]", b"{"])
def test_invalid_node_parameters_are_refused(tmp_path, content):
    with new_bag(tmp_path / "run") as writer:
        writer.attach(PARAMETERS, "application/json", content)
    with BagReader(tmp_path / "run") as reader, pytest.raises(DiffbotError, match=r"not a map of nodes|not JSON"):
        reader.node_parameters()


def test_add_messages_writes_the_same_bytes_as_add_message():
    random, files = Random(7), []
    # Not in the order of their times, of every size, with the largest numbers that MCAP holds.
    batches = [
        [
            (random.randint(1, 3), random.choice((0, 5, 2**63)), random.randbytes(n % 40), 7, 2**32 - 1)
            for n in range(size)
        ]
        for size in (3, 1, 200)
    ]
    for at_once in (True, False):
        files.append(io.BytesIO())
        with mcap_writing(files[-1], dict.fromkeys(("/a", "/b", "/c"), POINT), chunk_size=2**30) as (writer, _):
            for rows in batches:
                if at_once:
                    add_messages(writer, rows)
                else:
                    for row in rows:
                        writer.add_message(*row)
                writer.flush()
    assert files[0].getvalue() == files[1].getvalue()


def test_check_disk_reports_low_space_and_a_moved_file(tmp_path):
    writer = BagWriter(tmp_path / "run")
    writer.check_disk(0)
    with pytest.raises(BagWriteError, match=r"recording ends: .* bytes of free space: must be >= 1125899906842624"):
        writer.check_disk(2**50)
    assert not writer.closed
    writer.path.rename(tmp_path / "moved")
    with pytest.raises(BagWriteError, match="was moved or deleted while it was written"):
        writer.check_disk(0)
    writer.close()


def test_a_disk_error_closes_the_bag_and_keeps_flushed_messages(tmp_path, monkeypatch):
    writer = BagWriter(tmp_path / "run")
    channel = writer.add_topic("/data", STRING, [Qos()])
    writer.write(channel, string("a"), 5, 5)
    writer.split()
    writer.write(channel, string("b"), 6, 6)
    writer.flush()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    writer.write(channel, string("c"), 7, 7)
    writer.flush()
    with pytest.raises(BagWriteError, match=r"cannot write .*run_1.mcap: No space left .* after about 3 messages"):
        writer.split()
    monkeypatch.undo()
    assert writer.closed
    writer.close()
    with BagReader(writer.folder) as reader:
        assert [one.log_time for one in reader.messages()][:2] == [5, 6]


def test_any_error_of_the_worker_thread_is_a_write_error(tmp_path, monkeypatch):
    """Otherwise the recorder would not notice that its bag is closed."""
    writer = BagWriter(tmp_path / "run")

    def fail(_rows):
        raise MemoryError

    monkeypatch.setattr(writer._files, "write", fail)
    writer.write(writer.add_topic("/text", STRING), string("a"), 5, 5)
    with pytest.raises(BagWriteError, match=r"cannot write .*run_0.mcap: MemoryError; the bag ends"):
        writer.close()
    assert writer.closed


def test_an_invalid_folder_is_refused_and_nothing_is_created(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "file").write_text("")
    for make in (BagWriter, lambda path: new_bag(path).__enter__()):
        with pytest.raises(BagWriteError, match=r"run already exists: choose another name for the bag$"):
            make(tmp_path / "run")
        for parent in (tmp_path / "file", Path("/proc/none")):
            with pytest.raises(BagWriteError, match=r"cannot (create|write) the bag .*: \w") as error:
                make(parent / "run")
            assert "\n" not in str(error.value)
    assert not list((tmp_path / "run").iterdir())


def test_a_new_bag_appears_complete_or_not_at_all(tmp_path):
    with new_bag(tmp_path / "run") as writer:
        writer.write(writer.add_topic("/text", STRING), string("a"), 5, 5)
        (writer.folder / "notes.txt").write_text("x")
        assert not (tmp_path / "run").exists()
    assert sorted(one.name for one in (tmp_path / "run").iterdir()) == ["metadata.yaml", "notes.txt", "run_0.mcap"]
    with pytest.raises(KeyError), new_bag(tmp_path / "other"):
        raise KeyError
    assert [one.name for one in tmp_path.iterdir()] == ["run"]
