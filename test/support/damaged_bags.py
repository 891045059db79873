"""Bags of several writers, the damage done to them, and what must survive it by the mcap library's own reading."""

import io
import random
from collections import Counter
from typing import NamedTuple

from bag_makers import BEGIN, LATCHED, MS, POINT, mcap_writing
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from diffbot_bag.bag.qos import Qos

OFFERS = {"/a": [Qos()], "/b": [Qos()], "/latched": [LATCHED]}
TOPICS = tuple(OFFERS)


class Original(NamedTuple):
    """A file, and its chunks as the mcap library finds them: first byte, last byte + 1 and messages."""

    content: bytes
    chunks: list

    @property
    def messages(self):
        return sum((found for _, _, found in self.chunks), Counter())


def mcap_file(compression="zstd", count=1500, chunk_size=4000, seed=1, **options):
    """Bytes of a finished file with three topics; chunks of about 60 messages, an attachment in the middle."""
    generator = random.Random(seed)
    stream = io.BytesIO()
    options |= {"chunk_size": chunk_size, "compression": compression}
    with mcap_writing(stream, dict.fromkeys(TOPICS, POINT), OFFERS, **options) as (writer, channels):
        for index in range(count):
            time = BEGIN + index * MS
            # Half of it does not compress.
            data = b"\0\1\0\0" + bytes(12) + generator.randbytes(12)
            writer.add_message(channels[TOPICS[index % 3]], time, data, time - 1, index)
            if index == count // 2:
                writer.add_attachment(5, BEGIN, "parameters.yaml", "text/yaml", b"gain: 1.0\n" * 50)
                writer.add_metadata("robot", {"name": "one"})
    return stream.getvalue()


def original(content):
    """Return a finished file with its chunks."""
    summary = make_reader(io.BytesIO(content)).get_summary()
    chunks = []
    for chunk in summary.chunk_indexes:
        begin, end = chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length
        # A chunk by itself is a stream without magic bytes; it ends without a footer.
        chunks.append((begin, end, messages_of(content[begin:end], summary.channels)))
    return Original(content, chunks)


def messages_of(records, channels=None, **options):
    """Count the messages in a stream of records: topic, times, sequence number and data."""
    found, known = Counter(), dict(channels or {})
    stream = StreamReader(io.BytesIO(records), skip_magic=channels is not None, **options)
    try:
        for record in stream.records:
            if isinstance(record, Channel):
                known[record.id] = record
            elif isinstance(record, Message):
                topic = known[record.channel_id].topic
                found[topic, record.log_time, record.publish_time, record.sequence, record.data] += 1
    except Exception:
        if channels is None:
            raise
    return found


def surviving(whole, changed, cut):
    """Messages of the chunks of which no byte is changed or cut off."""
    kept = Counter()
    for begin, end, messages in whole.chunks:
        if end <= cut and not any(begin <= place < end for place in changed):
            kept += messages
    return kept


def damage(whole, generator):
    """Cut a file or flip bits of it; return its bytes, the changed places and the length left."""
    content = bytearray(whole.content)
    cut = len(content)
    kind = generator.choice(("cut", "flip", "burst", "zeros", "both"))
    changed = set()
    if kind in ("cut", "both"):
        cut = generator.randrange(9, len(content))
    if kind in ("flip", "both"):
        changed |= {generator.randrange(8, len(content)) for _ in range(generator.randint(1, 4))}
    if kind in ("burst", "zeros"):
        start = generator.randrange(8, len(content))
        changed |= set(range(start, min(start + generator.randint(2, 3000), len(content))))
    for place in changed:
        content[place] = 0 if kind == "zeros" else content[place] ^ (1 << generator.randrange(8))
    return bytes(content[:cut]), changed, cut
