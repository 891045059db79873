"""Replays in tests: a clock that a test advances, bags as the mcap library and rosbags write them."""

import heapq
import itertools

import bag_makers
from bag_makers import POINT
from foreign_bags import qos

MS = 1_000_000
LATCHED = qos(durability=1)


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


def write_mcap(path, messages, compression="zstd", latched=(), kind=POINT):
    """Write messages (topic, log time, data) in chunks of 1 kB, in the layout of rosbag2."""
    messages = list(messages)
    offers = {topic: LATCHED if topic in latched else "" for topic, _, _ in messages}
    topics = {topic: (kind, {"offered_qos_profiles": text, "topic_type_hash": ""}) for topic, text in offers.items()}
    return bag_makers.write_mcap(path, topics, messages, compression=compression)


def write_rosbags(folder, messages, kind=POINT):
    """Write messages (topic, log time, data) with rosbags."""
    return bag_makers.write_rosbags(folder, ((topic, time, kind, data) for topic, time, data in messages))
