"""Reading bags: order, filters, decoded values against rosbags, and one clear line for every kind of wrong file."""

import io
import re

import pytest
from bag_makers import BEGIN, POINT, point
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from diffbot_bag.bag.qos import Qos
from diffbot_bag.bag.reader import BagReader
from diffbot_bag.bag.writer import BagWriter
from diffbot_core.errors import DiffbotError

STEP = 10_000_000


def write_bag(folder, first=0, count=300, **options):
    """Topics /a at every step and /b half a step later; written in pairs the wrong way round."""
    writer = BagWriter(folder, chunk_size=2000, **options)
    a, b = (writer.add_topic(name, POINT, [Qos()]) for name in ("/a", "/b"))
    for index in range(first, first + count):
        time = BEGIN + index * STEP
        writer.write(b, point(-index), time + STEP // 2, time)
        writer.write(a, point(index), time, time - 1)
    writer.close()
    return folder


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bags") / "run")


def error_of(path):
    """The line with which a bag is refused, at the opening or while it is read."""
    with pytest.raises(DiffbotError) as error, BagReader(path) as reader:
        list(reader.messages())
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
        messages = list(reader.messages())
        assert list(reader.messages(reverse=True)) == messages[::-1]
        rows = [(row[0], row[1], row[3], row[4]) for row in reader.rows(reader.topics)]
        assert rows == [(one.log_time, one.topic, one.publish_time, one.data) for one in messages]
    assert [message.log_time for message in messages] == [BEGIN + half * STEP // 2 for half in range(600)]
    assert [message.data for message in messages[::2]] == [point(index) for index in range(300)]
    assert [message.topic for message in messages[:3]] == ["/a", "/b", "/a"]
    assert messages[0].publish_time == BEGIN - 1


def test_topics_and_range_select(bag):
    with BagReader(bag) as reader:
        times = [message.log_time for message in reader.messages(["/a"], BEGIN + 7 * STEP, BEGIN + 10 * STEP)]
        assert times == [BEGIN + index * STEP for index in (7, 8, 9, 10)]
        assert len(list(reader.messages(("/b", "/none"), end=BEGIN + 2 * STEP))) == 2
        assert {row[1] for row in reader.rows(["/a"])} == {"/a"}
        assert not list(reader.messages(start=reader.end + 1))
        assert not list(reader.messages(start=BEGIN + 1, end=BEGIN))
        assert not list(reader.messages([]))
        found = reader.last_before(BEGIN + 10 * STEP, ["/b", "/a", "/none"])
        assert [(message.topic, message.log_time) for message in found] == [
            ("/a", BEGIN + 9 * STEP),
            ("/b", BEGIN + 9 * STEP + STEP // 2),
        ]
        assert reader.last_before(BEGIN, ["/a"]) == reader.last_before(BEGIN + STEP, []) == []


def test_a_missing_bag_an_empty_folder_and_a_foreign_file(tmp_path):
    assert "no such file or folder" in error_of(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    assert "neither metadata.yaml nor an MCAP file" in error_of(tmp_path / "empty")
    folder = write_bag(tmp_path / "run", 0, 3)
    (folder / "run_0.mcap").unlink()
    with pytest.raises(DiffbotError, match=r"cannot open .*run_0.mcap: No such file"):
        BagReader(folder)
    (tmp_path / "foreign.mcap").write_bytes(b"#ROSBAG V2.0\n")
    assert "is not an MCAP file" in error_of(tmp_path / "foreign.mcap")


@pytest.mark.parametrize("share", [0.0001, 0.5, 0.9999])
def test_a_file_that_was_cut_off_is_read_up_to_there_with_a_warning(bag, tmp_path, share):
    content, path = (bag / "run_0.mcap").read_bytes(), tmp_path / "broken.mcap"
    cut = max(9, int(len(content) * share))
    path.write_bytes(content[:cut])
    # What is whole by the index of the complete file.
    chunks = make_reader(io.BytesIO(content)).get_summary().chunk_indexes
    kept = [one.message_end_time for one in chunks if one.chunk_start_offset + one.chunk_length <= cut]
    with BagReader(bag) as reader, BagReader(path) as unfinished:
        last = max(kept, default=0)
        expected = [message for message in reader.messages() if message.log_time <= last]
        assert list(unfinished.messages()) == expected
        assert [row[:2] for row in unfinished.rows(["/a", "/b"])] == [(one.log_time, one.topic) for one in expected]
        assert (unfinished.message_count, unfinished.end) == (len(expected), last)
        assert sum(topic.message_count for topic in unfinished.topics.values()) == len(expected)
        assert "broken.mcap is unfinished: broken.mcap has no index" in unfinished.warning
        assert "`diffbot bag repair`" in unfinished.warning


@pytest.mark.parametrize(
    ("compression", "options"),
    [
        (CompressionType.LZ4, {}),
        (CompressionType.NONE, {"use_chunking": False}),
    ],
)
@pytest.mark.parametrize("is_finished", [True, False])
def test_files_of_the_mcap_library_are_read_in_order(tmp_path, compression, options, is_finished):
    times = [(37 * index) % 101 for index in range(101)]
    with (tmp_path / "plain.mcap").open("wb") as stream:
        writer = McapWriter(stream, compression=compression, **options)
        writer.start("ros2")
        channel = writer.register_channel("/a", "cdr", writer.register_schema(POINT, "ros2msg", b"float64 x"))
        for number, time in enumerate(times):
            writer.add_message(channel, time, point(number), number, number)
        (writer.finish if is_finished else writer.flush)()
    with BagReader(tmp_path / "plain.mcap") as reader:
        expected = sorted((time, number) for number, time in enumerate(times))
        assert [(one.log_time, one.publish_time) for one in reader.messages()] == expected
        assert [(row[0], row[2], row[3]) for row in reader.rows(["/a"])] == [(*one, one[1]) for one in expected]
        assert ("no index" in reader.warning) is not is_finished
        assert reader.topics["/a"].type == POINT


@pytest.mark.parametrize("is_finished", [True, False])
def test_a_flipped_byte_never_passes_as_data(bag, tmp_path, is_finished):
    content, path = (bag / "run_0.mcap").read_bytes(), tmp_path / "broken.mcap"
    content = content if is_finished else content[: len(content) * 3 // 4]

    def read(data):
        path.write_bytes(data)
        with BagReader(path) as reader:
            return list(reader.messages()), len(list(reader.rows(reader.topics)))

    whole, lines = read(content), []
    for position in range(20, len(content) - 2000, len(content) // 30):
        flipped = bytearray(content)
        flipped[position] ^= 0x55
        try:
            # Message indexes are not used, nor texts of the header.
            assert read(flipped) == whole
        except DiffbotError as error:
            lines.append(str(error))
    assert len(lines) > 7
    if not is_finished:
        words = r"is damaged \(.*\): `diffbot bag repair` saves what is intact$|not a QoS profile"
        assert all(re.search(words, line) for line in lines)


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
