"""Bags as other makers write and read them, in rosbag2's layout: by the mcap library in many chunks, by rosbags."""

import struct
from contextlib import contextmanager, suppress

from mcap.exceptions import EndOfFile
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Qos as RosbagsQos
from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
BEGIN = 1_700_000_000_000_000_000
POINT, STRING = "geometry_msgs/msg/Point", "std_msgs/msg/String"
COMPRESSIONS = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}


def definition(kind):
    """Text of a message type by rosbags."""
    return STORE.generate_msgdef(kind, ros_version=2)[0].encode()


def point(x):
    return bytes(STORE.serialize_cdr(STORE.types[POINT](x=float(x), y=0.0, z=0.0), POINT))


def string(text):
    return bytes(STORE.serialize_cdr(STORE.types[STRING](data=text), STRING))


@contextmanager
def mcap_writing(stream, topics, definitions=None, chunk_size=1000, compression="zstd", **options):
    """Give the mcap library's writer of a file and the channel of each topic, of a type and with metadata.

    Without ``definitions``, the text of each type is that of rosbags; ``options`` are those of the library's writer.
    """
    writer = Writer(stream, chunk_size=chunk_size, compression=COMPRESSIONS[compression], **options)
    writer.start("ros2", "somebody's recorder")
    texts = {kind: definitions[kind] if definitions else definition(kind) for kind, _ in topics.values()}
    schemas = {kind: writer.register_schema(kind, "ros2msg", text) for kind, text in texts.items()}
    register = writer.register_channel
    yield writer, {topic: register(topic, "cdr", schemas[kind], facts) for topic, (kind, facts) in topics.items()}
    writer.finish()


def write_mcap(path, topics, messages, definitions=None, **options):
    """Write topic, log time and data of each message, and maybe publish time and sequence, see mcap_writing."""
    with path.open("wb") as stream, mcap_writing(stream, topics, definitions, **options) as (writer, channels):
        for topic, time, data, *more in messages:
            writer.add_message(channels[topic], time, data, *(more or [time]))
    return path


def write_rosbags(folder, messages, offers=None):
    """Write topic, log time, type and data of each message with rosbags; ``offers`` has the QoS by topic."""
    with RosbagsWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for topic, time, kind, data in messages:
            if topic not in connections:
                qos = [rosbags_qos(one) for one in (offers or {}).get(topic, ())]
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE, offered_qos_profiles=qos)
            writer.write(connections[topic], time, data)
    return folder


def read(path, raw=False):
    """Return (log time, message) of each topic of a bag, as rosbags reads them; ``raw``: their bytes (CDR)."""
    found = {}
    with AnyReader([path], default_typestore=STORE) as reader:
        for connection, time, data in reader.messages():
            message = bytes(data) if raw else reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((time, message))
    return found


def unfinished(path):
    """Return the whole messages in a file that may have no end yet, or not be there."""
    found = []
    # The library raises either error, by where the end of what is written comes: within a number, or before it.
    with suppress(EndOfFile, struct.error, FileNotFoundError), path.open("rb") as stream:
        for record in StreamReader(stream).records:
            if isinstance(record, Message):
                found.append(record)
    return found


def rosbags_qos(qos):
    durability = QosDurability.TRANSIENT_LOCAL if qos.is_latched else QosDurability.VOLATILE
    forever = QosTime(9223372036, 854775807)
    return RosbagsQos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, durability, forever, forever, QosLiveliness.AUTOMATIC,
        forever, False,
    )  # fmt: skip
