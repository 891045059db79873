"""Reading bags: order, filters, decoded values against rosbags, and one clear line for every kind of wrong file."""

import contextlib
import random
import re
import sqlite3
from pathlib import Path

import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

from diffbot_bag.qos import Qos
from diffbot_bag.reader import BagReader
from diffbot_bag.writer import BagWriter
from diffbot_core.errors import DiffbotError

STORE = get_typestore(Stores.ROS2_JAZZY)
POINT = "geometry_msgs/msg/Point"
BEGIN = 1_700_000_000_000_000_000
STEP = 10_000_000


def point(x, y=0.0):
    return bytes(STORE.serialize_cdr(STORE.types[POINT](x=x, y=y, z=0.0), POINT))


def write_bag(folder, first=0, count=300, **options):
    """Topics /a at every step and /b half a step later; written in pairs the wrong way round."""
    writer = BagWriter(folder, chunk_size=2000, **options)
    a, b = (writer.add_topic(name, POINT, [Qos()]) for name in ("/a", "/b"))
    for index in range(first, first + count):
        time = BEGIN + index * STEP
        writer.write(b, point(float(index), 1.0), time + STEP // 2, time)
        writer.write(a, point(float(index)), time, time - 1)
    writer.close()
    return folder


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bags") / "run")


@pytest.fixture
def broken(bag, tmp_path):
    """A copy of the bag's file to break: returns path and bytes."""
    path = tmp_path / "broken.mcap"
    return path, (bag / "run_0.mcap").read_bytes()


@contextlib.contextmanager
def opened(path, content=None):
    """An open file for the mcap library's reader."""
    if content is not None:
        path.write_bytes(content)
    with path.open("rb") as stream:
        yield stream


def error_of(path):
    """The line with which a bag is refused, at the opening or while it is read."""
    with pytest.raises(DiffbotError) as error, BagReader(path) as reader:
        list(reader.messages())
    assert "\n" not in str(error.value)
    assert path.name in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("what", ["folder", "file"])
def test_what_is_in_a_bag(bag, what):
    with BagReader(bag if what == "folder" else bag / "run_0.mcap") as reader:
        assert reader.message_count == 600
        assert (reader.start, reader.end) == (BEGIN, BEGIN + 299 * STEP + STEP // 2)
        assert {name: (topic.type, topic.message_count, topic.qos) for name, topic in reader.topics.items()} == {
            "/a": (POINT, 300, (Qos(),)),
            "/b": (POINT, 300, (Qos(),)),
        }
        if what == "folder":
            stored = reader.metadata
            assert (stored.message_count, stored.start, stored.start + stored.duration) == (
                600,
                reader.start,
                reader.end,
            )


def test_messages_come_in_the_order_of_log_time_with_their_bytes(bag):
    with BagReader(bag) as reader:
        messages = list(reader.messages())
        back = list(reader.messages(reverse=True))
    assert [message.log_time for message in messages] == [BEGIN + half * STEP // 2 for half in range(600)]
    assert [message.data for message in messages[::2]] == [point(float(index)) for index in range(300)]
    assert [message.topic for message in messages[:3]] == ["/a", "/b", "/a"]
    assert messages[0].publish_time == BEGIN - 1
    assert back == messages[::-1]


def test_topics_and_range_select(bag):
    with BagReader(bag) as reader:
        times = [message.log_time for message in reader.messages(["/a"], BEGIN + 7 * STEP, BEGIN + 10 * STEP)]
        assert times == [BEGIN + index * STEP for index in (7, 8, 9, 10)]
        assert len(list(reader.messages(("/b", "/none"), end=BEGIN + 2 * STEP))) == 2
        assert not list(reader.messages(start=reader.end + 1))
        assert not list(reader.messages(start=BEGIN + 1, end=BEGIN))
        assert not list(reader.messages([]))


def test_the_last_messages_before_a_time(bag):
    with BagReader(bag) as reader:
        found = reader.last_before(BEGIN + 10 * STEP, ["/b", "/a", "/none"])
        assert [(message.topic, message.log_time) for message in found] == [
            ("/a", BEGIN + 9 * STEP),
            ("/b", BEGIN + 9 * STEP + STEP // 2),
        ]
        assert reader.last_before(BEGIN, ["/a"]) == []
        assert reader.last_before(BEGIN + STEP, []) == []


def test_decoded_values_are_those_rosbags_decodes(bag):
    with BagReader(bag) as reader, AnyReader([bag]) as other:
        decoded = [(m.topic, m.log_time, m.content.x, m.content.y) for m in reader.decoded()]
        theirs = [
            (connection.topic, time, content.x, content.y)
            for connection, time, data in other.messages()
            for content in [other.deserialize(data, connection.msgtype)]
        ]
    assert decoded == theirs


def test_a_bag_of_rosbags_is_read(tmp_path):
    with RosbagsWriter(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/a", POINT, typestore=STORE)
        for index in range(5):
            writer.write(connection, BEGIN + index, point(float(index)))
    with BagReader(tmp_path / "run") as reader:
        assert [message.content.x for message in reader.decoded()] == [0.0, 1.0, 2.0, 3.0, 4.0]
        assert reader.topics["/a"].qos == ()


def test_a_bag_of_several_files_is_one(tmp_path):
    folder = write_bag(tmp_path / "run", 0, 10)
    write_bag(tmp_path / "more", 5, 10)
    (tmp_path / "more" / "more_0.mcap").rename(folder / "run_1.mcap")
    content = yaml.safe_load((folder / "metadata.yaml").read_text())
    content["rosbag2_bagfile_information"]["relative_file_paths"].append("run_1.mcap")
    (folder / "metadata.yaml").write_text(yaml.safe_dump(content))
    with BagReader(folder) as reader:
        times = [message.log_time for message in reader.messages(["/a"])]
        assert times == sorted(BEGIN + index * STEP for index in [*range(10), *range(5, 15)])
        assert times[::-1] == [message.log_time for message in reader.messages(["/a"], reverse=True)]
        assert reader.topics["/a"].message_count == 20
        assert (reader.start, reader.end, reader.message_count) == (BEGIN, BEGIN + 14 * STEP + STEP // 2, 40)


def test_a_folder_without_metadata_is_read(tmp_path):
    folder = write_bag(tmp_path / "run", 0, 3)
    (folder / "metadata.yaml").unlink()
    with BagReader(folder) as reader:
        assert reader.message_count == 6
        assert "metadata.yaml is missing" in reader.warning


def test_a_bag_without_messages_has_no_times(tmp_path):
    BagWriter(tmp_path / "run").close()
    with BagReader(tmp_path / "run") as reader:
        assert (reader.message_count, reader.start, reader.end, list(reader.messages())) == (0, 0, 0, [])


def test_a_missing_bag_and_an_empty_folder(tmp_path):
    assert "no such file or folder" in error_of(tmp_path / "none")
    with pytest.raises(DiffbotError, match="File name too long"):
        BagReader(tmp_path / ("x" * 300))
    with pytest.raises(DiffbotError, match="no bag ~nobody-of-this-name/run: "):
        BagReader(Path("~nobody-of-this-name/run"))
    (tmp_path / "empty").mkdir()
    assert "neither metadata.yaml nor an MCAP file" in error_of(tmp_path / "empty")


@pytest.mark.parametrize("share", [0.0001, 0.01, 0.1, 0.5, 0.9, 0.99, 0.9999])
def test_a_file_that_was_cut_off_is_read_up_to_there_with_a_warning(bag, broken, share):
    path, content = broken
    cut = max(9, int(len(content) * share))
    path.write_bytes(content[:cut])
    with opened(bag / "run_0.mcap") as stream:
        # What is whole by the index of the complete file.
        kept = [
            chunk
            for chunk in make_reader(stream).get_summary().chunk_indexes
            if chunk.chunk_start_offset + chunk.chunk_length <= cut
        ]
    with BagReader(bag) as reader, BagReader(path) as unfinished:
        last = max((chunk.message_end_time for chunk in kept), default=0)
        expected = [message for message in reader.messages() if message.log_time <= last]
        assert list(unfinished.messages()) == expected
        assert [row[:2] for row in unfinished.rows(["/a", "/b"])] == [(one.log_time, one.topic) for one in expected]
        assert unfinished.message_count == len(expected)
        assert unfinished.end == last
        assert sum(topic.message_count for topic in unfinished.topics.values()) == len(expected)
        assert "\n" not in unfinished.warning
        assert "broken.mcap is unfinished: broken.mcap has no index" in unfinished.warning
        assert "`diffbot bag repair`" in unfinished.warning


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
def test_unfinished_files_of_the_mcap_library_are_read(tmp_path, compression, chunked):
    path = tmp_path / "plain.mcap"
    with path.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=1000, compression=compression, use_chunking=chunked)
        writer.start("ros2")
        channel = writer.register_channel("/a", "cdr", writer.register_schema(POINT, "ros2msg", b"float64 x"))
        for index in range(500):
            writer.add_message(channel, BEGIN + index, point(float(index)), index)
        writer.flush()
    with BagReader(path) as reader:
        assert [(one.log_time, one.publish_time) for one in reader.messages()] == [(BEGIN + i, i) for i in range(500)]
        assert reader.warning.count("no index") == 1
        assert reader.topics["/a"].type == POINT


def test_a_folder_of_a_killed_recorder_is_read(tmp_path):
    writer = BagWriter(tmp_path / "run")
    channel = writer.add_topic("/a", POINT, [Qos(durability="transient_local")])
    for index in range(10):
        writer.write(channel, point(float(index)), BEGIN + index, BEGIN)
    writer.flush()
    with BagReader(tmp_path / "run") as reader:
        assert [message.content.x for message in reader.decoded()] == [float(index) for index in range(10)]
        assert reader.topics["/a"].qos == (Qos(durability="transient_local"),)
        assert reader.warning.endswith(
            "run is unfinished: run_0.mcap has no index; metadata.yaml is missing"
            " (`diffbot bag repair` writes a complete one)"
        )
    writer.close()
    with BagReader(tmp_path / "run") as reader:
        assert reader.warning == ""


def test_an_unfinished_file_with_damage_is_an_error_that_names_the_repair(broken):
    path, content = broken
    generator = random.Random(3)
    with opened(path.parent / "whole.mcap", content) as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    intact = content[: chunks[-1].chunk_start_offset + 100]
    path.write_bytes(intact)
    with BagReader(path) as reader:
        expected = list(reader.messages())
    lines = []
    for chunk in chunks[:-1] * 3:
        flipped = bytearray(intact)
        flipped[chunk.chunk_start_offset + generator.randrange(chunk.chunk_length)] ^= 1 << generator.randrange(8)
        path.write_bytes(flipped)
        try:
            with BagReader(path) as reader:
                read = list(reader.messages())
        except DiffbotError as error:
            lines.append(str(error))
        else:
            # A bit without a meaning, or times of the chunk that are wider than needed.
            assert read == expected
    assert len(lines) > 0.9 * 3 * len(chunks[:-1])
    for line in lines:
        assert re.search(r"is damaged \(.*\): `diffbot bag repair` saves what is intact$", line)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is an empty file"),
        (b"\x89MC", "is not an MCAP file"),
        (bytes(range(256)) * 40, "is not an MCAP file"),
        (b"hello: world\n", "is not an MCAP file"),
        (b"#ROSBAG V2.0\n", "is not an MCAP file"),
        (b"\x89MCAP0\r\n" * 2, "is damaged"),
        (b"\x89MCAP0\r\n" + b"\xff" * 100 + b"\x89MCAP0\r\n", "is damaged"),
        (b"\x89MCAP0\r\n" + b"\0" * 100 + b"\x89MCAP0\r\n", "is damaged"),
    ],
)
def test_a_foreign_file(tmp_path, content, words):
    path = tmp_path / "foreign.mcap"
    path.write_bytes(content)
    assert words in error_of(path)


def test_a_database_is_not_an_mcap_file(tmp_path):
    path = tmp_path / "bag.db3"
    with sqlite3.connect(path) as database:
        database.execute("create table messages (id integer)")
    database.close()
    assert "is not an MCAP file" in error_of(path)


def test_a_flipped_byte_never_passes_as_data(broken):
    path, content = broken
    path.write_bytes(content)
    with BagReader(path) as reader:
        whole = list(reader.messages())
    refused = 0
    for position in range(20, len(content) - 20, len(content) // 200):
        flipped = bytearray(content)
        flipped[position] ^= 0x55
        path.write_bytes(flipped)
        try:
            with BagReader(path) as reader:
                read = list(reader.messages()), reader.message_count
        except DiffbotError:
            refused += 1
        else:
            assert read == (whole, 600)
    # The rest hit message indexes, which are not used, and texts of the header.
    assert refused > 60


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "has no rosbag2_bagfile_information"),
        ("- a\n- b\n", "has no rosbag2_bagfile_information"),
        ("rosbag2_bagfile_information: 5\n", "has no rosbag2_bagfile_information"),
        ("a: {b\n", "is not a YAML file"),
        ("\0\1\2", "is not a YAML file"),
        ("rosbag2_bagfile_information: {storage_identifier: sqlite3}\n", "must be mcap"),
        (
            "rosbag2_bagfile_information: {storage_identifier: mcap, compression_mode: FILE}\n",
            "compression_mode = 'FILE': must be empty",
        ),
        ("rosbag2_bagfile_information: {storage_identifier: mcap}\n", "is incomplete"),
        (
            "rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: [a_0.mcap],"
            " starting_time: {nanoseconds_since_epoch: x}}\n",
            "is incomplete",
        ),
    ],
)
def test_a_wrong_metadata_yaml(tmp_path, text, words):
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(DiffbotError, match=words) as error:
        BagReader(tmp_path)
    assert "\n" not in str(error.value)


def test_a_file_named_in_metadata_is_missing(tmp_path):
    folder = write_bag(tmp_path / "run", 0, 3)
    (folder / "run_0.mcap").unlink()
    with pytest.raises(DiffbotError, match=r"cannot open .*run_0.mcap: No such file"):
        BagReader(folder)


def test_a_file_without_an_index_is_read_with_a_warning(tmp_path):
    path = tmp_path / "plain.mcap"
    writer = McapWriter(
        str(path), index_types=IndexType.NONE, use_statistics=False, repeat_channels=False, repeat_schemas=False,
        use_summary_offsets=False,
    )  # fmt: skip
    writer.start()
    channel = writer.register_channel("/a", "cdr", 0)
    writer.add_message(channel, BEGIN, b"data", BEGIN)
    writer.finish()
    with BagReader(path) as reader:
        assert [message.data for message in reader.messages()] == [b"data"]
        assert "plain.mcap has no index (" in reader.warning


def test_a_message_that_does_not_fit_its_definition(tmp_path):
    writer = BagWriter(tmp_path / "run")
    writer.write(writer.add_topic("/a", POINT), b"\0\1\0\0too short", BEGIN, BEGIN)
    writer.write(writer.add_topic("/b", "my_msgs/msg/A"), b"\0\1\0\0", BEGIN, BEGIN)
    writer.close()
    with BagReader(tmp_path / "run") as reader:
        with pytest.raises(DiffbotError, match=f"cannot decode /a at {BEGIN} ns"):
            list(reader.decoded(["/a"]))
        with pytest.raises(DiffbotError, match="/b: no message definition in the bag"):
            list(reader.decoded(["/b"]))
        assert len(list(reader.messages())) == 2


def test_rows_are_the_same_messages_in_the_same_order(bag):
    with BagReader(bag) as reader:
        ordered = [(one.log_time, one.topic, one.publish_time, one.data) for one in reader.messages()]
        rows = list(reader.rows(reader.topics))
        assert [(time, topic, published, data) for time, topic, _, published, data in rows] == ordered
        assert [row for row in reader.rows(["/a"])] == [row for row in rows if row[1] == "/a"]


def mcap_file(path, messages, **options):
    """Write log time, publish time, sequence number and data of one topic."""
    with path.open("wb") as stream:
        writer = McapWriter(stream, **options)
        writer.start("ros2")
        channel = writer.register_channel("/a", "cdr", writer.register_schema(POINT, "ros2msg", b"float64 x"))
        for log_time, publish_time, sequence, data in messages:
            writer.add_message(channel, log_time, data, publish_time, sequence)
        writer.finish()


def test_rows_of_a_file_without_chunks(tmp_path):
    mcap_file(tmp_path / "plain.mcap", [(5, 4, 7, b"data"), (3, 2, 6, b"")], use_chunking=False)
    with BagReader(tmp_path / "plain.mcap") as reader:
        assert list(reader.rows(["/a"])) == [(3, "/a", 6, 2, b""), (5, "/a", 7, 4, b"data")]


def test_rows_of_chunks_and_files_that_overlap_in_time_are_in_order(tmp_path):
    times = [(37 * index) % 101 for index in range(101)]
    for name, part in (("a", times[:60]), ("b", times[60:])):
        mcap_file(tmp_path / f"{name}.mcap", [(time, time, time, bytes(20)) for time in part], chunk_size=200)
    with BagReader(tmp_path) as reader:
        assert min(len(file.chunks) for file in reader.files) > 3
        assert [row[0] for row in reader.rows(["/a"])] == list(range(101))


def test_reading_rows_finds_damage_too(broken):
    path, content = broken
    frame = content.index(b"\x28\xb5\x2f\xfd", len(content) // 3) + 50
    path.write_bytes(content[:frame] + bytes(64) + content[frame + 64 :])
    with pytest.raises(DiffbotError, match="damaged") as error, BagReader(path) as reader:
        list(reader.rows(["/a", "/b"]))
    assert "\n" not in str(error.value)
