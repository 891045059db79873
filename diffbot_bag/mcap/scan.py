"""Records of an MCAP file in the order of the file, without its index and across damaged places."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from typing import Any, BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Header, Message, Metadata, Schema

from diffbot_bag.mcap.chunks import SMALL, BagLimits, ChunkIndexes, index_messages, unpack_chunk
from diffbot_bag.mcap.format import CHUNK, DAMAGE, MAGIC, RECORD, SIZE, index_entries
from diffbot_core.errors import DiffbotError

_LONGEST_NAME = 4
"""of a compression"""
_MAX_OTHER = 64 * 2**20
"""[bytes] of a record that is neither chunk, message nor attachment"""
_FIRST_BLOCK, _BLOCK = 2**10, 2**20
"""[bytes] searched at once, at first and at most"""
_OVERLAP = 64
"""[bytes] more than what a pattern looks at"""
_CHUNK_PATTERN = re.compile(rb"\x06(?=.{5}\0\0\0.{28}(?:\x04\0\0\0zstd|\x03\0\0\0lz4|\0\0\0\0))", re.DOTALL)
_MESSAGE_PATTERN = re.compile(rb"\x05(?=.{4}\0{4})", re.DOTALL)
_CHAIN = 3
"""records in a row without a contradiction, to take the first one for a message"""
_CHAIN_COST = 64
"""[bytes] that reading the prefixes of a chain is counted as"""
_READERS: dict[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.DATA_END: DataEnd,
}
_OF_DATA = {*_READERS, Opcode.CHUNK, Opcode.MESSAGE, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT}
"""Opcodes of records that come before the summary."""
_PRIVATE = 0x80
"""The first opcode that is free for other uses; such records are skipped."""


class CutError(McapError):
    """A record goes on beyond the end of the file."""


class Piece(NamedTuple):
    """A valid record other than a chunk."""

    offset: int
    end: int
    opcode: int
    content: bytes
    """Without opcode and length; empty for an attachment."""

    def record(self) -> Any:
        """Return the record as an object of the mcap library."""
        return parse_record(self.opcode, self.content)


class ChunkPiece(NamedTuple):
    """A valid chunk."""

    offset: int
    end: int
    chunk: Chunk
    """As it is in the file, with its data packed; the times are those of the messages."""
    indexes: ChunkIndexes
    data: bytes
    """Unpacked."""
    is_exact: bool
    """False if opcode, length or times of the record were wrong, and only its data are intact."""


class Gap(NamedTuple):
    """Bytes that cannot be read."""

    offset: int
    end: int
    reason: str
    opcode: int = 0
    is_cut: bool = False
    """It is the last record, and the file ends within it."""


def parse_record(opcode: int, content: bytes) -> Any:
    """Return a record as an object of the mcap library.

    Raises:
        McapError, ValueError, struct.error, ...: DAMAGE, if the content is not exactly one such record.
    """
    if opcode == Opcode.MESSAGE:
        return Message.read(ReadDataStream(io.BytesIO(content)), len(content))
    record = _READERS[opcode].read(ReadDataStream(io.BytesIO(content)))
    builder = RecordBuilder()
    record.write(builder)
    written: bytes = builder.end()  # type: ignore[no-untyped-call]
    # The library reads strings that are shorter than announced, too.
    if written[RECORD.size :] != content:
        raise McapError(f"a record {type(record).__name__} of another length")
    return record


class RecordScan:
    """Iterates over the records between the magic bytes and the end of the data."""

    def __init__(self, stream: BinaryIO, size: int, limits: BagLimits, end: int | None = None) -> None:
        """Take the stream of a file.

        Args:
            stream: is moved by the iteration.
            size: [bytes] of the file.
            limits: how much the chunks may unpack to.
            end: [bytes] where the summary begins, if it is known; default: ``size``.
        """
        self._stream, self._limits = stream, limits
        self._size = size
        self._end = size if end is None else end
        self._has_chunks = self._has_messages = False
        # Bytes that the search for chunks may still verify: false ones could overlap each other.
        self._budget, self._work = SMALL + 8 * size, 0

    def pieces(self, start: int = len(MAGIC)) -> Iterator[Piece | ChunkPiece | Gap]:
        """Iterate over records and gaps, from the offset ``start`` on, which is that of a record.

        Raises:
            DiffbotError: if the chunks unpack to more than the limits allow.
            OSError: if the file cannot be read.
        """
        at = start
        while at < self._end:
            try:
                piece = self._read_any(at)
            except DAMAGE as error:
                after = self._next_valid(at)
                opcode = (self._read(at, 1) or b"\0")[0]
                is_cut = isinstance(error, CutError) and after == self._size
                yield Gap(at, after, str(error) or type(error).__name__, opcode, is_cut)
                at = after
                continue
            yield piece
            if isinstance(piece, Piece) and piece.opcode == Opcode.DATA_END:
                return
            at = piece.end

    def _read(self, at: int, size: int) -> bytes:
        self._stream.seek(at)
        return self._stream.read(size)

    def _prefix(self, at: int) -> tuple[int, int]:
        """Return opcode of a record and the offset after it, which may lie beyond the file."""
        prefix = self._read(at, RECORD.size)
        if len(prefix) < RECORD.size:
            raise CutError("the file ends within a record")
        opcode, length = RECORD.unpack(prefix)
        return opcode, at + RECORD.size + length

    def _read_any(self, at: int) -> Piece | ChunkPiece:
        opcode, after = self._prefix(at)
        if opcode == Opcode.CHUNK:
            return self._read_chunk(at)
        try:
            return self._read_other(at, opcode, after)
        except DAMAGE as error:
            try:
                # A chunk whose opcode is damaged.
                return self._read_chunk(at)
            except DAMAGE:
                raise error from None

    def _read_other(self, at: int, opcode: int, after: int) -> Piece:
        if opcode not in _OF_DATA and opcode < _PRIVATE:
            raise McapError(f"no record of the data has the opcode {opcode}")
        if after > self._end:
            raise CutError("the file ends within a record")
        if opcode == Opcode.ATTACHMENT:
            return Piece(at, after, opcode, b"")
        length = after - at - RECORD.size
        if length > (self._limits.max_unpacked_size if opcode == Opcode.MESSAGE else _MAX_OTHER):
            raise McapError("a record of impossible length")
        content = self._read(at + RECORD.size, length)
        if opcode == Opcode.MESSAGE_INDEX:
            index_entries(content)
        elif opcode < _PRIVATE:
            parse_record(opcode, content)
        elif not self._is_plausible(after):
            raise McapError("an unknown record")
        self._has_messages |= opcode == Opcode.MESSAGE
        return Piece(at, after, opcode, content)

    def _read_chunk(self, at: int) -> ChunkPiece:
        head = self._read(at, CHUNK.size + _LONGEST_NAME + SIZE.size)
        if len(head) < CHUNK.size + SIZE.size:
            raise CutError("the file ends within a chunk")
        opcode, length, start, end, size, checksum, name_length = CHUNK.unpack_from(head)
        name = head[CHUNK.size : CHUNK.size + name_length]
        if name_length > _LONGEST_NAME or name not in (b"", b"lz4", b"zstd"):
            raise McapError("unknown compression of a chunk")
        (packed,) = SIZE.unpack_from(head, CHUNK.size + name_length)
        first = at + CHUNK.size + name_length + SIZE.size
        after = first + packed
        # Without a checksum, the length is all there is to verify.
        is_exact = opcode == Opcode.CHUNK and after == at + RECORD.size + length
        if not is_exact and (checksum == 0 or after > self._end):
            raise McapError("a chunk of another length")
        if after > self._end:
            raise CutError("the file ends within a chunk")
        if max(size, packed) > (most := self._limits.memory(self._size)):
            raise McapError(f"a chunk of {max(size, packed)} bytes: must be <= {most}")
        self._work += packed + size
        if self._work > SMALL + self._limits.unpacked(self._size):
            raise DiffbotError(
                f"its {self._size} bytes unpack to {self._work} and more: must be <= max_compression_ratio"
                f" = {self._limits.max_compression_ratio:g} times as many"
            )
        chunk = Chunk(name.decode(), self._read(first, packed), end, start, checksum, size)
        data = unpack_chunk(chunk, size)
        indexes = index_messages(data, after - at)
        if times := [time for found in indexes.entries.values() for time in (min(found[::2]), max(found[::2]))]:
            is_exact &= start <= min(times) and max(times) <= end
            chunk.message_start_time, chunk.message_end_time = min(times), max(times)
        self._has_chunks = True
        return ChunkPiece(at, after, chunk, indexes, data, is_exact)

    def _is_plausible(self, at: int) -> bool:
        """True if a record of the data could begin here."""
        if at >= self._end:
            return at == self._end
        try:
            opcode, after = self._prefix(at)
        except CutError:
            return False
        return 0 < opcode <= Opcode.DATA_END and after <= self._end

    def _next_valid(self, at: int) -> int:
        """Return where to go on after a record that is damaged."""
        try:
            _, after = self._prefix(at)
        except CutError:
            return self._end
        if after < self._end and self._is_plausible(after):
            return after
        return self._search(at + 1)

    def _search(self, start: int) -> int:
        """Return the offset of the next valid chunk, or message outside of chunks; the end if there is none."""
        outside = self._has_messages and not self._has_chunks
        pattern = _MESSAGE_PATTERN if outside else _CHUNK_PATTERN
        at, size = start, _FIRST_BLOCK
        while at < self._end:
            content = self._read(at, min(size + _OVERLAP, self._end - at))
            for found in pattern.finditer(content):
                if found.start() >= size:
                    break
                if self._budget < 0:
                    raise DiffbotError(f"is damaged from byte {start} on, with too many false chunks to search")
                if self._is_chain(at + found.start()) if outside else self._is_chunk(at + found.start()):
                    return at + found.start()
            # Little at first: the next place is often near, and there may be many.
            at, size = at + size, min(2 * size, _BLOCK)
        return self._end

    def _is_chunk(self, at: int) -> bool:
        before = self._work
        try:
            if self._read_chunk(at).indexes.entries:
                return True
        except DAMAGE:
            pass
        self._budget -= self._work - before
        return False

    def _is_chain(self, at: int) -> bool:
        self._budget -= _CHAIN_COST
        for _ in range(_CHAIN):
            if not self._is_plausible(at):
                return False
            if at == self._end:
                return True
            _, at = self._prefix(at)
        return True
