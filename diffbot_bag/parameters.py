"""Parameters of the recorder and the replay node; names as in rosbag2 wherever the meaning is the same."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_bag.bag.writer import CHUNK_SIZE
from diffbot_bag.mcap.chunks import BagLimits
from diffbot_bag.replay.playback_clock import parse_remap
from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import Spec

MIN_DURATION = 0.1
"""[s] of a file"""
_MAX_TIME = 9e9
"""[s] since 1970, what 64 bits of nanoseconds hold"""
MIN_RATE, MAX_RATE = 1e-6, 1e6
MAX_BURST = 2**31 - 1


class RecorderConfig(NamedTuple):
    """What is recorded, where to, and how safely."""

    uri: Annotated[str, Spec("folder of the bag; empty: rosbag2_<date and time>", read_only=True)] = ""
    topics: Annotated[tuple[str, ...], Spec("topics to record; empty: all", read_only=True)] = ()
    regex: Annotated[str, Spec("record topics whose whole name matches, too", read_only=True)] = ""
    exclude_topics: Annotated[tuple[str, ...], Spec("topics to leave out", read_only=True)] = ()
    exclude_regex: Annotated[str, Spec("leave out topics whose whole name matches", read_only=True)] = ""
    include_hidden_topics: Annotated[bool, Spec("record topics with a part that begins with _", read_only=True)] = False
    topic_polling_interval: Annotated[
        float, Spec("time between two looks for new topics", "s", 0.01, 60.0, read_only=True)
    ] = 0.1
    flush_period: Annotated[
        float,
        Spec(
            "time between two flushes; a crash loses this and the flush's own time at most",
            "s",
            0.05,
            60.0,
            read_only=True,
        ),
    ] = 0.25
    fsync: Annotated[bool, Spec("a flush reaches the disk, so that it survives a power cut, too", read_only=True)] = (
        True
    )
    max_bag_size: Annotated[
        int, Spec("size at which a file ends and the next one begins; 0: no limit", "bytes", 0, 2**50, read_only=True)
    ] = 0
    max_bag_duration: Annotated[
        float, Spec("duration after which a file ends; 0: no limit, else >= 0.1", "s", 0.0, 1e6, read_only=True)
    ] = 0.0
    max_bag_files: Annotated[
        int,
        Spec("files that are kept, the oldest are deleted; 0: all", minimum=0, maximum=1000, read_only=True),
    ] = 0
    max_cache_size: Annotated[
        int,
        Spec("messages in memory that wait for the disk", "bytes", 2**20, 2**36, read_only=True),
    ] = 100 * 1024**2
    start_paused: Annotated[bool, Spec("record latched topics only until ~/resume", read_only=True)] = False
    qos_profile_overrides_path: Annotated[
        str, Spec("YAML file with the QoS of subscriptions by topic, as rosbag2's; empty: none", read_only=True)
    ] = ""
    record_parameters: Annotated[
        bool, Spec("ask all nodes for their parameters and attach them to the bag", read_only=True)
    ] = True
    chunk_size: Annotated[
        int, Spec("size of a chunk before compression", "bytes", 1024, 64 * 1024**2, read_only=True)
    ] = CHUNK_SIZE
    min_free_space: Annotated[
        int, Spec("recording ends with less space on the disk", "bytes", 0, 2**50, read_only=True)
    ] = 64 * 1024**2
    compression: Annotated[str, Spec("of the chunks", choices=("zstd", "lz4", "none"), read_only=True)] = "zstd"
    compression_level: Annotated[
        int, Spec("larger is smaller and slower; 0: the library's default", minimum=-7, maximum=19, read_only=True)
    ] = 1
    depth: Annotated[
        int,
        Spec(
            "messages per topic that may wait for the recorder",
            minimum=1,
            maximum=1_000_000,
            read_only=True,
        ),
    ] = 10_000
    max_held: Annotated[
        int,
        Spec(
            "messages kept until the first /clock, with use_sim_time",
            minimum=0,
            maximum=10_000_000,
            read_only=True,
        ),
    ] = 10_000

    def check(self) -> None:
        """Raise InvalidValueError if a limit of files would make each a handful of messages."""
        if 0 < self.max_bag_size < self.chunk_size:
            raise InvalidValueError("max_bag_size", self.max_bag_size, f"0 or >= chunk_size = {self.chunk_size}")
        if 0.0 < self.max_bag_duration < MIN_DURATION:
            raise InvalidValueError("max_bag_duration", self.max_bag_duration, f"0 or >= {MIN_DURATION:g}")


class ReplayConfig(NamedTuple):
    """Which part of a bag is played, how fast, and when it begins and ends."""

    uri: Annotated[str, Spec("folder of the bag, or an MCAP file", read_only=True)] = ""
    bags: Annotated[tuple[str, ...], Spec("more bags, merged with the first by log time", read_only=True)] = ()
    topics: Annotated[tuple[str, ...], Spec("topics to play; empty: all", read_only=True)] = ()
    regex: Annotated[str, Spec("play topics whose whole name matches, too", read_only=True)] = ""
    exclude_topics: Annotated[tuple[str, ...], Spec("topics to leave out", read_only=True)] = ()
    exclude_regex: Annotated[str, Spec("leave out topics whose whole name matches", read_only=True)] = ""
    remap: Annotated[tuple[str, ...], Spec("old:=new names, besides ROS's own remapping", read_only=True)] = ()
    qos_profile_overrides_path: Annotated[
        str, Spec("YAML file of topics and their QoS, as rosbag2's; empty: none", read_only=True)
    ] = ""
    rate: Annotated[float, Spec("speed", minimum=MIN_RATE, maximum=MAX_RATE)] = 1.0
    as_fast_as_possible: Annotated[
        bool, Spec("send as fast as reliable subscribers acknowledge, whatever the rate", read_only=True)
    ] = False
    max_unacknowledged: Annotated[
        int,
        Spec(
            "messages that may be unacknowledged with as_fast_as_possible, of all topics together",
            minimum=1,
            maximum=100_000,
            read_only=True,
        ),
    ] = 200
    seek: Annotated[
        float,
        Spec("each change jumps to this long after the bag's first message; negative: none", "s", -1.0, _MAX_TIME),
    ] = -1.0
    burst: Annotated[
        int, Spec("each change sends this many messages at once, while paused", minimum=0, maximum=MAX_BURST)
    ] = 0
    start_offset: Annotated[
        float, Spec("begin this long after the bag's first message", "s", 0.0, _MAX_TIME, read_only=True)
    ] = 0.0
    playback_duration: Annotated[
        float, Spec("play this much of the bag's time; negative: all", "s", -1.0, _MAX_TIME, read_only=True)
    ] = -1.0
    playback_until: Annotated[
        float,
        Spec("play until this time of the bag (since 1970); negative: all", "s", -1.0, _MAX_TIME, read_only=True),
    ] = -1.0
    loop: Annotated[bool, Spec("begin again at the end", read_only=True)] = False
    delay: Annotated[float, Spec("wait before each round", "s", 0.0, 86400.0, read_only=True)] = 0.0
    start_paused: Annotated[bool, Spec("wait for ~/resume or ~/play_next", read_only=True)] = False
    disable_keyboard_controls: Annotated[
        bool, Spec("ignore keys, which otherwise control a replay in a terminal", read_only=True)
    ] = False
    clock: Annotated[float, Spec("frequency of /clock; 0: none", "Hz", 0.0, 10_000.0, read_only=True)] = 0.0
    wait_for_topics: Annotated[
        tuple[str, ...],
        Spec("topics that need a subscriber before the start; empty: all played", read_only=True),
    ] = ()
    wait_timeout: Annotated[float, Spec("longest wait for subscribers; 0: none", "s", 0.0, 86400.0, read_only=True)] = (
        1.0
    )
    wait_acked_timeout: Annotated[
        float,
        Spec(
            "longest wait for reliable subscribers, at the end and before a loss; 0: forever, negative: none",
            "s",
            -1.0,
            86400.0,
            read_only=True,
        ),
    ] = 5.0
    max_compression_ratio: Annotated[
        float,
        Spec("what the chunks of a file beyond 64 MiB may unpack to, for their size", "-", 1.0, 1e6, read_only=True),
    ] = BagLimits().max_compression_ratio
    max_unpacked_size: Annotated[
        int,
        Spec("what chunks that overlap in time may unpack to", "bytes", 1024**2, 2**40, read_only=True),
    ] = BagLimits().max_unpacked_size
    read_ahead_queue_size: Annotated[int, Spec("messages read ahead", minimum=1, maximum=1_000_000, read_only=True)] = (
        1000
    )

    def check(self) -> None:
        """Raise InvalidValueError if a rule of ``remap`` is malformed."""
        parse_remap(self.remap)
