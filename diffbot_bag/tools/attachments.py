"""Attachments of an MCAP file: verified without holding them in memory."""

from __future__ import annotations

import io
import struct
import zlib
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import AttachmentIndex

from diffbot_bag.mcap_format import CRC, RECORD

_MAX_HEAD = 64 * 1024
"""[bytes] of names and times"""
_BLOCK = 2**20
_FIXED = struct.Struct("<QQIIQI")
"""Two times, the lengths of two texts, the size of the data and the checksum."""


def verified_attachment(stream: BinaryIO, offset: int, end: int) -> AttachmentIndex:
    """Return the index of the attachment between two offsets of a file.

    Raises:
        McapError, ValueError, struct.error: DAMAGE, if its lengths or its checksum are wrong.
    """
    begin = offset + RECORD.size
    stream.seek(begin)
    head = ReadDataStream(io.BytesIO(stream.read(min(_MAX_HEAD, end - begin))))
    log_time, create_time = head.read8(), head.read8()
    name, media_type = head.read_prefixed_string(), head.read_prefixed_string()
    data_size = head.read8()
    texts = len(name.encode()) + len(media_type.encode())
    if begin + _FIXED.size + texts + data_size != end:
        raise McapError("an attachment of another length")
    stream.seek(begin)
    left, checksum = end - begin - CRC.size, 0
    while left:
        block = stream.read(min(_BLOCK, left))
        checksum = zlib.crc32(block, checksum)
        left -= len(block)
    (expected,) = CRC.unpack(stream.read(CRC.size))
    if expected not in (0, checksum):
        raise McapError("checksum of an attachment")
    return AttachmentIndex(offset, end - offset, log_time, create_time, data_size, name, media_type)
