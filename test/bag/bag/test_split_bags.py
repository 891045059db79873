"""Bags of several files: where files end, what each contains and what metadata.yaml says, for other libraries."""

from random import Random

import cut_bags
import pytest
from bag_makers import BEGIN, STORE, STRING, string
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from diffbot_bag.bag import metadata
from diffbot_bag.bag.qos import Qos
from diffbot_bag.bag.reader import BagReader
from diffbot_bag.bag.writer import BagWriter, is_unfinished
from diffbot_bag.mcap.attachments import HIDDEN, PARAMETERS, dump_parameters
from diffbot_bag.record.bag_files import FileLimits
from diffbot_bag.record.disk import Disk, DiskThread
from diffbot_core.errors import DiffbotError

LATCHED = Qos(durability="transient_local")
SECOND = 10**9


class Written:
    """A bag of one volatile and one latched topic, and what was written to it."""

    def __init__(self, folder, **options):
        self.folder = folder
        self.writer = BagWriter(folder, chunk_size=1000, **options)
        self.volatile = self.writer.add_topic("/data", STRING, [Qos()])
        self.latched = self.writer.add_topic("/map", STRING, [LATCHED])
        self.count = 0

    def data(self, number=1):
        for _ in range(number):
            self.count += 1
            self.writer.write(self.volatile, string(f"data {self.count}"), self.now, self.now - 5, self.count)

    @property
    def now(self):
        return BEGIN + self.count * SECOND // 10

    def map(self, content, number=1):
        self.writer.write(self.latched, string(content), self.now, self.now - 5, number)

    def close(self, **custom):
        self.writer.close(custom)
        return self.folder


def texts(path, topic="/data"):
    return [STORE.deserialize_cdr(one.data, one.type).data for one in cut_bags.facts(path) if one.topic == topic]


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("disk", [Disk, DiskThread])
def test_a_split_loses_nothing_and_repeats_latched_messages_only(tmp_path, disk):
    bag = Written(tmp_path / "run", disk=disk())
    assert not bag.writer.split(), "an empty file"
    bag.writer.note_publishers(bag.latched, 2)
    for content, number in (("a1", 1), ("b8", 8), ("a2", 2), ("map a", 3), ("map b", 9)):
        bag.map(content, number)
    bag.data(5)
    assert bag.writer.split()
    bag.data(5)
    assert bag.writer.split()
    assert not bag.writer.split()
    bag.data(1)
    folder = bag.close(lost_messages="0")
    assert names(folder) == ["metadata.yaml", "run_0.mcap", "run_1.mcap", "run_2.mcap"]
    assert [texts(folder / f"run_{index}.mcap") for index in range(3)] == [
        [f"data {number}" for number in numbers] for numbers in (range(1, 6), range(6, 11), range(11, 12))
    ]
    # The last one of each publisher.
    assert [texts(folder / f"run_{index}.mcap", "/map") for index in (1, 2)] == [["map a", "map b"]] * 2
    # At the head of the file, with its time, but as it was published.
    with (folder / "run_1.mcap").open("rb") as stream:
        _, channel, message = next(make_reader(stream).iter_messages(log_time_order=False))
    assert (channel.topic, message.log_time, message.publish_time) == ("/map", BEGIN + 6 * SECOND // 10, BEGIN - 5)


def test_metadata_of_several_files_is_that_of_their_contents(tmp_path):
    bag = Written(tmp_path / "run", limits=FileLimits(max_duration=SECOND // 2))
    bag.map("map")
    bag.data(8)
    folder = bag.close(lost_messages="2")
    # The latched message is repeated in the second file.
    assert len(cut_bags.check_metadata(folder)) == 10
    assert [len(texts(path)) for path in cut_bags.files_of(folder)] == [4, 4]
    assert metadata.read(folder).custom_data == {"lost_messages": "2"}
    with AnyReader([folder]) as reader:
        assert len(list(reader.messages())) == reader.message_count == 10


def test_every_file_is_a_bag_by_itself(tmp_path):
    bag = Written(tmp_path / "run")
    bag.data(2)
    bag.writer.attach("a.json", "application/json", b"first")
    bag.writer.split()
    bag.data(2)
    bag.writer.attach("a.json", "application/json", b"second")
    late = bag.writer.add_topic("/late", "geometry_msgs/msg/Point", [Qos()])
    bag.writer.write(late, bytes(28), bag.now, 0)
    bag.writer.split()
    bag.data(1)
    folder = bag.close()
    found = []
    for index in range(3):
        with (folder / f"run_{index}.mcap").open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            summary = reader.get_summary()
            found.append([channel.topic for channel in summary.channels.values()])
            assert {channel.schema_id for channel in summary.channels.values()} == set(summary.schemas)
            assert [each.data for each in reader.iter_attachments()][-1] == (b"first", b"second", b"second")[index]
            assert [each.name for each in reader.iter_metadata()] == ["rosbag2", "rosbag2"]
        with BagReader(folder / f"run_{index}.mcap") as reader:
            assert reader.attachment("a.json") == (b"first", b"second", b"second")[index]
    assert found == [["/data", "/map"], ["/data", "/map", "/late"], ["/data", "/map", "/late"]]
    with BagReader(folder) as reader:
        assert reader.attachment("a.json") == b"second"
        assert reader.attachment("b.json") is None


def test_the_oldest_files_are_deleted(tmp_path):
    bag = Written(tmp_path / "run", limits=FileLimits(max_files=2))
    bag.writer.describe = lambda: {"lost_messages": "7"}
    assert is_unfinished(bag.folder)
    bag.map("map")
    for _ in range(4):
        bag.data(2)
        bag.writer.split()
    # Whatever is named can be read at any time, also if the recorder is killed.
    assert metadata.read(bag.folder).files == ("run_2.mcap", "run_3.mcap")
    assert metadata.read(bag.folder).custom_data == {"lost_messages": "7"}
    bag.data(1)
    bag.writer.flush()
    assert metadata.read(bag.folder).files == ("run_3.mcap",)
    folder = bag.close()
    assert names(folder) == ["metadata.yaml", "run_3.mcap", "run_4.mcap"]
    assert [texts(folder / f"run_{index}.mcap") for index in (3, 4)] == [["data 7", "data 8"], ["data 9"]]
    assert texts(folder / "run_4.mcap", "/map") == ["map"]
    with AnyReader([folder]) as reader:
        assert reader.message_count == 5
    assert metadata.read(folder).message_count == 5


@pytest.mark.parametrize(
    ("content", "words"), [(b"{", "is not"), (b"[" * 100_000, "is not"), (b'{"/a": {}}', "damaged")]
)
def test_attachments_that_cannot_be_read_are_one_line(tmp_path, content, words):
    bag = Written(tmp_path / "run")
    bag.writer.attach(PARAMETERS, "application/json", content)
    path = bag.close() / "run_0.mcap"
    if words == "damaged":
        path.write_bytes(path.read_bytes().replace(content, content[:-1] + b" "))
    with BagReader(path) as reader, pytest.raises(DiffbotError, match=words) as error:
        reader.node_parameters()
    assert "\n" not in str(error.value)


def test_parameters_are_read_as_they_were_written(tmp_path):
    values = {"gain": 0.5, "limit": float("inf"), "names": ["a", "b"], "on": True, "none": None, "api_key": "x"}
    bag = Written(tmp_path / "run")
    bag.writer.attach(PARAMETERS, "application/json", dump_parameters({"/ekf": values}))
    with BagReader(bag.close()) as reader:
        assert reader.node_parameters() == {"/ekf": {**values, "limit": "inf", "api_key": HIDDEN}}


def trickle(folder, **limits):
    """Record 4 MB of hexadecimal digits, 4 kB between two flushes, in chunks of the default size; return the files."""
    random, writer = Random(1), BagWriter(folder, limits=FileLimits(**limits))
    channel = writer.add_topic("/data", STRING, [Qos()])
    for number in range(2000):
        time = BEGIN + number * SECOND // 10
        writer.write(channel, string(random.randbytes(1000).hex()), time, time, number)
        if number % 2:
            writer.flush(sync=False)
    writer.close()
    return cut_bags.files_of(folder)


def test_messages_that_never_fill_a_chunk_end_a_file_at_its_largest_size_too(tmp_path):
    size = 2**19
    *full, last = [path.stat().st_size for path in trickle(tmp_path / "all", max_size=size)]
    # The digits take half of their size in the file, which is what counts.
    assert 3 <= len(full) <= 4
    assert all(size <= found < 1.05 * size for found in full)
    assert last < 1.05 * size
    assert len(cut_bags.check_metadata(tmp_path / "all")) == 2000
    kept = trickle(tmp_path / "newest", max_size=size, max_files=2)
    assert [path.name for path in kept] == [f"newest_{number}.mcap" for number in (len(full) - 1, len(full))]
    assert cut_bags.check_metadata(tmp_path / "newest")[-1].sequence == 1999
