"""Read a new file with two readers that share no code but the decompression, and compare what they find."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import breakup_chunk
from mcap.summary import Summary

from diffbot_bag.mcap.chunks import BagLimits
from diffbot_bag.mcap.file import McapFile
from diffbot_bag.mcap.format import DAMAGE, RECORD
from diffbot_core.errors import DiffbotError

_STEP = 1000
"""Messages between two calls of progress."""


class ResultError(DiffbotError):
    """A new file does not hold what was written to it."""


def check_result(path: Path, expected: Mapping[str, int], limits: BagLimits, progress: Callable[[int], None]) -> None:
    """Read all of a file with McapFile and with the reader of the mcap library.

    Args:
        path: the file.
        expected: messages by topic.
        limits: how much it may unpack to.
        progress: called with the messages read since the last call, by either reader.

    Raises:
        ResultError: if a reader fails, or does not find as many messages on each topic.
    """
    want = {topic: count for topic, count in expected.items() if count}
    for name, read in (("diffbot", _by_diffbot), ("mcap", _by_mcap)):
        try:
            found = read(path, limits, progress)
        except (*DAMAGE, DiffbotError, OSError) as error:
            raise ResultError(f"the result cannot be read by {name}: {error}") from error
        if found != want:
            raise ResultError(
                f"the result is wrong: {name} reads {found.total()} messages of {len(found)} topics,"
                f" written were {sum(want.values())} of {len(want)}"
            )


def _by_diffbot(path: Path, limits: BagLimits, progress: Callable[[int], None]) -> Counter[str]:
    file = McapFile(path, limits)
    try:
        if file.unfinished:
            raise ResultError(file.unfinished)
        topics = {topic.name: topic.message_count for topic in file.topics()}
        found = _counted((topic for _, topic, *_ in file.rows(topics)), progress)
        if found.total() != file.message_count:
            raise ResultError(f"its index names {file.message_count} messages, and it has {found.total()}")
        return found
    finally:
        file.close()


def _by_mcap(path: Path, _limits: BagLimits, progress: Callable[[int], None]) -> Counter[str]:
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        if summary is None or summary.statistics is None:
            raise ResultError("no index")
        found = _counted(_topics_by_mcap(stream, summary), progress)
        if found.total() != summary.statistics.message_count:
            raise ResultError(
                f"its index names {summary.statistics.message_count} messages, and it has {found.total()}"
            )
        return found


def _topics_by_mcap(stream: BinaryIO, summary: Summary) -> Iterator[str]:
    # McapReader.iter_messages holds either all messages of the file in memory, or sorts them.
    for index in summary.chunk_indexes:
        stream.seek(index.chunk_start_offset + RECORD.size)
        for record in breakup_chunk(Chunk.read(ReadDataStream(stream)), validate_crc=True):
            if isinstance(record, Message):
                yield summary.channels[record.channel_id].topic


def _counted(topics: Iterable[str], progress: Callable[[int], None]) -> Counter[str]:
    found: Counter[str] = Counter()
    for number, topic in enumerate(topics, 1):
        found[topic] += 1
        if number % _STEP == 0:
            progress(_STEP)
    return found
