"""Bags made of parts of other bags: trim, filter and merge."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import AttachmentIndex, MetadataIndex

from diffbot_bag.bag.metadata import BagMetadata
from diffbot_bag.bag.new_bag import new_bag_folder
from diffbot_bag.bag.reader import MAX_FILES
from diffbot_bag.bag.topic_selection import TopicSelection
from diffbot_bag.mcap.whole_chunk import KINDS, Compression
from diffbot_bag.tools.channels import Channels, join_channels
from diffbot_bag.tools.latched import at_time, delivered, last_before, latches_of
from diffbot_bag.tools.output_bag import Description, OutputBag
from diffbot_bag.tools.source_bag import Row, SourceBag, SourceFile
from diffbot_bag.tools.span import Span
from diffbot_bag.tools.time_order import Piece, Progress, crossing_files, pieces_of, send
from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import shown

MAX_DIGITS = 18
"""of a count of lost messages"""


class NewBag(NamedTuple):
    """A bag that can be made of others, which stay open meanwhile."""

    channels: Channels
    pieces: list[Piece]
    """Chunks to read, by their first log time."""
    span: Span
    head: list[Row]
    """Messages before all others."""
    together: set[int]
    """``order`` of the pieces to unpack, since they share times with others."""
    description: Description

    @property
    def size(self) -> int:
        """Bytes to read."""
        return sum(piece.size for piece in self.pieces)

    def write(self, folder: Path, progress: Progress) -> BagMetadata:
        """Write the bag, which appears when it is complete, and return what its metadata.yaml says.

        Args:
            folder: of the new bag.
            progress: receives the bytes read since its last call.

        Raises:
            DiffbotError: if the folder exists or cannot be written, or a file that is read is damaged.
        """
        unchanged = {id(own.numbers) for own in self.channels.sources if own.unchanged}

        def may_copy(piece: Piece) -> bool:
            return id(piece.numbers) in unchanged and piece.order not in self.together

        with new_bag_folder(folder) as part, OutputBag(part, self.channels, self.description) as bag:
            bag.write(self.head)
            send(self.pieces, self.span, may_copy, bag, progress)
            return bag.finish()


def trim(bag: SourceBag, span: Span, *, latched: bool = True) -> NewBag:
    """Return a bag of the messages of a span.

    Args:
        bag: to cut.
        span: of log times; it must reach into the bag.
        latched: begin with the last earlier messages of latched topics, with the start of the span as their log time.

    Raises:
        DiffbotError: if a file is damaged.
    """
    channels = join_channels(bag.files, _everything)
    pieces = pieces_of(bag.files, channels)
    head: list[Row] = []
    if latched and span.start > bag.start:
        latches = latches_of(channels.qos)
        head = delivered(last_before(pieces, span.start, latches), span.start, latches)
    inside = [piece for piece in pieces if piece.start < span.end and piece.end >= span.start]
    return NewBag(channels, inside, span, at_time(head, span.start), set(), _description([bag]))


def select(bag: SourceBag, selection: TopicSelection, types: Sequence[str] = ()) -> NewBag:
    """Return a bag of some topics.

    Args:
        bag: to filter.
        selection: of topics.
        types: to keep of them; empty: all.

    Raises:
        DiffbotError: if a topic or type is not in the bag, or nothing is selected.
    """
    selection.check()
    topics = bag.topics
    for name, given, known in (
        ("topics", selection.topics, topics.keys()),
        ("types", types, {topic.type for topic in topics.values()}),
    ):
        if missing := [one for one in given if one not in known]:
            raise DiffbotError(f"{name}: {shown(missing[0])} is not in the bag, which has {shown(', '.join(known))}")

    def keep(topic: str, type_name: str) -> bool:
        return selection.selects(topic) and (not types or type_name in types)

    channels = join_channels(bag.files, keep)
    if not channels.channels:
        raise DiffbotError(f"no topic of the bag is selected; it has {shown(', '.join(topics))}")
    return NewBag(channels, pieces_of(bag.files, channels), Span(), [], set(), _description([bag]))


def merge(bags: Sequence[SourceBag]) -> NewBag:
    """Return a bag of the messages of all, in the order of log time.

    Raises:
        DiffbotError: if a topic has different types, or there are too many files.
    """
    files = [file for bag in bags for file in bag.files]
    if len(files) > MAX_FILES:
        raise DiffbotError(f"the bags have {len(files)} files together: must be <= {MAX_FILES}")
    channels = join_channels(files, _everything)
    pieces = pieces_of(files, channels)
    return NewBag(channels, pieces, Span(), [], crossing_files(pieces), _description(bags))


def _everything(topic: str, type_name: str) -> bool:
    return True


def _description(bags: Sequence[SourceBag]) -> Description:
    files = [file for bag in bags for file in bag.files]
    facts = [_facts(bag) for bag in bags]
    kinds = [chunk.compression or "none" for file in files for chunk in file.chunks[:1]]
    return Description(
        custom_data=_joined([custom_data for custom_data, _ in facts]),
        ros_distro=next((distro for _, distro in facts if distro), ""),
        compression=Compression(next((kind for kind in kinds if kind in KINDS), KINDS[0])),
        attached=_attached(files),
    )


def _facts(bag: SourceBag) -> tuple[dict[str, str], str]:
    """Return custom data and distribution of ROS from metadata.yaml, or from the file if there is none."""
    if bag.metadata:
        own: Mapping[str, Any] = bag.metadata._asdict()
    else:
        own = bag.files[0].own_metadata()
    custom_data = own.get("custom_data")
    plain = custom_data if isinstance(custom_data, Mapping) else {}
    return {str(name): str(value) for name, value in plain.items()}, str(own.get("ros_distro", ""))


def _joined(all_data: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Return the custom data of all bags: counts of lost messages are added, other values that differ are listed."""
    values: dict[str, list[str]] = {}
    for data in all_data:
        for name, value in data.items():
            values.setdefault(name, []).append(value)
    return {name: _joined_value(name, found) for name, found in values.items()}


def _joined_value(name: str, found: Sequence[str]) -> str:
    lost = name == "lost_messages" or name.startswith("lost ")
    if lost and all(value.isdecimal() and len(value) <= MAX_DIGITS for value in found):
        return str(sum(map(int, found)))
    return ", ".join(dict.fromkeys(found))


def _attached(files: Sequence[SourceFile]) -> list[tuple[SourceFile, AttachmentIndex | MetadataIndex]]:
    """Return attachments and metadata records of all files; those that several files repeat, once."""
    found: dict[object, tuple[SourceFile, AttachmentIndex | MetadataIndex]] = {}
    for file in files:
        for index in file.attached:
            if isinstance(index, AttachmentIndex):
                key: object = (index.name, index.media_type, index.log_time, index.create_time, index.data_size)
            else:
                key = b"".join(file.attached_bytes(index))
            found.setdefault(key, (file, index))
    return list(found.values())
