"""Attachments that the recorder adds to each file of a bag: parameters of the nodes, and facts of the host."""

from __future__ import annotations

import io
import json
import math
import re
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, AttachmentIndex

from diffbot_bag.foreign_files import shown
from diffbot_core.errors import DiffbotError

PARAMETERS, HOST = "parameters.json", "host.json"
"""Names of the attachments."""
MEDIA_TYPE = "application/json"
MAX_ATTACHMENT = 16 * 2**20
"""[bytes] of an attachment that is read"""
_PREFIX = 9
"""[bytes] opcode and length of a record"""
_CHECKSUM = struct.Struct("<I")
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
    return dump(plain)


def dump(content: Mapping[str, Any]) -> bytes:
    """Return JSON."""
    return (json.dumps(content, indent=1, allow_nan=False, sort_keys=True) + "\n").encode()


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


def read_attachment(stream: BinaryIO, index: AttachmentIndex) -> bytes:
    """Return the data of an attachment, its checksum verified.

    Raises:
        McapError, struct.error, ...: DAMAGE of the module ``mcap_file``, if it is not what its index says.
    """
    stream.seek(index.offset)
    record = stream.read(index.length)
    if record[:1] != bytes((Opcode.ATTACHMENT,)) or len(record) != index.length:
        raise McapError("no attachment where the index has one")
    (checksum,) = _CHECKSUM.unpack(record[-_CHECKSUM.size :])
    if checksum and checksum != zlib.crc32(record[_PREFIX : -_CHECKSUM.size]):
        raise McapError("checksum of an attachment")
    found: Attachment = Attachment.read(ReadDataStream(io.BytesIO(record[_PREFIX:])))
    return found.data


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
