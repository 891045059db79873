"""The end of the files that recorder, cut and repair write alike, by the mcap library and by the bytes themselves."""

import io
import struct

import cut_bags
from cut_bags import BEGIN, STEP
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Footer, SummaryOffset
from mcap.stream_reader import StreamReader

from diffbot_bag.tools.cut import trim
from diffbot_bag.tools.source_bag import SourceBag
from diffbot_bag.tools.span import Span


def records_of(content, **options):
    return list(StreamReader(io.BytesIO(content), **options).records)


def test_each_summary_offset_names_the_bytes_of_its_group(tmp_path):
    path = cut_bags.write_file(tmp_path / "source.mcap", cut_bags.drive(), attached=("notes",))
    with SourceBag(path) as bag:
        trim(bag, Span(BEGIN + 30 * STEP, BEGIN + 150 * STEP)).write(tmp_path / "out", lambda _: None)
    content = (tmp_path / "out" / "out_0.mcap").read_bytes()
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
