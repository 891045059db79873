"""Trim, filter and merge: what is in the new bag is compared with the old by readers that no one here wrote."""

from contextlib import ExitStack

import cut_bags
import pytest
from bag_makers import BEGIN, LATCHED, POINT, STRING, definition, point
from cut_bags import MAKERS, STEP, Given, facts, files_of, write_new
from damaged_bags import messages_of
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from diffbot_bag.bag.message_definitions import MessageDefinitions
from diffbot_bag.bag.metadata import read as read_metadata
from diffbot_bag.bag.qos import Qos
from diffbot_bag.bag.topic_selection import TopicSelection
from diffbot_bag.bag.writer import BagWriter
from diffbot_bag.tools import cut, source_bag
from diffbot_bag.tools.source_bag import SourceBag
from diffbot_bag.tools.span import Span
from diffbot_core.errors import DiffbotError


@pytest.fixture(scope="module", params=MAKERS)
def bag(request, tmp_path_factory):
    return cut_bags.write_bag(tmp_path_factory.mktemp("bags") / "run", request.param)


@pytest.fixture(scope="module")
def zstd_bag(tmp_path_factory):
    return cut_bags.write_bag(tmp_path_factory.mktemp("bags") / "run", "zstd")


def make(out, plan, *paths):
    with ExitStack() as stack:
        found = write_new(plan(*(stack.enter_context(SourceBag(path)) for path in paths)), out)
    assert [one.name for one in out.parent.iterdir() if one.name.endswith(".part")] == []
    return found


SPANS = {
    "middle": (75 * STEP, 160 * STEP, 170),
    "between messages": (75 * STEP + 1, 160 * STEP + 1, 170),
    "one message": (25 * STEP + 3, 25 * STEP + 4, 1),
    "all": (0, 10**15, 402),
    "nothing inside": (100 * STEP + 4, 101 * STEP, 0),
}


def test_trim_keeps_the_messages_of_the_span_and_the_latched_one_of_before(bag, tmp_path):
    given = facts(bag)
    for name, (start, end, count) in SPANS.items():
        span = Span(BEGIN + start, BEGIN + end)
        inside = [one for one in given if span.start <= one.log_time < span.end]
        earlier = [one for one in given if one.topic == "/map" and one.log_time < span.start][-1:]
        found = make(tmp_path / name, lambda one, span=span: cut.trim(one, span, latched=False), bag)
        assert found == inside, name
        assert len(found) == count
        found = make(tmp_path / f"{name} latched", lambda one, span=span: cut.trim(one, span), bag)
        assert found == [one._replace(log_time=span.start) for one in earlier] + inside, name


def test_a_latched_topic_keeps_one_message_of_each_publisher_unless_its_lifespan_is_over(tmp_path):
    offers = {
        "/two": [LATCHED] * 2, "/short": [LATCHED._replace(lifespan=10)], "/later": [LATCHED], "/plain": [Qos()]
    }  # fmt: skip
    messages = [Given(topic, BEGIN + n, point(n)) for n in range(50) for topic in offers if topic != "/later"]
    messages += [
        Given("/short", BEGIN + 89, b"1"),
        Given("/short", BEGIN + 100, b"2"),
        Given("/later", BEGIN + 101, b"3"),
    ]
    path = cut_bags.write_file(tmp_path / "a.mcap", messages, POINT, offers, chunk_size=300)
    found = make(tmp_path / "part", lambda one: cut.trim(one, Span(BEGIN + 100, BEGIN + 200)), path)
    assert [(one.topic, one.data) for one in found] == [
        ("/two", point(48)), ("/two", point(49)), ("/short", b"2"), ("/later", b"3")
    ]  # fmt: skip


def test_trim_reads_and_unpacks_only_what_it_needs(zstd_bag, tmp_path, monkeypatch):
    """Every chunk outside of the span may be damaged; those inside are copied byte by byte."""
    with zstd_bag.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    content = bytearray(zstd_bag.read_bytes())
    span = Span(BEGIN + 75 * STEP, BEGIN + 100 * STEP)
    inside = [one for one in chunks if one.message_start_time < span.end and one.message_end_time >= span.start]
    latched = BEGIN + 55 * STEP + 5
    kept = [one for one in chunks if one in inside or one.message_start_time <= latched <= one.message_end_time]
    assert 3 <= len(inside) < len(kept) < len(chunks) / 3
    for one in chunks:
        if one not in kept:
            content[one.chunk_start_offset + 60] ^= 255
    path = tmp_path / "damaged.mcap"
    path.write_bytes(content)
    unpacked = []
    real = source_bag.verified_chunk
    monkeypatch.setattr(source_bag, "verified_chunk", lambda *given: unpacked.append(given[1]) or real(*given))
    make(tmp_path / "part", lambda one: cut.trim(one, span), path)
    assert len(unpacked) == 3
    written = (tmp_path / "part" / "part_0.mcap").read_bytes()
    for one in inside[1:-1]:
        assert content[one.chunk_start_offset : one.chunk_start_offset + one.chunk_length] in written
    with pytest.raises(DiffbotError, match="`diffbot bag repair` saves what is intact"):
        make(tmp_path / "more", lambda one: cut.trim(one, Span(BEGIN + 1, span.end)), path)


FILTERS = [
    (TopicSelection(topics=("/point", "/map")), (), {"/point", "/map"}),
    (TopicSelection(regex="/.*t", exclude_regex="/te.*"), (), {"/point"}),
    (TopicSelection(), (STRING,), {"/text", "/map"}),
    (TopicSelection(exclude_topics=("/text",)), (STRING,), {"/map"}),
]


def test_filter_keeps_topics_and_types(bag, tmp_path):
    given = facts(bag)
    for number, (selection, types, topics) in enumerate(FILTERS):
        out = tmp_path / str(number)
        found = make(out, lambda one, chosen=(selection, types): cut.select(one, *chosen), bag)
        assert found == [one for one in given if one.topic in topics]
        assert {topic.name for topic in read_metadata(out).topics} == topics
        # No trace of the others, for a reader that does not use the index either.
        assert {topic for file in files_of(out) for topic, *_ in messages_of(file.read_bytes())} == topics


def test_a_selection_of_nothing_is_refused(zstd_bag):
    for selection, types, words in (
        (TopicSelection(topics=("/nothing",)), (), "topics: /nothing is not in the bag, which has /point, /text, /map"),
        (TopicSelection(), ("a/msg/B",), "types: a/msg/B is not in the bag"),
        (TopicSelection(regex="x"), (), "no topic of the bag is selected"),
    ):
        with SourceBag(zstd_bag) as one, pytest.raises(DiffbotError, match=words):
            cut.select(one, selection, types)


def test_merge_unites_qos_numbers_and_facts(tmp_path):
    best_effort = Qos(reliability="best_effort")
    kinds, offers = {"/a": STRING, "/b": STRING, "/same": POINT}, {"a": [Qos()], "b": [Qos(), Qos(), best_effort]}
    paths = []
    for name, topics in (("a", ("/same", "/a")), ("b", ("/b", "/same"))):
        rows = [Given(topic, BEGIN + n, name.encode() + bytes([n])) for n in range(20) for topic in topics]
        types = {topic: kinds[topic] for topic in topics}
        path = tmp_path / f"{name}.mcap"
        paths.append(cut_bags.write_file(path, rows, types, {"/same": offers[name]}, attached=("both", name)))
    found = make(tmp_path / "all", lambda *bags: cut.merge(bags), *paths)
    assert len(found) == 80
    assert {one.topic: (one.type, one.data[:1]) for one in found if one.topic != "/same"} == {
        "/a": (STRING, b"a"), "/b": (STRING, b"b")
    }  # fmt: skip
    (topic,) = [one for one in read_metadata(tmp_path / "all").topics if one.name == "/same"]
    assert sorted(topic.qos) == sorted([Qos(), Qos(), best_effort])
    with (tmp_path / "all" / "all_0.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert [(one.name, one.data) for one in reader.iter_attachments()] == [
            ("both", b"content of both"), ("a", b"content of a"), ("b", b"content of b")
        ]  # fmt: skip
        assert [one.name for one in reader.iter_metadata()] == ["both", "a", "b", "rosbag2"]


def test_definitions_of_other_recorders_are_the_same(tmp_path):
    """rosbags names the package of each type, and gives neither constants nor default values; ROS's own text does."""
    kind, path, found = "geometry_msgs/msg/Pose", tmp_path / "all", []
    for text in (MessageDefinitions().schema_text(kind).encode(), definition(kind)):
        name = tmp_path / f"{len(found)}.mcap"
        found.append(cut_bags.write_file(name, [Given("/pose", 5, bytes(60))], kind, definitions={kind: text}))
    with SourceBag(found[0]) as one, SourceBag(found[1]) as two:
        cut.merge([one, two]).write(path, lambda _: None)
    assert len(facts(path)) == 2


@pytest.mark.parametrize(
    ("type_hash", "text"),
    [
        ("RIHS01_other", definition(POINT)),
        ("", b"float64 x\nfloat64 y\nfloat32 z"),
        ("", definition(POINT) + b"=" * 80 + b"\nMSG: a/B\nint8 a"),
    ],
)
def test_merge_refuses_a_topic_with_another_definition_or_type(zstd_bag, tmp_path, type_hash, text):
    options = {"definitions": {POINT: text}, "hashes": {POINT: type_hash}}
    for topic, words in (
        ("/point", f"/point: {zstd_bag} and .* have different definitions of {POINT}: leave"),
        ("/text", f"/text is std_msgs/msg/String in {zstd_bag} and {POINT} in .*: leave one out with"),
    ):
        other = cut_bags.write_file(tmp_path / "b.mcap", [Given(topic, 5, b"")], POINT, **options)
        with SourceBag(zstd_bag) as one, SourceBag(other) as two, pytest.raises(DiffbotError, match=words):
            cut.merge([one, two])


def test_custom_data_are_kept_and_losses_added(tmp_path):
    for name, lost in (("a", "3"), ("b", "4")):
        writer = BagWriter(tmp_path / name)
        writer.write(writer.add_topic("/point", POINT), point(1), BEGIN, BEGIN)
        writer.close({"lost_messages": lost, "robot": name, "place": "hall"})
    make(tmp_path / "all", lambda *bags: cut.merge(bags), tmp_path / "a", tmp_path / "b" / "b_0.mcap")
    custom_data = {"lost_messages": "7", "robot": "a, b", "place": "hall"}
    assert dict(read_metadata(tmp_path / "all").custom_data) == custom_data
    make(tmp_path / "part", lambda one: cut.trim(one, Span(BEGIN, BEGIN + 1)), tmp_path / "a")
    assert read_metadata(tmp_path / "part").custom_data["lost_messages"] == "3"


TIMES = st.lists(st.tuples(st.sampled_from(["/point", "/text", "/map"]), st.integers(0, 60)), max_size=60)


@settings(max_examples=8)
@given(TIMES, TIMES, st.integers(0, 61), st.integers(0, 61), st.integers(40, 900))
def test_merge_then_trim_of_messages_in_any_order(tmp_path_factory, first, second, start, end, chunk_size):
    folder = tmp_path_factory.mktemp("any")
    paths = []
    for name, rows in (("a", first), ("b", second)):
        messages = [Given(topic, 100 + time, name.encode(), 7, n) for n, (topic, time) in enumerate(rows)]
        paths.append(cut_bags.write_file(folder / f"{name}.mcap", messages, chunk_size=chunk_size))
    found = make(folder / "all", lambda *bags: cut.merge(bags), *paths)
    given = [one for path in paths for one in facts(path)]
    assert sorted(found) == sorted(given)
    # Of equal times, those of the first bag come first.
    order = [(one.log_time, one.data) for one in found]
    assert order == sorted((one.log_time, one.data) for one in given)
    span = Span(100 + start, 100 + max(start + 1, end))
    part = make(folder / "part", lambda one: cut.trim(one, span), folder / "all")
    inside = [one for one in found if span.start <= one.log_time < span.end]
    earlier = [one for one in found if one.log_time < span.start and one.topic == "/map"]
    assert len(part) == len(inside) + bool(earlier)
    heads = [one for one in part if one not in inside]
    if earlier and heads:
        assert heads[0]._replace(log_time=0) in [
            one._replace(log_time=0) for one in earlier if one.log_time == earlier[-1].log_time
        ]
    assert sorted(part) == sorted(inside + part[: bool(earlier)])
