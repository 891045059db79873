"""Lines of a campaign's journal, from a file or a worker of unknown origin: each value is checked before it counts."""

from __future__ import annotations

import json
import math
import zlib
from typing import Any

from diffbot_lab.campaign.statistics import BIN_WIDTH, LARGEST, METRICS, SMALLEST

MAX_LINE = 16 * 2**20
"""[bytes] of one line; all bins of all metrics have 12 MB"""
_SEAL_START = b',"crc32":'
_SEAL = _SEAL_START + b"%d}\n"
_ZERO_BIN = -1
_LAST_BIN = math.floor(math.log(LARGEST / SMALLEST) / math.log1p(BIN_WIDTH))
_KEYS = {"cell", "first", "count", "runs", "settled", "reached_local", "bins"}


def sealed(entry: dict[str, Any]) -> bytes:
    """Return a line of JSON with the checksum of all that stands before it."""
    body = json.dumps(entry, separators=(",", ":")).encode()[:-1]
    return body + _SEAL % zlib.crc32(body)


def parsed(line: bytes) -> Any:
    """Return the content of a line without its checksum; None if that is wrong, or it is no JSON."""
    body, found, seal = line.rpartition(_SEAL_START)
    if not found or found + seal != _SEAL % zlib.crc32(body):
        return None
    try:
        return json.loads(body + b"}", parse_constant=_refuse)
    except (ValueError, RecursionError):
        return None


def _refuse(word: str) -> None:
    raise ValueError(word)


def check_chunk(entry: Any, cells: int, runs: int) -> None:
    """Check the counts of a chunk of a campaign with this many cells, and runs in each.

    Raises:
        ValueError: if they are not what count_outcomes makes of runs of this campaign.
    """
    if not isinstance(entry, dict) or set(entry) != _KEYS:
        raise ValueError("not the keys of a chunk")
    first, number = _whole(entry["first"], 0, runs - 1), _whole(entry["count"], 1, runs)
    _whole(entry["cell"], 0, cells - 1)
    _whole(first + number, 1, runs)
    _whole(entry["runs"], number, number)
    settled = _whole(entry["settled"], 0, number)
    _whole(entry["reached_local"], 0, number)
    bins = entry["bins"]
    if not isinstance(bins, dict) or set(bins) != set(METRICS):
        raise ValueError("not the metrics of a chunk")
    for metric, pairs in bins.items():
        _check_bins(pairs, settled if metric == "settling_time" else number)


def _check_bins(pairs: Any, most: int) -> None:
    if not isinstance(pairs, list):
        raise ValueError("bins that are no list")
    last, counted = _ZERO_BIN - 1, 0
    for pair in pairs:
        if not isinstance(pair, (list, tuple)) or len(pair) != 2:
            raise ValueError("a bin that is no pair")
        last = _whole(pair[0], last + 1, _LAST_BIN)
        counted = _whole(counted + _whole(pair[1], 1, most), 1, most)


def _whole(value: Any, low: int, high: int) -> int:
    # True is an int in Python, but not in a journal.
    if type(value) is not int or not low <= value <= high:
        raise ValueError("a number out of its range")
    return value
