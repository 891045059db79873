"""Go through the chunks of several files in the order of log time; only where it is needed, they are unpacked."""

from __future__ import annotations

import heapq
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from operator import itemgetter
from typing import NamedTuple, Protocol

from mcap.records import ChunkIndex

from diffbot_bag.mcap.whole_chunk import WholeChunk
from diffbot_bag.tools.channels import Channels
from diffbot_bag.tools.source_bag import Row, SourceFile
from diffbot_bag.tools.span import Span

Progress = Callable[[int], None]
"""Called with the number of bytes of the input that are done since the last call."""


class Piece(NamedTuple):
    """A chunk of a file, or a whole file without chunks."""

    start: int
    """[ns] first log time"""
    order: int
    """Its place among all pieces: by file, then in the order of the file; it decides between equal log times."""
    end: int
    """[ns] last log time"""
    file: SourceFile
    numbers: Mapping[int, int | None]
    """New numbers of the file's channels."""
    place: ChunkIndex | None
    size: int
    """[bytes] in the file"""

    def rows(self, span: Span) -> list[Row]:
        """Return the messages of a span in the order of log time, under the new numbers.

        Raises:
            DiffbotError: if the chunk is damaged.
        """
        return self.file.chunk_rows(self.place, self.numbers, span)


class Sink(Protocol):
    """What receives the messages."""

    def copy(self, piece: Piece, chunk: WholeChunk) -> None:
        """Receive a chunk."""
        ...

    def write(self, rows: Sequence[Row]) -> None:
        """Receive messages in the order of log time."""
        ...


def pieces_of(files: Sequence[SourceFile], channels: Channels) -> list[Piece]:
    """Return all chunks that can have messages of the channels that are kept, by their first log time."""
    pieces: list[Piece] = []
    for file, own in zip(files, channels.sources, strict=True):
        for place in sorted(file.chunks, key=lambda one: one.chunk_start_offset):
            named = place.message_index_offsets
            if named and all(own.numbers.get(number, number) is None for number in named):
                continue
            start, end = place.message_start_time, place.message_end_time
            pieces.append(Piece(start, len(pieces), end, file, own.numbers, place, place.chunk_length))
        if not file.chunks and file.message_count:
            start, end = file.span()
            pieces.append(Piece(start, len(pieces), end, file, own.numbers, None, file.size))
    return sorted(pieces, key=itemgetter(0, 1))


def crossing_files(pieces: Sequence[Piece]) -> set[int]:
    """Return the ``order`` of the pieces that cannot follow, whole, one of another file, or come before it."""
    starts: dict[int, list[tuple[int, int]]] = {}
    ends: dict[int, list[tuple[int, int]]] = {}
    for piece in pieces:
        starts.setdefault(id(piece.file), []).append(_begin(piece))
        known = ends.setdefault(id(piece.file), [])
        known.append(max((piece.end, piece.order), known[-1]) if known else (piece.end, piece.order))
    found = set()
    for piece in pieces:
        for file in starts.keys() - {id(piece.file)}:
            earlier = bisect_left(starts[file], (piece.end, piece.order))
            if earlier and ends[file][earlier - 1] > _begin(piece):
                found.add(piece.order)
    return found


def _begin(piece: Piece) -> tuple[int, int]:
    return piece.start, piece.order


def send(
    pieces: Sequence[Piece], span: Span, may_copy: Callable[[Piece], bool], sink: Sink, progress: Progress
) -> None:
    """Give the messages of a span to a sink, in the order of log time.

    Args:
        pieces: all that reach into the span, by their first log time.
        span: of the log times to keep.
        may_copy: True if a piece inside the span can be copied whole.
        sink: receives them; its errors are passed on.
        progress: receives the bytes read.

    Raises:
        DiffbotError: if a chunk is damaged.
    """
    waiting = deque(pieces)
    heap: list[tuple[int, int, int, list[Row]]] = []
    while waiting or heap:
        if waiting and (not heap or waiting[0][:2] < heap[0][:2]):
            piece = waiting.popleft()
            chunk = None
            if piece.place and span.start <= piece.start and piece.end < span.end and may_copy(piece):
                chunk = piece.file.whole_chunk(piece.place)
            if chunk:
                sink.copy(piece, chunk)
            elif rows := piece.rows(span):
                heapq.heappush(heap, (rows[0][0], piece.order, 0, rows))
            progress(piece.size)
            continue
        _, order, begin, rows = heapq.heappop(heap)
        following = [(entry[0], entry[1]) for entry in heap[:1]]
        following += [(piece.start, piece.order) for piece in islice(waiting, 1)]
        end = len(rows)
        for time, other in following:
            cut = bisect_right if order < other else bisect_left
            end = min(end, cut(rows, time, begin, key=itemgetter(0)))
        sink.write(rows[begin:end])
        if end < len(rows):
            heapq.heappush(heap, (rows[end][0], order, end, rows))
