"""The end of the files that recorder, cut and repair write, by the mcap library and by the bytes themselves."""

import io
import struct

import cut_bags
import pytest
from cut_bags import BEGIN, STEP
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Footer, SummaryOffset
from mcap.stream_reader import StreamReader

from diffbot_bag.bag.writer import BagWriter
from diffbot_bag.tools.cut import trim
from diffbot_bag.tools.repair import repair_bag
from diffbot_bag.tools.source_bag import SourceBag
from diffbot_bag.tools.span import Span


def record(folder, _):
    bag = BagWriter(folder, chunk_size=3000)
    channels = {name: bag.add_topic(name, kind, qos) for name, (kind, qos) in cut_bags.TOPICS.items()}
    bag.attach("notes", "text/plain", b"content")
    for one in cut_bags.drive():
        bag.write(channels[one.topic], one.data, one.log_time, one.publish_time, one.sequence)
    bag.close()


def cut(folder, source):
    with SourceBag(source) as bag:
        trim(bag, Span(BEGIN + 30 * STEP, BEGIN + 150 * STEP)).write(folder, lambda _: None)


def repair(folder, source):
    broken = source.with_name("broken.mcap")
    broken.write_bytes(source.read_bytes()[:-100])
    repair_bag(broken, folder)


@pytest.fixture(params=[record, cut, repair], ids=lambda make: make.__name__)
def content(request, tmp_path):
    source = cut_bags.write_mcap(tmp_path / "source.mcap", cut_bags.drive(), extras=("notes",))
    request.param(tmp_path / "out", source)
    (path,) = (tmp_path / "out").glob("*.mcap")
    assert len(cut_bags.check_metadata(tmp_path / "out")) > 200
    return path.read_bytes()


def records_of(content, **options):
    return list(StreamReader(io.BytesIO(content), **options).records)


def test_each_summary_offset_names_the_bytes_of_its_group(content):
    footer = records_of(content)[-1]
    assert isinstance(footer, Footer)
    offsets = records_of(content[footer.summary_offset_start :], skip_magic=True)[:-1]
    assert {one.group_opcode for one in offsets} == {
        Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX,
        Opcode.METADATA_INDEX,
    }  # fmt: skip
    at = footer.summary_start
    for one in offsets:
        assert isinstance(one, SummaryOffset)
        assert one.group_start == at
        end = at + one.group_length
        while at < end:
            opcode, length = struct.unpack_from("<BQ", content, at)
            assert opcode == one.group_opcode
            at += 9 + length
        assert at == end
    assert at == footer.summary_offset_start
    reader = make_reader(io.BytesIO(content), validate_crcs=True)
    found = reader.get_summary().statistics
    assert (found.attachment_count, found.schema_count, found.channel_count) == (1, 2, 3)
    assert next(reader.iter_attachments()).name == "notes"
