"""Parameters of the recorder and the replay node. Names that rosbag2 has, too, have the same meaning there."""

from __future__ import annotations

import functools
from typing import Annotated, NamedTuple

from diffbot_bag.topic_selection import check_regex
from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import Spec

MIN_SIZE = 64 * 1024
"""[bytes] smallest limit of a file's size"""
MIN_DURATION = 0.1
"""[s] smallest limit of a file's duration"""
_MAX_TIME = 9e9
"""[s] rounded largest time since 1970 that fits into 64 bits as nanoseconds"""
MIN_RATE, MAX_RATE = 1e-6, 1e6
_fixed = functools.partial(Spec, read_only=True)
"""Spec of a parameter that cannot be changed while the node runs."""


class RecorderConfig(NamedTuple):
    """Configuration of the recorder."""

    uri: Annotated[str, _fixed("folder of the bag; empty: rosbag2_<date and time>")] = ""
    topics: Annotated[tuple[str, ...], _fixed("topics to record; all topics if topics and regex are empty")] = ()
    regex: Annotated[str, _fixed("regular expression; topics whose whole name matches are recorded, too")] = ""
    exclude_topics: Annotated[tuple[str, ...], _fixed("topics to exclude")] = ()
    exclude_regex: Annotated[str, _fixed("regular expression; topics whose whole name matches are excluded")] = ""
    include_hidden_topics: Annotated[
        bool, _fixed("also record hidden topics, which have a part that begins with _")
    ] = False
    qos_profile_overrides_path: Annotated[
        str, _fixed("YAML file with the QoS of subscriptions by topic, in rosbag2's format; empty: none")
    ] = ""
    start_paused: Annotated[bool, _fixed("record only latched topics until ~/resume is called")] = False
    record_parameters: Annotated[bool, _fixed("request the parameters of all nodes and attach them to the bag")] = True
    max_bag_size: Annotated[
        int, _fixed("size at which a file ends and the next one begins; 0: no limit, else >= 65536", "bytes", 0, 2**50)
    ] = 0
    max_bag_duration: Annotated[
        float, _fixed("duration after which a file ends; 0: no limit, else >= 0.1", "s", 0.0, 1e6)
    ] = 0.0
    max_bag_files: Annotated[
        int, _fixed("number of files to keep; older files are deleted; 0: keep all", minimum=0, maximum=1_000_000)
    ] = 0
    flush_period: Annotated[
        float,
        _fixed(
            "time between two flushes to the disk; a crash loses at most the messages of this time and of one flush",
            "s",
            0.05,
            60.0,
        ),
    ] = 0.25
    max_cache_size: Annotated[
        int, _fixed("size of messages in memory that wait for the disk or for the first /clock", "bytes", 2**20, 2**36)
    ] = 100 * 1024**2
    compression: Annotated[str, _fixed("compression of chunks", choices=("zstd", "lz4", "none"))] = "zstd"

    def check(self) -> None:
        """Raise InvalidValueError if a regular expression is invalid, or if files would be very short."""
        check_regex(regex=self.regex, exclude_regex=self.exclude_regex)
        if 0 < self.max_bag_size < MIN_SIZE:
            raise InvalidValueError("max_bag_size", self.max_bag_size, f"0 or >= {MIN_SIZE}")
        if 0.0 < self.max_bag_duration < MIN_DURATION:
            raise InvalidValueError("max_bag_duration", self.max_bag_duration, f"0 or >= {MIN_DURATION:g}")


class ReplayConfig(NamedTuple):
    """Configuration of the replay node."""

    uri: Annotated[str, _fixed("folder of the bag, or an MCAP file")] = ""
    bags: Annotated[tuple[str, ...], _fixed("more bags to merge with the first one by log time")] = ()
    topics: Annotated[tuple[str, ...], _fixed("topics to play; all topics if topics and regex are empty")] = ()
    regex: Annotated[str, _fixed("regular expression; topics whose whole name matches are played, too")] = ""
    exclude_topics: Annotated[tuple[str, ...], _fixed("topics to exclude")] = ()
    exclude_regex: Annotated[str, _fixed("regular expression; topics whose whole name matches are excluded")] = ""
    qos_profile_overrides_path: Annotated[
        str, _fixed("YAML file with the QoS of publishers by topic, in rosbag2's format; empty: none")
    ] = ""
    rate: Annotated[float, Spec("speed, as a multiple of the recorded speed", minimum=MIN_RATE, maximum=MAX_RATE)] = 1.0
    as_fast_as_possible: Annotated[
        bool, _fixed("ignore the rate, and send as fast as reliable subscribers acknowledge")
    ] = False
    seek: Annotated[
        float,
        Spec("each change jumps to this time after the bag's first message; negative: no jump", "s", -1.0, _MAX_TIME),
    ] = -1.0
    skip_gaps: Annotated[
        bool, Spec("skip gaps of more than a minute without messages, such as at a jump of the robot's clock")
    ] = False
    start_offset: Annotated[float, _fixed("begin at this time after the bag's first message", "s", 0.0, _MAX_TIME)] = (
        0.0
    )
    playback_duration: Annotated[
        float, _fixed("duration to play in bag time; negative: all", "s", -1.0, _MAX_TIME)
    ] = -1.0
    loop: Annotated[bool, _fixed("repeat the replay until it is stopped")] = False
    start_paused: Annotated[bool, _fixed("wait until ~/resume or ~/play_next is called")] = False
    disable_keyboard_controls: Annotated[bool, _fixed("ignore the keys of the terminal")] = False
    clock: Annotated[float, _fixed("frequency of /clock; 0: do not publish /clock", "Hz", 0.0, 10_000.0)] = 0.0
    wait_timeout: Annotated[
        float, _fixed("longest wait until every topic has a subscriber; 0: do not wait", "s", 0.0, 86400.0)
    ] = 1.0

    def check(self) -> None:
        """Raise InvalidValueError if a regular expression is invalid."""
        check_regex(regex=self.regex, exclude_regex=self.exclude_regex)
