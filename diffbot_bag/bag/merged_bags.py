"""Several bags as one: their topics together, their messages in the order of log time."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

from diffbot_bag.bag.metadata import Topic
from diffbot_bag.bag.reader import BagReader, RawMessage
from diffbot_bag.mcap.chunks import BagLimits
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.foreign_files import shown


class MergedBags:
    """Open bags, read as one. Topics of equal name are one topic."""

    def __init__(self, paths: Sequence[Path], limits: BagLimits | None = None) -> None:
        """Open the bags.

        Args:
            paths: folders or MCAP files, each once.
            limits: how much each file may unpack to; default: those of BagLimits.

        Raises:
            DiffbotError: if one cannot be read, is given twice, or has a topic with another type than an earlier one.
        """
        self.paths = tuple(path.expanduser() for path in paths)
        self._readers: list[BagReader] = []
        with ExitStack() as opened:
            for path in self.paths:
                self._check_new(path)
                reader = BagReader(path, limits)
                opened.callback(reader.close)
                self._readers.append(reader)
            self.topics = self._merged_topics()
            opened.pop_all()

    def _check_new(self, path: Path) -> None:
        if any(reader.path.exists() and path.exists() and reader.path.samefile(path) for reader in self._readers):
            raise InvalidValueError("bags", str(path), "a bag that is not given already")

    def _merged_topics(self) -> dict[str, Topic]:
        """Return the topics by name; counts are summed, and the offered QoS are those of all publishers of all bags."""
        merged: dict[str, Topic] = {}
        first_in: dict[str, BagReader] = {}
        for reader in self._readers:
            for name, topic in reader.topics.items():
                known = merged.get(name)
                if known is None:
                    merged[name], first_in[name] = topic, reader
                    continue
                if known.type != topic.type:
                    raise DiffbotError(
                        f"{shown(name)} is {shown(known.type)} in {first_in[name].path}"
                        f" and {shown(topic.type)} in {reader.path}"
                    )
                merged[name] = known._replace(
                    qos=known.qos + topic.qos, message_count=known.message_count + topic.message_count
                )
        return merged

    @property
    def warnings(self) -> list[str]:
        """What is to be said of bags that were not finished."""
        return [reader.warning for reader in self._readers if reader.warning]

    def __str__(self) -> str:
        """Return the paths, separated by blanks."""
        return " ".join(map(str, self.paths))

    def close(self) -> None:
        """Close the files."""
        for reader in self._readers:
            reader.close()

    @property
    def start(self) -> int:
        """Time [ns] of the first message; 0 if there is none."""
        return min((reader.start for reader in self._readers if reader.message_count), default=0)

    @property
    def end(self) -> int:
        """Time [ns] of the last message; 0 if there is none."""
        return max((reader.end for reader in self._readers if reader.message_count), default=0)

    def messages(self, topics: Iterable[str], start: int, end: int) -> Iterator[RawMessage]:
        """Iterate over the bytes in the order of log time; of equal times, those of the bag given first come first.

        Args:
            topics: names to keep.
            start: [ns] earliest log time, itself included.
            end: [ns] latest log time, itself included.

        Raises:
            DiffbotError: if a file turns out to be damaged.
        """
        names = tuple(topics)
        streams = [reader.messages(names, start, end) for reader in self._readers]
        return streams[0] if len(streams) == 1 else heapq.merge(*streams, key=lambda message: message.log_time)

    def last_before(self, time: int, topics: Iterable[str]) -> list[RawMessage]:
        """Return the last message before ``time`` [ns] of each of these topics in each bag, in the order of log time.

        One of each bag, since /tf_static of two robots is one topic with two last messages.

        Raises:
            DiffbotError: if a file turns out to be damaged.
        """
        names = tuple(topics)
        found = [message for reader in self._readers for message in reader.last_before(time, names)]
        return sorted(found, key=lambda message: message.log_time)
