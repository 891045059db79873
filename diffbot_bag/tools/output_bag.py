"""Write a bag of one file, with its metadata in the file and beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from mcap.records import AttachmentIndex, MetadataIndex

from diffbot_bag.bag import metadata
from diffbot_bag.bag.metadata import HASH_KEY, RECORD_NAME, BagMetadata, FileInformation, Topic
from diffbot_bag.mcap.whole_chunk import Compression, WholeChunk
from diffbot_bag.tools.channels import Channels, united
from diffbot_bag.tools.output_file import OutputFile
from diffbot_bag.tools.source_bag import Row, SourceFile
from diffbot_bag.tools.time_order import Piece


class Description(NamedTuple):
    """What a bag has besides its messages."""

    custom_data: Mapping[str, str]
    ros_distro: str
    compression: Compression
    """of new chunks"""
    attached: Sequence[tuple[SourceFile, AttachmentIndex | MetadataIndex]]
    """Attachments and metadata records."""


class OutputBag:
    """A bag that is being written. Leave the ``with`` block to close it, :meth:`finish` to complete it."""

    def __init__(self, folder: Path, channels: Channels, description: Description) -> None:
        """Create the folder and its file.

        Raises:
            OSError: if they cannot be written.
        """
        self._folder, self._channels, self._description = folder, channels, description
        folder.mkdir(parents=True)
        self._file = self._open()

    def __enter__(self) -> OutputBag:
        """Return the bag itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file in progress."""
        self._file.abandon()

    def _open(self) -> OutputFile:
        path = self._folder / f"{self._folder.name}_0.mcap"
        file = OutputFile(path.open("xb"), compression=self._description.compression)
        try:
            for schema in self._channels.schemas.values():
                file.add_schema(schema)
            for channel in self._channels.channels.values():
                file.add_channel(channel)
            for source, index in self._description.attached:
                file.copy_record(index, source.attached_bytes(index))
        except BaseException:
            file.abandon()
            raise
        return file

    def copy(self, piece: Piece, chunk: WholeChunk) -> None:
        """Append a chunk.

        Raises:
            OSError: if the disk is full.
        """
        self._file.add_chunk(chunk)

    def write(self, rows: Sequence[Row]) -> None:
        """Append messages.

        Raises:
            OSError: if the disk is full.
        """
        self._file.write(rows)

    def finish(self) -> BagMetadata:
        """End the file and write metadata.yaml; return its contents.

        Raises:
            OSError: if the disk is full.
        """
        self._file.end_chunk()
        facts = self._metadata()
        self._file.add_metadata(RECORD_NAME, metadata.to_record(facts))
        self._file.finish()
        metadata.write(self._folder, facts)
        return facts

    def _metadata(self) -> BagMetadata:
        file = self._file
        return metadata.of_files(
            [FileInformation(file.path.name, file.start, file.end - file.start, file.message_count)],
            topics=self._topics(),
            custom_data=self._description.custom_data,
            ros_distro=self._description.ros_distro,
        )

    def _topics(self) -> tuple[Topic, ...]:
        topics: dict[str, Topic] = {}
        for number, channel in self._channels.channels.items():
            schema = self._channels.schemas.get(channel.schema_id)
            topic = Topic(
                name=channel.topic,
                type=schema.name if schema else "",
                type_hash=channel.metadata.get(HASH_KEY, ""),
                qos=self._channels.qos[number],
                message_count=self._file.counts[number],
            )
            if known := topics.get(topic.name):
                count = known.message_count + topic.message_count
                topic = known._replace(message_count=count, qos=united([known.qos, topic.qos]))
            topics[topic.name] = topic
        return tuple(topics.values())
