"""Bags of several makers, and what two independent readers find in a bag."""

import random
import struct
from collections import Counter
from typing import NamedTuple

import yaml
from bag_makers import BEGIN, LATCHED, POINT, STRING, point, read, string, write_mcap, write_rosbags
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.writer import IndexType

from diffbot_bag.bag.qos import Qos

STEP = 10_000_000


class Fact(NamedTuple):
    """All that a bag says about a message."""

    topic: str
    sequence: int
    log_time: int
    publish_time: int
    data: bytes
    type: str
    encoding: str
    definition: bytes
    metadata: tuple


class Given(NamedTuple):
    """A message to write."""

    topic: str
    log_time: int
    data: bytes
    publish_time: int = 0
    sequence: int = 0


def drive(count=200, padding=100):
    """Two topics at every step, and a latched one at the steps 7 and 55; ``padding`` [bytes] is random."""
    noise = random.Random(1)
    for index in range(count):
        time = BEGIN + index * STEP
        yield Given("/point", time, point(index), time - 5, index)
        yield Given("/text", time + 3, string(noise.randbytes(padding).hex()), time - 7, index + 9)
        if index in (7, 55):
            yield Given("/map", time + 5, string(f"map {index}"), time - 1000, index)


KINDS = {"/point": POINT, "/text": STRING, "/map": STRING}
OFFERS = {"/point": [Qos()], "/text": [], "/map": [LATCHED]}
MCAP_OPTIONS = {
    **{name: {"compression": name} for name in ("zstd", "lz4", "none")},
    "no chunks": {"use_chunking": False},
    "no message index": {"index_types": IndexType.CHUNK | IndexType.METADATA},
}
MESSAGE = struct.Struct("<BQHIQ")
"""Opcode, length, channel, sequence number and log time."""
MAKERS = ("lz4", "no chunks", "no message index", "rosbags")


def write_file(path, rows, kinds=KINDS, offers=OFFERS, chunk_size=4000, **options):
    """Write a file of rows or Given with the mcap library, see bag_makers.mcap_writing."""
    return write_mcap(path, rows, kinds, offers, chunk_size=chunk_size, **options)


def write_bag(folder, maker):
    """Write the drive with one of MAKERS; return the folder or file."""
    if maker in MCAP_OPTIONS:
        folder.mkdir()
        return write_file(folder / "other.mcap", drive(), **MCAP_OPTIONS[maker])
    # rosbags ends a chunk only when it has 1 MiB.
    return write_rosbags(folder, drive(padding=6000), KINDS, OFFERS)


def files_of(path):
    return sorted(path.glob("*.mcap"), key=lambda one: (len(one.name), one.name)) if path.is_dir() else [path]


def facts(path):
    """All messages by mcap's own reader: of each file in the order of log time, every checksum verified."""
    found = []
    for file in files_of(path):
        with file.open("rb") as stream:
            for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
                found.append(
                    Fact(
                        channel.topic, message.sequence, message.log_time, message.publish_time, message.data,
                        schema.name, schema.encoding, schema.data, tuple(sorted(channel.metadata.items())),
                    )
                )  # fmt: skip
    return found


def check_metadata(folder):
    """Compare metadata.yaml, and the statistics of each file, with the messages found."""
    content = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert content["relative_file_paths"] == [file.name for file in files_of(folder)]
    assert [entry["path"] for entry in content["files"]] == content["relative_file_paths"]
    of_file = {file.name: facts(file) for file in files_of(folder)}
    everything = [one for found in of_file.values() for one in found]
    for entry in [*content["files"], {**content, "path": None}]:
        found = of_file[entry["path"]] if entry["path"] else everything
        times = [one.log_time for one in found]
        assert entry["message_count"] == len(found)
        assert entry["starting_time"]["nanoseconds_since_epoch"] == min(times, default=0)
        assert entry["duration"]["nanoseconds"] == (max(times) - min(times) if times else 0)
    counts = {one["topic_metadata"]["name"]: one["message_count"] for one in content["topics_with_message_count"]}
    assert len(counts) == len(content["topics_with_message_count"])
    assert Counter(counts) == Counter(one.topic for one in everything)
    for file in files_of(folder):
        with file.open("rb") as stream:
            summary = make_reader(stream).get_summary()
        statistics, own = summary.statistics, of_file[file.name]
        assert statistics.message_count == len(own)
        assert statistics.chunk_count == len(summary.chunk_indexes)
        found = Counter()
        for number, count in statistics.channel_message_counts.items():
            found[summary.channels[number].topic] += count
        assert found == Counter(one.topic for one in own)
        assert indexed(file, summary.chunk_indexes) == sorted(one.log_time for one in own)
    return everything


def write_new(new, out):
    """Write a new bag and check it: progress, metadata, and the same messages by rosbags; return them."""
    done = []
    new.write(out, done.append)
    assert sum(done) == new.size
    found = check_metadata(out)
    by_rosbags = [(topic, *row) for topic, rows in read(out, raw=True).items() for row in rows]
    assert sorted(by_rosbags) == sorted((one.topic, one.log_time, one.data) for one in found)
    return found


def indexed(file, chunks):
    """Log times of the messages that the message indexes lead to; mcap's reader does without these indexes."""
    times = []
    with file.open("rb") as stream:
        for place in chunks:
            stream.seek(place.chunk_start_offset)
            chunk = next(StreamReader(stream, skip_magic=True, emit_chunks=True).records)
            data = get_chunk_data_stream(chunk)[0].read(place.uncompressed_size)
            for channel, offset in place.message_index_offsets.items():
                stream.seek(offset)
                index = next(StreamReader(stream, skip_magic=True).records)
                assert index.channel_id == channel
                for time, at in index.records:
                    assert MESSAGE.unpack_from(data, at)[::2] == (5, channel, time)
                    times.append(time)
    return sorted(times)
