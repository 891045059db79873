"""Stamps of messages whose type begins with a std_msgs/Header, read from their first 12 bytes."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

SIZE = 12
"""[bytes] encapsulation header of CDR, seconds (int32) and nanoseconds (uint32)"""
_FIELD = re.compile(r"(?P<type>[A-Za-z][\w/]*)(\[[^\]]*\])?(<=\d+)?\s+(?P<name>[A-Za-z]\w*)\s*(?P<constant>=?)")
_HEADERS = ("std_msgs/Header", "std_msgs/msg/Header", "Header")
_REPRESENTATIONS = (0, 1, 6, 7)
"""Plain CDR, versions 1 and 2; the odd ones are little-endian."""


def begins_with_header(definition: str) -> bool:
    """True if the first field of a type is a std_msgs/Header.

    Args:
        definition: text of its .msg file; those of nested types may follow, as in the schema of a bag.
    """
    for line in definition.splitlines():
        if line.startswith("====="):
            return False
        field = _FIELD.match(line.partition("#")[0].strip())
        # A constant takes no place in a message.
        if field and not field["constant"]:
            return field["type"] in _HEADERS and "[" not in field[0]
    return False


def stamps_of(heads: Sequence[bytes]) -> NDArray[np.int64]:
    """Return stamps (n,) [ns]; 0 for messages without one, too short, or not in plain CDR.

    Args:
        heads: the first SIZE bytes of each message, or less if it has less.
    """
    block = np.frombuffer(b"".join(head.ljust(SIZE, b"\0")[:SIZE] for head in heads), np.uint8).reshape(-1, SIZE)
    little = _times(block, "<") * (block[:, 1] % 2 == 1)
    stamps: NDArray[np.int64] = little + _times(block, ">") * (block[:, 1] % 2 == 0)
    whole = np.array([len(head) >= SIZE for head in heads], bool)
    stamps[~(whole & (block[:, 0] == 0) & np.isin(block[:, 1], _REPRESENTATIONS))] = 0
    return stamps


def _times(block: NDArray[np.uint8], order: str) -> NDArray[np.int64]:
    seconds = np.ascontiguousarray(block[:, 4:8]).view(f"{order}i4")[:, 0].astype(np.int64)
    nanoseconds = np.ascontiguousarray(block[:, 8:12]).view(f"{order}u4")[:, 0].astype(np.int64)
    times: NDArray[np.int64] = seconds * 10**9 + nanoseconds
    return times
