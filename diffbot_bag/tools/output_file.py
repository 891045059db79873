"""An MCAP file of whole chunks of other files, and of messages that are packed into new chunks."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Header, MetadataIndex

from diffbot_bag.mcap.format import ENTRY_SIZE, MESSAGE_INDEX, RECORD
from diffbot_bag.mcap.output import OWN_HEADER, McapOutput
from diffbot_bag.mcap.whole_chunk import DEFAULT_COMPRESSION, ChunkPacker, Compression, WholeChunk
from diffbot_bag.tools.source_bag import Row

CHUNK_SIZE = 768 * 1024
"""[bytes] of a new chunk before it is packed, as rosbag2's"""
_PREFIX = struct.Struct("<BQH")
"""Opcode, length and channel of a message; a row has the rest."""
CHANNEL_SIZE = _PREFIX.size - RECORD.size
"""[bytes] of the channel, which a row has as a number instead"""
ENVELOPE = _PREFIX.size + ENTRY_SIZE
"""[bytes] of a message besides the rest that a row holds"""
_CHANNEL_STATISTICS = 20
"""[bytes] of a channel in the statistics, and in the index of a chunk"""
_MARGIN = 2000
"""[bytes] statistics, footer, and the frame of a chunk"""


class OutputFile(McapOutput):
    """One MCAP file that is being written; whatever is written ends the chunk of new messages before it."""

    def __init__(
        self, stream: BinaryIO, header: Header = OWN_HEADER, compression: Compression = DEFAULT_COMPRESSION
    ) -> None:
        """Begin the file in an empty stream; ``compression`` is that of new chunks.

        Raises:
            OSError: as all methods, if the disk is full.
        """
        super().__init__(stream, header)
        self._packer = ChunkPacker(compression)
        self._parts: list[bytes] = []
        self._entries: dict[int, list[int]] = {}
        self._held = 0

    @property
    def final_size(self) -> int:
        """Size [bytes] that the file would have at most if it ended now."""
        channels = (_CHANNEL_STATISTICS + MESSAGE_INDEX.size) * len(self.channels)
        pending = self._held + ENTRY_SIZE * (len(self._parts) // 2) + channels
        return self.size + self.index_size + pending + _MARGIN

    def write(self, rows: Iterable[Row]) -> None:
        """Append messages; they may come in any order, but readers are fastest in that of log time."""
        held = self._held
        for log_time, channel, tail in rows:
            entries = self._entries.get(channel)
            if entries is None:
                entries = self._entries[channel] = []
            entries += (log_time, held)
            self._parts += (_PREFIX.pack(Opcode.MESSAGE, len(tail) + CHANNEL_SIZE, channel), tail)
            held += _PREFIX.size + len(tail)
            if held >= CHUNK_SIZE:
                self.end_chunk()
                held = 0
        self._held = held

    def end_chunk(self) -> None:
        """End the chunk of new messages, so that they are counted."""
        if self._parts:
            chunk = self._packer.pack(b"".join(self._parts), self._entries)
            self._parts, self._entries = [], {}
            self._held = 0
            super().add_chunk(chunk)

    def add_chunk(self, chunk: WholeChunk) -> None:
        """Append a chunk as it is; its channels and schemas have the same numbers here."""
        self.end_chunk()
        super().add_chunk(chunk)

    def copy_record(self, index: AttachmentIndex | MetadataIndex, blocks: Iterable[bytes]) -> None:
        """Append an attachment or metadata record."""
        self.end_chunk()
        super().copy_record(index, blocks)

    def finish(self) -> None:
        """Write the index, bring everything to the disk and close the file."""
        self.end_chunk()
        super().finish()
