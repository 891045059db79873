"""Schemas and channels of a damaged file, from whatever place in it still has them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding

from diffbot_bag.bag.metadata import QOS_KEY
from diffbot_bag.bag.qos import load_profiles
from diffbot_bag.mcap.format import DAMAGE, MAX_INDEX
from diffbot_bag.mcap.scan import ChunkPiece, Gap, Piece, parse_record
from diffbot_core.errors import DiffbotError

Definition = tuple[int, bytes]
"""Opcode and content of a record that describes a schema or a channel."""


class Definitions:
    """Descriptions by number: those of intact chunks, then of the summary, then of damaged chunks."""

    def __init__(
        self,
        summary: Iterable[Any],
        look_ahead: Callable[[], Iterable[Piece | ChunkPiece | Gap]],
    ) -> None:
        """Begin with the records of the file's summary, if it is intact.

        Args:
            summary: its schemas and channels.
            look_ahead: iterates over the rest of the file, for channels that are used before they are described.
        """
        self._known: dict[tuple[type, int], Any] = {}
        self._summary = {(type(record), record.id): record for record in summary}
        self._doubtful: dict[tuple[type, int], Any] = {}
        self._look_ahead = look_ahead
        self._has_looked = False
        self._size = 0
        self.doubtful: set[str] = set()
        """Topics whose name and type come from a damaged chunk, and may be wrong themselves."""
        self.without_qos: set[str] = set()
        """Topics whose QoS cannot be read, and is left out."""
        self._found: dict[int, tuple[Schema | None, Channel]] = {}
        self.unknown: set[str] = set()
        """Made-up topics of channels that nothing describes any more."""

    def take(self, definitions: Iterable[Definition]) -> tuple[set[int], set[int]]:
        """Keep descriptions of an intact chunk; return the numbers of its schemas and channels.

        Raises:
            McapError, ValueError, ...: DAMAGE, if they contradict earlier ones or are none.
            DiffbotError: if all of them are larger than MAX_INDEX.
        """
        schemas: set[int] = set()
        channels: set[int] = set()
        for opcode, content in definitions:
            record = parse_record(opcode, content)
            key = (type(record), record.id)
            if key not in self._known:
                self._known[key] = record
                self._size += len(content)
            if self._known[key] != record:
                raise McapError(f"another description of {type(record).__name__} {record.id}")
            (schemas if isinstance(record, Schema) else channels).add(record.id)
        if self._size > MAX_INDEX:
            raise DiffbotError(f"descriptions of {self._size} bytes: must be <= {MAX_INDEX}")
        return schemas, channels

    def take_doubtful(self, definitions: Iterable[Definition]) -> None:
        """Keep what of the descriptions in a damaged chunk can be parsed."""
        for opcode, content in definitions:
            try:
                record = parse_record(opcode, content)
            except DAMAGE:
                continue
            self._doubtful.setdefault((type(record), record.id), record)

    def channel(self, number: int) -> tuple[Schema | None, Channel]:
        """Return a channel and its schema; a made-up topic if nothing describes the channel."""
        if number not in self._found:
            schema, channel = self._described(number)
            self._found[number] = schema, self._with_valid_qos(channel)
        return self._found[number]

    def _with_valid_qos(self, channel: Channel) -> Channel:
        try:
            load_profiles(channel.metadata.get(QOS_KEY, ""))
        except DiffbotError:
            self.without_qos.add(channel.topic)
            return replace(channel, metadata=channel.metadata | {QOS_KEY: ""})
        return channel

    def _described(self, number: int) -> tuple[Schema | None, Channel]:
        channel: Channel | None = self._find(Channel, number)
        if channel is None:
            channel = Channel(number, f"/unknown/channel_{number}", MessageEncoding.CDR, {}, 0)
            self.unknown.add(channel.topic)
        elif self._is_doubtful(Channel, number) or self._is_doubtful(Schema, channel.schema_id):
            self.doubtful.add(channel.topic)
        schema = self._find(Schema, channel.schema_id) if channel.schema_id else None
        if schema is None and channel.schema_id:
            schema = Schema(channel.schema_id, b"", "", "unknown")
            self.unknown.add(channel.topic)
        return schema, channel

    def _is_doubtful(self, kind: type, number: int) -> bool:
        key = (kind, number)
        return key in self._doubtful and key not in self._known and key not in self._summary

    def _find(self, kind: type, number: int) -> Any:
        key = (kind, number)
        if key not in self._known and key not in self._summary and not self._has_looked:
            self._has_looked = True
            for piece in self._look_ahead():
                self._take_ahead(piece)
        for source in (self._known, self._summary, self._doubtful):
            if key in source:
                return source[key]
        return None

    def _take_ahead(self, piece: Piece | ChunkPiece | Gap) -> None:
        for opcode, content in definitions_in(piece):
            try:
                record = parse_record(opcode, content)
            except DAMAGE:
                continue
            self._known.setdefault((type(record), record.id), record)


def definitions_in(piece: Piece | ChunkPiece | Gap) -> list[Definition]:
    """Return the descriptions in a piece of a file."""
    if isinstance(piece, ChunkPiece):
        return piece.indexes.definitions
    if isinstance(piece, Piece) and piece.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        return [(piece.opcode, piece.content)]
    return []
