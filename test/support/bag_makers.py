"""Write and read bags with the mcap library, in many chunks, and with rosbags.

A row is (topic, log time [ns], data (CDR)), for the mcap library optionally with publish time and sequence number.
"""

import struct
from collections import Counter
from contextlib import contextmanager, suppress
from typing import NamedTuple

import yaml
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_typestore

from diffbot_bag.bag import BagReader
from diffbot_bag.definitions import type_hash
from diffbot_bag.info import info_of
from diffbot_bag.qos import Qos, dump_profiles

STORE = get_typestore(Stores.ROS2_JAZZY)
BEGIN, MS = 1_700_000_000_000_000_000, 1_000_000
POINT, STRING = "geometry_msgs/msg/Point", "std_msgs/msg/String"
LATCHED = Qos(durability="transient_local")
HASHES = {name: type_hash(name) for name in (POINT, STRING)}
COMPRESSIONS = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}
QOS = """\
- history: 1
  depth: 10
  reliability: {reliability}
  durability: {durability}
  deadline: {{sec: 9223372036, nsec: 854775807}}
  lifespan: {{sec: 9223372036, nsec: 854775807}}
  liveliness: 1
  liveliness_lease_duration: {{sec: 9223372036, nsec: 854775807}}
  avoid_ros_namespace_conventions: false
"""


def qos(reliability=1, durability=2, publishers=1):
    """Return the text of rosbag2 up to version 8, with numbers for policies; 1, 2: reliable, volatile."""
    return QOS.format(reliability=reliability, durability=durability) * publishers


def definition(kind):
    """Return the definition of a message type by rosbags."""
    return STORE.generate_msgdef(kind, ros_version=2)[0].encode()


def data_of(message):
    """Return the bytes (CDR) of (type, message)."""
    kind, content = message
    return bytes(STORE.serialize_cdr(content, kind))


def point(x):
    return data_of((POINT, STORE.types[POINT](x=float(x), y=0.0, z=0.0)))


def string(text):
    return data_of((STRING, STORE.types[STRING](data=text)))


@contextmanager
def mcap_writing(stream, kinds, offers=None, definitions=None, chunk_size=1000, compression="zstd", **options):
    """Yield the mcap library's writer of a file, and the channel of each topic.

    ``kinds`` are the types by topic. ``offers`` are QoS profiles or their text by topic; without offers the channels do
    not have metadata. ``definitions`` are the texts by type, by default from rosbags; ``options`` are of the library.
    """
    writer = Writer(stream, chunk_size=chunk_size, compression=COMPRESSIONS[compression], **options)
    writer.start("ros2", "somebody's recorder")
    texts = {kind: definitions[kind] if definitions else definition(kind) for kind in kinds.values()}
    schemas = {kind: writer.register_schema(kind, "ros2msg", text) for kind, text in texts.items()}
    channels = {}
    for topic, kind in kinds.items():
        offered = (offers or {}).get(topic, "")
        text = offered if isinstance(offered, str) else dump_profiles(offered)
        metadata = {} if offers is None else {"offered_qos_profiles": text, "topic_type_hash": HASHES.get(kind, "")}
        channels[topic] = writer.register_channel(topic, "cdr", schemas[kind], metadata)
    yield writer, channels
    writer.finish()


def write_mcap(path, rows, kinds=POINT, offers=None, **options):
    """Write a file with the mcap library, see mcap_writing; ``kinds`` may be one type for all topics."""
    if isinstance(kinds, str):
        rows = list(rows)
        kinds = dict.fromkeys((row[0] for row in rows), kinds)
    with path.open("wb") as stream, mcap_writing(stream, kinds, offers, **options) as (writer, channels):
        for topic, time, data, *more in rows:
            writer.add_message(channels[topic], time, data, *(more or [time]))
    return path


def write_folder(folder, rows, compression="zstd", files=1, custom_data=None, offers=None):
    """Write a folder of rosbag2 8 with the mcap library and divide the messages into ``files`` files.

    The rows are topic, log time, sequence number and (type, message).
    """
    folder.mkdir()
    kinds = {topic: kind for topic, _, _, (kind, _) in rows}
    offers = {topic: (offers or {}).get(topic, qos()) for topic in kinds}
    made = [(topic, time, data_of(message), time, sequence) for topic, time, sequence, message in rows]
    size = -(-len(made) // files)
    names = [f"{folder.name}_{number}.mcap" for number in range(files)]
    for number, name in enumerate(names):
        part = made[number * size : (number + 1) * size]
        write_mcap(folder / name, part, kinds, offers, compression=compression, chunk_size=20_000)
    start, end = (pick(row[1] for row in rows) for pick in (min, max))
    counts = Counter(topic for topic, *_ in rows)
    described = [
        {
            "topic_metadata": {
                "name": topic, "type": kind, "serialization_format": "cdr", "offered_qos_profiles": offers[topic],
                "type_description_hash": "",
            },
            "message_count": counts[topic],
        }
        for topic, kind in kinds.items()
    ]  # fmt: skip
    inner = {
        "version": 8, "storage_identifier": "mcap", "message_count": len(rows), "custom_data": custom_data,
        "duration": {"nanoseconds": end - start}, "starting_time": {"nanoseconds_since_epoch": start},
        "topics_with_message_count": described, "compression_format": "", "compression_mode": "",
        "relative_file_paths": names, "files": [], "ros_distro": "jazzy",
    }  # fmt: skip
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": inner}))
    return folder


def write_rosbags(folder, rows, kinds=POINT, offers=None):
    """Write rows with rosbags; ``kinds`` is one type or the types by topic, ``offers`` has the QoS by topic."""
    with RosbagsWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for topic, time, data, *_ in rows:
            if topic not in connections:
                kind = kinds if isinstance(kinds, str) else kinds[topic]
                offered = parse_qos(dump_profiles((offers or {}).get(topic, ())))
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE, offered_qos_profiles=offered)
            writer.write(connections[topic], time, data)
    return folder


def read(path, raw=False):
    """Return (log time, message) by topic, read by rosbags; ``raw``: bytes (CDR) instead of messages."""
    found = {}
    with AnyReader([path], default_typestore=STORE) as reader:
        for connection, time, data in reader.messages():
            message = bytes(data) if raw else reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((time, message))
    return found


class Fact(NamedTuple):
    """A message of a bag with all its fields in the file."""

    topic: str
    log_time: int
    publish_time: int
    sequence: int
    data: bytes
    type: str
    definition: bytes


def files_of(path):
    return sorted(path.glob("*.mcap"), key=lambda one: (len(one.name), one.name)) if path.is_dir() else [path]


def facts(path):
    """Return all messages by mcap's own reader, which verifies checksums; in the order of log time for each file."""
    found = []
    for file in files_of(path):
        with file.open("rb") as stream:
            for schema, channel, one in make_reader(stream, validate_crcs=True).iter_messages():
                times = one.log_time, one.publish_time
                found.append(Fact(channel.topic, *times, one.sequence, one.data, schema.name, schema.data))
    return found


def chunks_of(path):
    """Return the index entries of the chunks of a file, in the order of the file."""
    with path.open("rb") as stream:
        return sorted(make_reader(stream).get_summary().chunk_indexes, key=lambda one: one.chunk_start_offset)


def read_info(path, **options):
    with BagReader(path) as reader:
        return info_of(reader, **options)


def unfinished(path):
    """Return the complete messages in a file that may be unfinished or missing."""
    found = []
    # The error depends on the end of the file: within a number (struct.error) or before.
    with suppress(EndOfFile, struct.error, FileNotFoundError), path.open("rb") as stream:
        for record in StreamReader(stream).records:
            if isinstance(record, Message):
                found.append(record)
    return found
