"""Channels of a new bag made of those of other bags: numbers, united QoS, and what contradicts itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from mcap.records import Channel, Schema
from mcap.well_known import SchemaEncoding

from diffbot_bag.bag.metadata import HASH_KEY, QOS_KEY
from diffbot_bag.bag.qos import Qos, dump_profiles, load_profiles
from diffbot_bag.tools.source_bag import SourceFile
from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import shown

MAX_NUMBER = 2**16 - 1
"""of a channel or a schema"""


class SourceChannels(NamedTuple):
    """How the channels of one file are numbered in the new bag."""

    numbers: dict[int, int | None]
    """New number of each channel; None for one that is left out."""
    unchanged: bool
    """True if every channel and schema of the file is the same, under the same number, in the new bag."""


class Channels(NamedTuple):
    """Channels and schemas of a new bag."""

    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    qos: dict[int, tuple[Qos, ...]]
    """of each channel"""
    sources: list[SourceChannels]


_Member = tuple[SourceFile, Channel]
_Group = list[_Member]
"""Channels of different files that become one."""


def type_of(file: SourceFile, channel: Channel) -> str:
    """Return the type of a channel's messages; empty if it has no schema."""
    schema = file.schemas.get(channel.schema_id)
    return schema.name if schema else ""


def join_channels(files: Sequence[SourceFile], keep: Callable[[str, str], bool]) -> Channels:
    """Return the channels of a bag that is made of these files; those of one topic are joined.

    Args:
        files: in the order of their precedence: the first keeps its numbers.
        keep: whether a topic of a type is kept.

    Raises:
        DiffbotError: if a topic has different types, or there are too many channels.
    """
    topics: dict[str, list[_Group]] = {}
    for file in files:
        for channel in file.channels.values():
            if keep(channel.topic, type_of(file, channel)):
                _add_member(topics.setdefault(channel.topic, []), (file, channel))
    joined = Channels({}, {}, {}, [])
    numbers: dict[tuple[int, int], int] = {}
    for group in (group for groups in topics.values() for group in groups):
        number = _add_channel(joined, group)
        numbers |= {(id(file), channel.id): number for file, channel in group}
    for file in files:
        own = {number: numbers.get((id(file), number)) for number in file.channels}
        joined.sources.append(SourceChannels(own, _unchanged(file, own, joined)))
    return joined


def _add_member(groups: list[_Group], member: _Member) -> None:
    """Put a channel into the group of its topic, or into a new one."""
    for group in groups:
        # A file may have several channels of one topic, even of several types: they stay apart.
        if not any(file is member[0] for file, _ in group):
            _check_same(group[0], member)
            group.append(member)
            return
    groups.append([member])


def _check_same(first: _Member, second: _Member) -> None:
    """Check that the messages of both can be decoded with the schema of the first.

    Raises:
        DiffbotError: if not.
    """
    one, other = type_of(*first), type_of(*second)
    topic, paths = shown(first[1].topic), [shown(file.path) for file, _ in (first, second)]
    advice = "leave one out with `diffbot bag filter --exclude`"
    if one != other:
        raise DiffbotError(f"{topic} is {shown(one)} in {paths[0]} and {shown(other)} in {paths[1]}: {advice}")
    hashes = [channel.metadata.get(HASH_KEY, "") for _, channel in (first, second)]
    layouts = [_layout(file.schemas.get(channel.schema_id)) for file, channel in (first, second)]
    same = hashes[0] == hashes[1] if all(hashes) else layouts[0] == layouts[1]
    if not same or first[1].message_encoding != second[1].message_encoding:
        raise DiffbotError(f"{topic}: {paths[0]} and {paths[1]} have different definitions of {shown(one)}: {advice}")


def _layout(schema: Schema | None) -> object:
    """Return what decides how messages are decoded: of a ROS definition, the types and names of the fields.

    Not comments, constants, default values, the order of the types, and whether one of the same package is named with
    it: recorders write these differently.
    """
    if schema is None or schema.encoding != SchemaEncoding.ROS2:
        return schema and (schema.encoding, schema.data)
    parts: dict[str, list[tuple[str, str]]] = {}
    package = schema.name.partition("/")[0]
    fields = parts[""] = []
    for line in schema.data.decode(errors="replace").splitlines():
        words = line.partition("#")[0].split()
        if len(words) == 2 and words[0] == "MSG:":
            package = words[1].partition("/")[0]
            fields = parts[words[1]] = []
        elif len(words) > 1 and "=" not in words[1] and words[2:3] != ["="]:
            # Basic types begin with a small letter.
            is_of_package = "/" not in words[0] and words[0][0].isupper()
            fields.append((f"{package}/{words[0]}" if is_of_package else words[0], words[1]))
    return parts


def _add_channel(joined: Channels, group: _Group) -> int:
    """Add the channel of a group and return its number, that of its first member if it is free."""
    file, first = group[0]
    schema_number = 0
    if schema := file.schemas.get(first.schema_id):
        schema_number = _add_schema(joined, schema)
    number = first.id if first.id not in joined.channels else _free(joined.channels)
    texts = {channel.metadata.get(QOS_KEY, "") for _, channel in group}
    qos = united([_profiles(*member) for member in group])
    own = dict(first.metadata)
    for _, channel in group[1:]:
        own = {**channel.metadata, **{name: text for name, text in own.items() if text}}
    if len(texts) > 1:
        own[QOS_KEY] = dump_profiles(qos)
    joined.channels[number] = replace(first, id=number, schema_id=schema_number, metadata=own)
    joined.qos[number] = qos
    return number


def _add_schema(joined: Channels, schema: Schema) -> int:
    for number, known in joined.schemas.items():
        if replace(known, id=schema.id) == schema:
            return number
    number = schema.id if schema.id not in joined.schemas else _free(joined.schemas)
    joined.schemas[number] = replace(schema, id=number)
    return number


def _free(taken: Mapping[int, object]) -> int:
    number = max(taken, default=0) + 1
    if number > MAX_NUMBER:
        number = next((one for one in range(1, MAX_NUMBER + 1) if one not in taken), 0)
    if not number:
        raise DiffbotError(f"too many channels: must be <= {MAX_NUMBER}")
    return number


def _profiles(file: SourceFile, channel: Channel) -> tuple[Qos, ...]:
    try:
        return load_profiles(channel.metadata.get(QOS_KEY, ""))
    except DiffbotError as error:
        raise DiffbotError(f"{shown(file.path)}: {shown(channel.topic)}: {error}") from error


def united(all_profiles: Sequence[tuple[Qos, ...]]) -> tuple[Qos, ...]:
    """Return every profile as often as in the file that has it most often: there is one for each publisher."""
    united: Counter[Qos] = Counter()
    for profiles in all_profiles:
        united |= Counter(profiles)
    return tuple(united.elements())


def _unchanged(file: SourceFile, numbers: Mapping[int, int | None], joined: Channels) -> bool:
    # Chunks may contain any record of the file's channels and schemas, also of those without messages in them.
    return all(
        numbers[number] == number and joined.channels[number] == channel for number, channel in file.channels.items()
    ) and all(joined.schemas.get(number, schema) == schema for number, schema in file.schemas.items())
