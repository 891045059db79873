"""Messages of latched (transient local) topics that a subscriber would have got at some time, found by the index."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter, itemgetter
from typing import NamedTuple

from diffbot_bag.bag.qos import Qos
from diffbot_bag.tools.source_bag import Row
from diffbot_bag.tools.span import Span
from diffbot_bag.tools.time_order import Piece

_TIME = struct.Struct("<Q")
_TIME_AT = 4
"""[bytes] of the sequence number, before the log time of a row"""


class Latch(NamedTuple):
    """What is kept of a latched channel for those who subscribe later."""

    depth: int
    """Messages: one for each publisher, since a message does not tell its publisher."""
    lifespan: int
    """[ns] after which a message is not delivered any more"""


def latches_of(qos: Mapping[int, Sequence[Qos]]) -> dict[int, Latch]:
    """Return the latched channels; a channel is latched if one of its publishers is."""
    found = {}
    for number, profiles in qos.items():
        latched = [profile for profile in profiles if profile.is_latched]
        if latched:
            found[number] = Latch(len(latched), max(profile.lifespan for profile in latched))
    return found


def at_time(rows: Iterable[Row], time: int) -> list[Row]:
    """Return the messages with another log time [ns]; publish time and sequence number stay."""
    stamp = _TIME.pack(time)
    rest = _TIME_AT + _TIME.size
    return [(time, channel, tail[:_TIME_AT] + stamp + tail[rest:]) for _, channel, tail in rows]


def last_before(pieces: Iterable[Piece], time: int, latches: Mapping[int, Latch]) -> list[Row]:
    """Return the last messages before ``time`` [ns] of latched channels, in the order of log time.

    Only chunks with messages of these channels are unpacked, the latest first, and no more than are needed.

    Args:
        pieces: in any order.
        time: [ns] exclusive.
        latches: of channels by their new numbers.

    Raises:
        DiffbotError: if a chunk is damaged.
    """
    found: dict[int, list[tuple[int, int, Row]]] = {number: [] for number in latches}
    earlier = [piece for piece in pieces if piece.start < time]
    for piece in sorted(earlier, key=attrgetter("end", "order"), reverse=True):
        wanted = {
            number
            for number, latch in latches.items()
            if len(found[number]) < latch.depth or found[number][0][0] <= piece.end
        }
        if not wanted:
            break
        named = piece.place.message_index_offsets if piece.place else {}
        numbers = {old: new if new in wanted else None for old, new in piece.numbers.items()}
        if named and all(numbers.get(old) is None for old in named):
            continue
        for row in piece.file.chunk_rows(piece.place, numbers, Span(0, time)):
            found[row[1]].append((row[0], piece.order, row))
        for number in wanted:
            found[number] = sorted(found[number], key=itemgetter(0, 1))[-latches[number].depth :]
    rows = [row for kept in found.values() for _, _, row in kept]
    return sorted(rows, key=itemgetter(0))


def delivered(rows: Iterable[Row], time: int, latches: Mapping[int, Latch]) -> list[Row]:
    """Return those of these messages whose lifespan has not ended at ``time`` [ns]."""
    return [row for row in rows if time - row[0] <= latches[row[1]].lifespan]
