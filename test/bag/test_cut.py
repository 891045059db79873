"""Trim, filter and merge: the messages of new bags, read by the mcap library, against the original messages."""

import os
from contextlib import closing

import pytest
from bag_makers import (
    BEGIN,
    LATCHED,
    POINT,
    STRING,
    facts,
    mcap_writing,
    point,
    string,
    write_mcap,
)
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from diffbot_bag.bag import BagReader, MergedBags
from diffbot_bag.cut import cut
from diffbot_bag.qos import Qos
from diffbot_bag.writer import new_bag
from diffbot_core.errors import DiffbotError

OFFERS = {"/point": [Qos()], "/map": [LATCHED]}


@pytest.fixture(autouse=True, scope="module")
def without_waiting_for_the_disk():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


def cut_facts(out, *paths, **options):
    """Cut and return the facts of the new bag."""
    with closing(MergedBags(paths)) as bags:
        written = cut(bags, out, **options)
    found = facts(out)
    assert written.message_count == len(found)
    assert [one.name for one in out.parent.iterdir() if one.name.endswith(".part")] == []
    return found


def test_a_latched_topic_keeps_one_message_of_each_publisher_unless_its_lifespan_is_over(tmp_path):
    offers = {"/two": [LATCHED] * 2, "/short": [LATCHED._replace(lifespan=10)], "/plain": [Qos()]}
    rows = [(topic, BEGIN + n, point(n)) for n in range(50) for topic in offers]
    path = write_mcap(tmp_path / "a.mcap", rows, POINT, offers, chunk_size=300)
    found = cut_facts(tmp_path / "part", path, start=BEGIN + 100)
    assert [(one[0], one[4]) for one in found] == [("/two", point(48)), ("/two", point(49))]


def test_parameters_losses_and_other_encodings_are_copied(tmp_path):
    for name, lost in (("a", "3"), ("b", "4")):
        with new_bag(tmp_path / name) as writer:
            writer.attach("parameters.json", "application/json", b'{"/%s": {"gain": 1.5}}' % name.encode())
            writer.write(writer.add_topic(f"/{name}", POINT), point(1), BEGIN, BEGIN)
            writer.custom_data = {"lost_messages": lost, f"lost /{name}": lost, "site": name}
    with (
        (tmp_path / "other.mcap").open("wb") as stream,
        mcap_writing(stream, {}) as (writer, _),
    ):
        schema = writer.register_schema("pkg.Message", "protobuf", b"\x0a\xff\x00")
        writer.add_message(writer.register_channel("/proto", "protobuf", schema), BEGIN + 1, b"\xff\x01", BEGIN)
    with closing(MergedBags([tmp_path / "a", tmp_path / "b"])) as bags:
        cut(bags, tmp_path / "both")
    with BagReader(tmp_path / "both") as bag:
        assert bag.custom_data == {"lost_messages": "7", "lost /a": "3", "lost /b": "4", "site": "a, b"}
    with closing(MergedBags([tmp_path / "a", tmp_path / "b", tmp_path / "other.mcap"])) as bags:
        cut(bags, tmp_path / "all", keep=lambda topic: topic.name != "/b")
    with BagReader(tmp_path / "all") as bag:
        assert bag.node_parameters() == {"/a": {"gain": 1.5}, "/b": {"gain": 1.5}}
        assert bag.custom_data == {"site": "a, b"}, "the losses of one bag are not known"
        assert {name: one.encoding for name, one in bag.topics.items()} == {"/a": "cdr", "/proto": "protobuf"}
    with (tmp_path / "all" / "all_0.mcap").open("rb") as stream:
        found = list(make_reader(stream).iter_messages(topics=["/proto"]))
    assert [(s.name, s.encoding, s.data, c.message_encoding, m.data) for s, c, m in found] == [
        ("pkg.Message", "protobuf", b"\x0a\xff\x00", "protobuf", b"\xff\x01")
    ]


def test_a_cut_without_topics_is_refused_and_nothing_is_written(tmp_path):
    write_mcap(tmp_path / "a.mcap", [("/same", BEGIN, string("1"))], STRING)
    error = pytest.raises(DiffbotError, match="no topic of the bag is selected: select from /same")
    with closing(MergedBags([tmp_path / "a.mcap"])) as bags, error:
        cut(bags, tmp_path / "new", keep=lambda _: False)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["a.mcap"]


def test_bags_with_different_definitions_of_a_type_are_not_merged(tmp_path):
    for name, type_hash in (("old", "RIHS01_00"), ("new", "")):
        with new_bag(tmp_path / name) as writer:
            channel = writer.add_topic("/same", POINT, type_hash=type_hash)
            writer.write(channel, point(1), BEGIN, BEGIN)
    error = pytest.raises(DiffbotError, match=f"/same: the bags were recorded with different definitions of {POINT}")
    with closing(MergedBags([tmp_path / "old", tmp_path / "new"])) as bags, error:
        cut(bags, tmp_path / "both")
    assert not (tmp_path / "both").exists()


ROWS = st.lists(st.tuples(st.sampled_from(["/point", "/map"]), st.integers(0, 30)), max_size=30)


@settings(max_examples=40)
# Blocks that overlap in time: the second message at 1 belongs to a block that begins earlier.
@example([], [("/point", 1), ("/point", 0), ("/point", 1)], 0, 0, 100)
@given(ROWS, ROWS, st.integers(0, 32), st.integers(0, 32), st.sampled_from([100, 300, 10**6]))
def test_merge_and_trim_agree_with_sorted_lists_of_messages(tmp_path_factory, first, second, start, end, chunk_size):
    folder = tmp_path_factory.mktemp("any")
    paths, given_facts = [], []
    for name, rows in (("a", first), ("b", second)):
        made = [(topic, 100 + time, string(name), 7, n) for n, (topic, time) in enumerate(rows)]
        kinds = dict.fromkeys(("/point", "/map"), STRING)
        path = write_mcap(folder / f"{name}.mcap", made, kinds, OFFERS, chunk_size=chunk_size)
        paths.append(path)
        given_facts += facts(path)
    numbers = []
    found = cut_facts(folder / "all", *paths, progress=numbers.append)
    assert sum(numbers) == len(found)
    # Of equal times, those of the first bag come first.
    assert found == sorted(given_facts, key=lambda one: one[1])
    start, end = 100 + start, 100 + max(start + 1, end)
    part = cut_facts(folder / "part", folder / "all", start=start, end=end)
    inside = [one for one in found if start <= one[1] < end]
    # Both bags have a publisher of the map.
    earlier = [one for one in found if one[1] < start and one[0] == "/map"][-2:]
    assert part == [(one[0], start, *one[2:]) for one in earlier] + inside
