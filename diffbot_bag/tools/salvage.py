"""Copy what is intact of one MCAP file, whatever state it is in, to a complete file."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet
from typing import BinaryIO, NamedTuple

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Header, Metadata

from diffbot_bag.bag.metadata import HASH_KEY, QOS_KEY, RECORD_NAME, TEXT_KEY, Topic
from diffbot_bag.bag.qos import load_profiles
from diffbot_bag.mcap.attachments import blocks_of, verified_attachment
from diffbot_bag.mcap.chunks import BagLimits
from diffbot_bag.mcap.format import DAMAGE, MAGIC, MAX_TIME, RECORD, McapSummary, read_summary
from diffbot_bag.mcap.output import OWN_HEADER
from diffbot_bag.mcap.scan import ChunkPiece, Gap, Piece, RecordScan
from diffbot_bag.mcap.whole_chunk import Entries, frame_chunk
from diffbot_bag.tools.definitions import Definitions, definitions_in
from diffbot_bag.tools.loose_chunk import LooseChunk, read_loosely
from diffbot_bag.tools.loss import UNKNOWN, Loss, LossCounter, Span
from diffbot_bag.tools.output_file import CHANNEL_SIZE, OutputFile
from diffbot_core.bounded_yaml import load_yaml
from diffbot_core.errors import DiffbotError

Described = tuple[AbstractSet[int], AbstractSet[int]]
"""Numbers of schemas and of channels."""
NOTHING: Described = (frozenset(), frozenset())


class Salvaged(NamedTuple):
    """What was saved of a file; times in [ns]."""

    topics: list[Topic]
    start: int
    end: int
    message_count: int
    custom_data: dict[str, str]
    """Of the file's own metadata record."""
    ros_distro: str
    loss: Loss


class Salvage:
    """Copies one file."""

    def __init__(self, source: BinaryIO, size: int, target: BinaryIO, limits: BagLimits) -> None:
        """Read what the source of ``size`` [bytes] says of itself at its beginning and its end.

        Raises:
            DiffbotError: if it is not an MCAP file.
            OSError: as all methods, if a file cannot be read or written.
        """
        self._source, self._limits = source, limits
        self._size = size
        self._summary = self._read_summary()
        end = None if self._summary is None else self._summary.start
        self._scan = RecordScan(source, size, limits, end)
        self._loss = LossCounter(self._summary)
        summary = self._summary
        records = [] if summary is None else [*summary.schemas.values(), *summary.channels.values()]
        self._definitions = Definitions(records, self._look_ahead)
        self._copy = OutputFile(target, self._header())
        self._at = len(MAGIC)
        self._unverified = self._beyond = 0
        self._custom_data: dict[str, str] = {}
        self._ros_distro = ""

    def _read_summary(self) -> McapSummary | None:
        try:
            return read_summary(self._source, self._size)
        except (*DAMAGE, DiffbotError):
            return None

    def _header(self) -> Header:
        first = next(self._scan.pieces(), None)
        self._source.seek(0)
        if self._source.read(len(MAGIC)) != MAGIC and (first is None or isinstance(first, Gap)):
            raise DiffbotError("is not an MCAP file")
        if isinstance(first, Piece) and first.opcode == Opcode.HEADER:
            header: Header = first.record()
            return header
        return OWN_HEADER

    def _look_ahead(self) -> list[Piece | ChunkPiece | Gap]:
        found = RecordScan(self._source, self._size, self._limits).pieces(self._at)
        return [piece for piece in found if definitions_in(piece)]

    def run(self, progress: Callable[[int], None]) -> Salvaged:
        """Copy the file, but for its end; ``progress`` is called with [bytes] read.

        Raises:
            DiffbotError: if the file unpacks to more than the limits allow.
        """
        is_cut = self._summary is None
        for piece in self._scan.pieces():
            if isinstance(piece, Gap):
                self._take_gap(piece)
            else:
                try:
                    self._save(piece)
                except DAMAGE as error:
                    opcode = Opcode.CHUNK if isinstance(piece, ChunkPiece) else piece.opcode
                    self._loss.gap(Gap(piece.offset, piece.end, str(error), opcode))
            progress(piece.end - self._at)
            self._at = piece.end
        if self._summary is not None:
            for number in self._summary.channels:
                self._define(number)
        self._copy.end_chunk()
        progress(self._size - self._at)
        loss = self._loss.loss(self._copy.counts, self._topic_name, is_cut=is_cut, unverified=self._unverified)
        return Salvaged(
            topics=self._topics(),
            start=self._copy.start,
            end=self._copy.end,
            message_count=self._copy.message_count,
            custom_data=self._custom_data,
            ros_distro=self._ros_distro,
            loss=loss._replace(
                doubtful=tuple(sorted(self._definitions.doubtful)),
                without_qos=tuple(sorted(self._definitions.without_qos)),
                unknown=tuple(sorted(self._definitions.unknown)),
                beyond=self._beyond,
            ),
        )

    def finish(self, record: Mapping[str, str]) -> None:
        """Write the metadata record, the index and the end of the new file, and close it."""
        self._copy.add_metadata(RECORD_NAME, record)
        self._copy.finish()

    def _save(self, piece: Piece | ChunkPiece) -> None:
        described = self._definitions.take(definitions_in(piece))
        if isinstance(piece, ChunkPiece):
            entries = piece.indexes.entries
            for number in sorted(described[1] | entries.keys()):
                self._define(number, described if entries else NOTHING)
            if entries and piece.chunk.message_end_time > MAX_TIME:
                self._beyond += sum(len(found) // 2 for found in entries.values())
                self._beyond -= self._save_rows(piece.data, entries, 0, MAX_TIME)
            elif entries:
                self._copy.add_chunk(frame_chunk(piece.chunk, entries))
                self._loss.saved_chunk(piece.offset, piece.chunk.message_start_time, piece.chunk.message_end_time)
        elif piece.opcode == Opcode.MESSAGE:
            message = piece.record()
            if message.log_time > MAX_TIME:
                self._beyond += 1
                return
            self._define(message.channel_id)
            self._copy.write([(message.log_time, message.channel_id, piece.content[CHANNEL_SIZE:])])
            self._loss.saved_message(message.log_time)
        elif piece.opcode == Opcode.CHANNEL:
            for number in described[1]:
                self._define(number)
        elif piece.opcode == Opcode.MESSAGE_INDEX:
            self._loss.message_index(piece)
        elif piece.opcode == Opcode.METADATA:
            self._save_metadata(piece.record())
        elif piece.opcode == Opcode.ATTACHMENT:
            index = verified_attachment(self._source, piece.offset, piece.end)
            self._copy.copy_record(index, blocks_of(self._source, index.offset, index.length))

    def _define(self, number: int, in_chunk: Described = NOTHING) -> None:
        """Describe a channel; ``in_chunk``: numbers of the schemas and channels that the next chunk describes."""
        if number in self._copy.channels:
            return
        schema, channel = self._definitions.channel(number)
        schemas, channels = in_chunk
        has_schema = schema is None or schema.id in schemas or schema.id in self._copy.schemas
        inside = has_schema and number in channels
        if schema is not None:
            self._copy.add_schema(schema, in_chunk=inside)
        self._copy.add_channel(channel, in_chunk=inside)

    def _save_metadata(self, record: Metadata) -> None:
        if record.name != RECORD_NAME:
            self._copy.add_metadata(record.name, record.metadata)
            return
        try:
            content = load_yaml(record.metadata.get(TEXT_KEY, ""), RECORD_NAME) or {}
            custom = content.get("custom_data") or {}
            self._custom_data |= {str(name): str(value) for name, value in custom.items()}
            self._ros_distro = str(content.get("ros_distro") or self._ros_distro)
        except (DiffbotError, AttributeError):
            raise McapError("a metadata record that is not that of rosbag2") from None

    def _take_gap(self, gap: Gap) -> None:
        head = UNKNOWN
        is_chunk = gap.opcode == Opcode.CHUNK
        loose = read_loosely(self._source, self._size, gap.offset, gap.end, self._limits) if is_chunk else None
        if loose:
            head = Span(loose.start, loose.end)
            if gap.is_cut:
                self._save_cut(loose)
                head = Span(self._loss.last or loose.start, loose.end)
            else:
                self._definitions.take_doubtful(loose.indexes.definitions)
        self._loss.gap(gap, head)

    def _save_cut(self, loose: LooseChunk) -> None:
        """Save the complete messages at the beginning of the chunk within which the file ends."""
        with contextlib.suppress(*DAMAGE):
            self._definitions.take(loose.indexes.definitions)
        last = min(loose.end, MAX_TIME)
        self._unverified = self._save_rows(loose.data, loose.indexes.entries, loose.start, last)

    def _save_rows(self, data: bytes, entries: Entries, first: int, last: int) -> int:
        """Save the messages of a chunk's data between two log times [ns]; return their number."""
        found = [
            (at, channel, time)
            for channel, flat in entries.items()
            for time, at in zip(flat[::2], flat[1::2], strict=True)
            if first <= time <= last
        ]
        for at, channel, time in sorted(found):
            _, length = RECORD.unpack_from(data, at)
            content = at + RECORD.size
            self._define(channel)
            self._copy.write([(time, channel, data[content + CHANNEL_SIZE : content + length])])
            self._loss.saved_message(time)
        return len(found)

    def _topic_name(self, number: int) -> str:
        return self._definitions.channel(number)[1].topic

    def _topics(self) -> list[Topic]:
        found = []
        for number, channel in self._copy.channels.items():
            schema = self._copy.schemas.get(channel.schema_id)
            found.append(
                Topic(
                    name=channel.topic,
                    type=schema.name if schema else "",
                    type_hash=channel.metadata.get(HASH_KEY, ""),
                    qos=load_profiles(channel.metadata.get(QOS_KEY, "")),
                    message_count=self._copy.counts[number],
                )
            )
        return found
