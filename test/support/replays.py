"""Replays in tests: a clock that a test advances, bags as the mcap library and rosbags write them."""

import heapq
import itertools

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

BEGIN = 1_700_000_000_000_000_000
MS = 1_000_000
STORE = get_typestore(Stores.ROS2_JAZZY)
POINT = "geometry_msgs/msg/Point"
LATCHED = """\
- history: keep_last
  depth: 1
  reliability: reliable
  durability: transient_local
  deadline: {sec: 0, nsec: 0}
  lifespan: {sec: 0, nsec: 0}
  liveliness: automatic
  liveliness_lease_duration: {sec: 0, nsec: 0}
  avoid_ros_namespace_conventions: false
"""


class FakeClock:
    """Steady time that passes only in waiting, at once; scripted actions happen when their times come."""

    def __init__(self):
        self.time = 0
        self._script = []
        self._number = itertools.count()

    def at(self, time, action):
        """Call ``action`` at ``time`` [ns]; of equal times, those given first come first."""
        heapq.heappush(self._script, (time, next(self._number), action))

    def now(self):
        return self.time

    def sleep_until(self, target):
        while self._script and self._script[0][0] <= target:
            self._act()
        self.time = max(self.time, target)

    def wait(self, _condition, duration):
        if self._script and (duration is None or self._script[0][0] <= self.time + duration):
            self._act()
        elif duration is None:
            raise AssertionError("waits for something that never comes")
        else:
            self.time += duration

    def _act(self):
        time, _, action = heapq.heappop(self._script)
        self.time = max(self.time, time)
        action()


def point(x):
    return bytes(STORE.serialize_cdr(STORE.types[POINT](x=float(x), y=0.0, z=0.0), POINT))


def write_mcap(path, messages, compression=CompressionType.ZSTD, latched=(), kind=POINT):
    """Write messages (topic, log time, data) in chunks of 1 kB, in the layout of rosbag2."""
    with path.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=1000, compression=compression)
        writer.start(profile="ros2")
        definition, _ = STORE.generate_msgdef(kind, ros_version=2)
        schema = writer.register_schema(kind, "ros2msg", definition.encode())
        channels = {}
        for topic, time, data in messages:
            if topic not in channels:
                qos = {"offered_qos_profiles": LATCHED if topic in latched else "", "topic_type_hash": ""}
                channels[topic] = writer.register_channel(topic, "cdr", schema, qos)
            writer.add_message(channels[topic], time, data, time)
        writer.finish()
    return path


def write_rosbags(folder, messages, kind=POINT):
    """Write messages (topic, log time, data) with rosbags."""
    with RosbagsWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for topic, time, data in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], time, data)
    return folder
