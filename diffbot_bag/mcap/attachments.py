"""Attachments of a file, read and verified; and that of the recorder: the parameters of the nodes."""

from __future__ import annotations

import io
import json
import math
import re
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex

from diffbot_bag.mcap.format import ATTACHMENT, CRC, RECORD
from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import shown

PARAMETERS = "parameters.json"
"""Name of the attachment."""
MEDIA_TYPE = "application/json"
MAX_ATTACHMENT = 16 * 2**20
"""[bytes] of an attachment that is read"""
_MAX_HEAD = 64 * 1024
"""[bytes] of names and times"""
BLOCK = 2**20
"""[bytes] read at once"""
_SECRET = re.compile(r"passw|secret|token|credential|api_?key|private_?key", re.IGNORECASE)
HIDDEN = "(not recorded)"
"""Instead of the value of a parameter whose name sounds like a secret."""

Parameters = dict[str, dict[str, Any]]
"""Value by name of the parameter, by full name of the node."""


def dump_parameters(parameters: Mapping[str, Mapping[str, Any]]) -> bytes:
    """Return the attachment of the nodes' parameters; numbers that JSON does not know become texts."""
    plain = {
        node: {name: HIDDEN if _SECRET.search(name) else _plain(value) for name, value in values.items()}
        for node, values in parameters.items()
    }
    return (json.dumps(plain, indent=1, allow_nan=False, sort_keys=True) + "\n").encode()


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


def blocks_of(stream: BinaryIO, offset: int, length: int) -> Iterator[bytes]:
    """Yield ``length`` [bytes] of a file from an offset on, in blocks.

    Raises:
        EndOfFile: if the file ends before.
    """
    while length > 0:
        stream.seek(offset)
        block = stream.read(min(BLOCK, length))
        if not block:
            raise EndOfFile
        yield block
        offset, length = offset + len(block), length - len(block)


def verified_attachment(stream: BinaryIO, offset: int, end: int) -> AttachmentIndex:
    """Return the index of the attachment between two offsets of a file; its data are not held in memory.

    Raises:
        McapError, ValueError, struct.error, ...: DAMAGE, if its lengths or its checksum are wrong.
    """
    begin = offset + RECORD.size
    stream.seek(offset)
    head = stream.read(min(_MAX_HEAD, max(end - offset, 0)))
    if RECORD.unpack_from(head) != (Opcode.ATTACHMENT, end - begin):
        raise McapError("no attachment where the index has one")
    fields = ReadDataStream(io.BytesIO(head[RECORD.size :]))
    log_time, create_time = fields.read8(), fields.read8()
    name, media_type = fields.read_prefixed_string(), fields.read_prefixed_string()
    data_size = fields.read8()
    if begin + ATTACHMENT.size + len(name.encode()) + len(media_type.encode()) + data_size != end:
        raise McapError("an attachment of another length")
    checksum = 0
    for block in blocks_of(stream, begin, end - begin - CRC.size):
        checksum = zlib.crc32(block, checksum)
    (expected,) = CRC.unpack(stream.read(CRC.size))
    if expected not in (0, checksum):
        raise McapError("checksum of an attachment")
    return AttachmentIndex(offset, end - offset, log_time, create_time, data_size, name, media_type)


def read_attachment(stream: BinaryIO, index: AttachmentIndex) -> bytes:
    """Return the data of an attachment, its checksum verified.

    Raises:
        McapError, struct.error, ...: DAMAGE of the module ``mcap_format``, if it is not what its index says.
    """
    end = index.offset + index.length
    found = verified_attachment(stream, index.offset, end)
    return b"".join(blocks_of(stream, end - CRC.size - found.data_size, found.data_size))


def load_parameters(data: bytes | None, path: Path) -> Parameters:
    """Return the parameters of the attachment PARAMETERS of a bag; empty without one.

    Args:
        data: as ``BagReader.attachment(PARAMETERS)`` returns it.
        path: of the bag, for the error.

    Raises:
        DiffbotError: if it is not what the recorder writes.
    """
    if data is None:
        return {}
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise DiffbotError(f"{shown(path)}: {PARAMETERS} is not JSON") from error
    if not isinstance(content, dict) or not all(isinstance(values, dict) for values in content.values()):
        raise DiffbotError(f"{shown(path)}: {PARAMETERS} is not a map of nodes to their parameters")
    return content
