"""Repair a bag: a complete one of everything that is intact in it, read again by two readers before it appears."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from diffbot_bag.bag import metadata
from diffbot_bag.bag.file_lock import locked_files, part_folder
from diffbot_bag.bag.metadata import BagMetadata, FileInformation, Topic
from diffbot_bag.mcap.chunks import BagLimits
from diffbot_bag.tools.bag_parts import BagParts, find_parts
from diffbot_bag.tools.check_result import check_result
from diffbot_bag.tools.salvage import Salvage, Salvaged
from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import open_regular, shown

Progress = Callable[[int], None]
PASSES = 3
"""Times that a repair goes through the [bytes] of a bag, for its progress: once to copy, twice to check."""


class RepairedFile(NamedTuple):
    """One file of the new bag."""

    source: Path
    path: Path
    salvaged: Salvaged
    state: os.stat_result
    """of the source when it was read"""


class Repaired(NamedTuple):
    """The new bag; times in [ns]."""

    path: Path
    files: list[RepairedFile]
    topics: dict[str, Topic]
    missing: list[str]
    """Files that metadata.yaml named, and that are not there."""
    note: str
    """What was wrong with metadata.yaml; empty if nothing was."""

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return sum(file.salvaged.message_count for file in self.files)

    @property
    def start(self) -> int:
        """First log time; 0 without a message."""
        return min((file.salvaged.start for file in self.files if file.salvaged.message_count), default=0)

    @property
    def end(self) -> int:
        """Last log time; 0 without a message."""
        return max((file.salvaged.end for file in self.files if file.salvaged.message_count), default=0)


def size_of(bag: Path) -> int:
    """Return the size [bytes] of a bag's files.

    Raises:
        DiffbotError: if there is no bag.
    """
    return sum(path.stat().st_size for path in find_parts(bag).files)


def repair_bag(bag: Path, out: Path, limits: BagLimits | None = None, progress: Progress = lambda _: None) -> Repaired:
    """Write a new bag of everything that is intact in another one.

    Args:
        bag: folder or file, in any state.
        out: folder of the new bag, which must not exist; it appears when it is complete and was read again.
        limits: how much each file may unpack to; default: those of BagLimits.
        progress: called with [bytes], PASSES times those of the bag altogether.

    Raises:
        DiffbotError: if there is no bag, ``out`` exists or cannot be written, or the result is not what was written.
    """
    out = out.expanduser().absolute()
    if out.suffix == ".mcap":
        raise DiffbotError(f"{shown(out)}: the repaired bag is a folder, its name must not end with .mcap")
    if os.path.lexists(out):
        raise DiffbotError(f"{shown(out)} exists already: choose another name for the bag")
    parts = find_parts(bag)
    with _temporary_folder(out) as folder:
        new = folder / out.name
        new.mkdir()
        names = [f"{out.name}_{number}.mcap" for number in range(len(parts.files))]
        repaired = _repair(parts, new, names, limits or BagLimits(), progress)
        metadata.write(new, _metadata_of(repaired, parts.metadata))
        new.rename(out)
    return repaired._replace(path=out)


def repair_in_place(bag: Path, limits: BagLimits | None = None, progress: Progress = lambda _: None) -> Repaired:
    """Replace the files of a bag by repaired ones; each is replaced whole, after all of them were read again.

    Raises:
        DiffbotError: as for :func:`repair_bag`, or if it is being recorded; the bag is then as it was.
    """
    find_parts(bag)
    # New files are made on the same disk, so that they can take the place of the old ones.
    bag = bag.expanduser().resolve()
    parts = find_parts(bag)
    with locked_files(parts.files), _temporary_folder(bag) as folder:
        names = [path.name for path in parts.files]
        if len(set(names)) < len(names):
            raise DiffbotError(f"{shown(bag)} has two files of the same name in different folders")
        repaired = _repair(parts, folder, names, limits or BagLimits(), progress)
        for file in repaired.files:
            _check_unchanged(file.source, file.state)
        for file in repaired.files:
            shutil.copymode(file.source, file.path)
            file.path.replace(file.source)
        if bag.is_dir():
            relative = [str(file.source.relative_to(bag)) for file in repaired.files]
            metadata.write(bag, _metadata_of(repaired, parts.metadata, relative))
    return repaired._replace(path=bag)


@contextmanager
def _temporary_folder(path: Path) -> Iterator[Path]:
    try:
        with part_folder(path) as part:
            yield part
    except OSError as error:
        raise DiffbotError(f"cannot write the bag {shown(path)}: {error.strerror or error}") from error


def _repair(parts: BagParts, folder: Path, names: list[str], limits: BagLimits, progress: Progress) -> Repaired:
    """Write repaired files to a folder and read them again."""
    files = []
    for source, name in zip(parts.files, names, strict=True):
        files.append(_repair_file(source, folder / name, limits, progress))
    for file in files:
        salvaged, size = file.salvaged, file.source.stat().st_size
        expected: Counter[str] = Counter()
        for topic in salvaged.topics:
            expected[topic.name] += topic.message_count
        per_message = size / max(1, salvaged.message_count)

        def count(messages: int, per_message: float = per_message) -> None:
            progress(round(messages * per_message))

        check_result(file.path, expected, limits, count)
    return Repaired(folder, files, _merged_topics(files), parts.missing, parts.note)


def _repair_file(source: Path, target: Path, limits: BagLimits, progress: Progress) -> RepairedFile:
    with open_regular(source) as stream, target.open("xb") as out:
        before = os.fstat(stream.fileno())
        try:
            salvage = Salvage(stream, before.st_size, out, limits)
            salvaged = salvage.run(progress)
        except DiffbotError as error:
            raise DiffbotError(f"{shown(source)}: {error}") from error
        _check_unchanged(source, before)
        salvage.finish(metadata.to_record(_metadata_of_file(target.name, salvaged)))
    return RepairedFile(source, target, salvaged, before)


def _check_unchanged(path: Path, before: os.stat_result) -> None:
    after = os.stat(path)
    if (before.st_size, before.st_mtime_ns, before.st_ino) != (after.st_size, after.st_mtime_ns, after.st_ino):
        raise DiffbotError(f"{shown(path)} has changed meanwhile: is it still being recorded?")


def _merged_topics(files: list[RepairedFile]) -> dict[str, Topic]:
    found: dict[str, Topic] = {}
    for file in files:
        for topic in file.salvaged.topics:
            known = found.get(topic.name)
            count = topic.message_count + (known.message_count if known else 0)
            found[topic.name] = (known or topic)._replace(message_count=count)
    return found


def _information(name: str, salvaged: Salvaged) -> FileInformation:
    return FileInformation(name, salvaged.start, salvaged.end - salvaged.start, salvaged.message_count)


def _metadata_of_file(name: str, salvaged: Salvaged) -> BagMetadata:
    distro = salvaged.ros_distro or BagMetadata().ros_distro
    return metadata.of_files([_information(name, salvaged)], salvaged.topics, salvaged.custom_data, distro)


def _metadata_of(repaired: Repaired, stored: BagMetadata | None, names: list[str] | None = None) -> BagMetadata:
    """Return metadata.yaml of the new bag, with the custom data of the files and of the old metadata.yaml."""
    names = names or [file.path.name for file in repaired.files]
    custom: dict[str, str] = {}
    for file in repaired.files:
        custom |= file.salvaged.custom_data
    distros = [stored.ros_distro if stored else "", *(file.salvaged.ros_distro for file in repaired.files)]
    return metadata.of_files(
        [_information(name, file.salvaged) for name, file in zip(names, repaired.files, strict=True)],
        list(repaired.topics.values()),
        custom | dict(stored.custom_data if stored else {}),
        next(filter(None, distros), BagMetadata().ros_distro),
    )
