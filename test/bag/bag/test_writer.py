"""Bags as other libraries read them: rosbags, mcap and PyYAML."""

from pathlib import Path

import pytest
import yaml
from bag_makers import BEGIN, STRING, string
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from view_bags import command, data_of

from diffbot_bag.bag import metadata
from diffbot_bag.bag.message_definitions import MessageDefinitions
from diffbot_bag.bag.new_bag import new_bag
from diffbot_bag.bag.qos import Qos
from diffbot_bag.bag.writer import BagWriteError, BagWriter

TWIST = "geometry_msgs/msg/Twist"
LATCHED = Qos(durability="transient_local")


def write_bag(folder, count=10, **options):
    """Two topics: a twist each 10 ms, and one latched text at the begin."""
    writer = BagWriter(folder, **options)
    commands = writer.add_topic("/cmd_vel", TWIST, [Qos(), Qos(reliability="best_effort")])
    texts = writer.add_topic("/robot_description", STRING, [LATCHED])
    writer.write(texts, string("<robot/>"), BEGIN, BEGIN - 5)
    for index in range(count):
        time = BEGIN + index * 10_000_000
        writer.write(commands, data_of(command(index, -index)), time, time - 1000, index + 1)
    return writer


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags") / "run"
    write_bag(folder).close({"lost_messages": "3"})
    return folder


def test_rosbags_reads_every_value(bag):
    with AnyReader([bag]) as reader:
        assert reader.message_count == 11
        assert (reader.start_time, reader.end_time) == (BEGIN, BEGIN + 90_000_000 + 1)
        by_topic = {connection.topic: connection for connection in reader.connections}
        assert {name: (c.msgtype, c.msgcount) for name, c in by_topic.items()} == {
            "/cmd_vel": (TWIST, 10),
            "/robot_description": (STRING, 1),
        }
        # rosbags has compared this with the hash it computes itself.
        assert by_topic["/cmd_vel"].digest == MessageDefinitions().type_hash(TWIST)
        assert by_topic["/robot_description"].ext.offered_qos_profiles[0].durability == QosDurability.TRANSIENT_LOCAL
        assert len(by_topic["/cmd_vel"].ext.offered_qos_profiles) == 2
        read = [
            (time, reader.deserialize(data, connection.msgtype).linear.x)
            for connection, time, data in reader.messages([by_topic["/cmd_vel"]])
        ]
        assert read == [(BEGIN + index * 10_000_000, float(index)) for index in range(10)]


def test_every_field_of_metadata_yaml(bag):
    none = {"sec": 9223372036, "nsec": 854775807}
    profile = {
        "history": "unknown", "depth": 0, "reliability": "reliable", "durability": "transient_local",
        "deadline": none, "lifespan": none, "liveliness": "automatic", "liveliness_lease_duration": none,
        "avoid_ros_namespace_conventions": False,
    }  # fmt: skip
    content = yaml.safe_load((bag / "metadata.yaml").read_text())
    topics = content["rosbag2_bagfile_information"].pop("topics_with_message_count")
    times = {"starting_time": {"nanoseconds_since_epoch": BEGIN}, "duration": {"nanoseconds": 90_000_000}}
    assert content == {
        "rosbag2_bagfile_information": {
            "version": 9, "storage_identifier": "mcap", **times, "message_count": 11,
            "compression_format": "", "compression_mode": "", "relative_file_paths": ["run_0.mcap"],
            "files": [{"path": "run_0.mcap", **times, "message_count": 11}],
            "custom_data": {"lost_messages": "3"}, "ros_distro": "jazzy",
        }
    }  # fmt: skip
    assert [topic["message_count"] for topic in topics] == [10, 1]
    assert topics[1]["topic_metadata"] == {
        "name": "/robot_description", "type": STRING, "serialization_format": "cdr", "offered_qos_profiles": [profile],
        "type_description_hash": MessageDefinitions().type_hash(STRING),
    }  # fmt: skip
    assert sorted(path.name for path in bag.iterdir()) == ["metadata.yaml", "run_0.mcap"]


def test_a_type_that_is_not_installed_is_kept_without_a_schema(tmp_path):
    writer = BagWriter(tmp_path / "parents" / "are made" / "run", MessageDefinitions([tmp_path]))
    writer.write(writer.add_topic("/a", "my_msgs/msg/A"), b"\0\1\0\0abc", BEGIN, BEGIN)
    writer.add_topic("/hashed", TWIST, [Qos()], "RIHS01_77")
    writer.close()
    with writer.path.open("rb") as stream:
        ((schema, channel, message),) = make_reader(stream).iter_messages()
    assert (schema.name, schema.encoding, schema.data) == ("my_msgs/msg/A", "", b"")
    assert (channel.topic, message.data) == ("/a", b"\0\1\0\0abc")
    # The hash that publishers offer goes before the installed one.
    assert [topic.type_hash for topic in metadata.read(writer.folder).topics] == ["", "RIHS01_77"]


def test_the_disk_is_watched(tmp_path):
    writer = BagWriter(tmp_path / "run")
    writer.check_disk(0)
    with pytest.raises(BagWriteError, match=r"recording ends: .* bytes free: must be >= 1125899906842624"):
        writer.check_disk(2**50)
    assert not writer.closed
    writer.path.rename(tmp_path / "moved")
    with pytest.raises(BagWriteError, match="has gone while it was written"):
        writer.check_disk(0)
    writer.close()


def test_what_cannot_be_created_is_refused_and_leaves_nothing(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "file").write_text("")
    with pytest.raises(BagWriteError, match=r"run exists already: choose another name for the bag$"):
        BagWriter(tmp_path / "run")
    assert not list((tmp_path / "run").iterdir())
    for parent in (tmp_path / "file", Path("/proc/none")):
        with pytest.raises(BagWriteError, match=r"cannot create the bag .*: \w") as error:
            BagWriter(parent / "run")
        assert "\n" not in str(error.value)


def test_a_new_bag_and_files_beside_it_appear_together(tmp_path):
    with new_bag(tmp_path / "run") as writer:
        writer.write(writer.add_topic("/text", STRING), string("a"), 5, 5)
        (writer.folder / "notes.txt").write_text("x")
        assert not (tmp_path / "run").exists()
    assert sorted(one.name for one in (tmp_path / "run").iterdir()) == ["metadata.yaml", "notes.txt", "run_0.mcap"]
    assert metadata.read(tmp_path / "run").message_count == 1
    assert [one.name for one in tmp_path.iterdir()] == ["run"]
