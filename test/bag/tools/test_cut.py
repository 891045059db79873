"""Trim, filter and merge: what is in the new bag is compared with the old by readers that no one here wrote."""

from contextlib import ExitStack

import cut_bags
import pytest
from bag_makers import BEGIN, LATCHED, POINT, STRING, point
from cut_bags import MAKERS, STEP, Given, facts, write_new
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from diffbot_bag.bag.metadata import read as read_metadata
from diffbot_bag.bag.qos import Qos
from diffbot_bag.bag.writer import BagWriter
from diffbot_bag.tools import cut
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
    offers = {"/two": [LATCHED] * 2, "/short": [LATCHED._replace(lifespan=10)], "/plain": [Qos()]}
    messages = [Given(topic, BEGIN + n, point(n)) for n in range(50) for topic in offers]
    path = cut_bags.write_file(tmp_path / "a.mcap", messages, POINT, offers, chunk_size=300)
    found = make(tmp_path / "part", lambda one: cut.trim(one, Span(BEGIN + 100, BEGIN + 200)), path)
    assert [(one.topic, one.data) for one in found] == [("/two", point(48)), ("/two", point(49))]


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


def test_merge_refuses_a_topic_with_another_definition_or_type(zstd_bag, tmp_path):
    for topic, words in (
        ("/point", f"/point: {zstd_bag} and .* have different definitions of {POINT}: leave"),
        ("/text", f"/text is std_msgs/msg/String in {zstd_bag} and {POINT} in .*: leave one out with"),
    ):
        options = {"definitions": {POINT: b"float64 x\nfloat64 y\nfloat32 z"}, "hashes": {POINT: ""}}
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
    assert sorted(part) == sorted(inside + part[: bool(earlier)])
