"""Several bags as one: order, counts, latched messages, and topics that do not fit together."""

import pytest
from bag_makers import BEGIN, LATCHED, MS, point, write_mcap, write_rosbags

from diffbot_bag.bag.merged_bags import MergedBags
from diffbot_core.errors import DiffbotError


def times(first, count, period):
    return [BEGIN + (first + index * period) * MS for index in range(count)]


@pytest.fixture
def three(tmp_path):
    """/a in two bags that overlap in time, one of them of another maker, and /b in a third, after both."""
    rows = [("/a", time, point(1)) for time in times(0, 100, 2)]
    one = write_mcap(tmp_path / "one.mcap", rows, offers={"/a": [LATCHED]})
    two = write_rosbags(tmp_path / "two", [("/a", time, point(2)) for time in times(51, 100, 2)])
    three = write_mcap(tmp_path / "three.mcap", [("/b", time, point(3)) for time in times(1000, 10, 1)])
    return one, two, three


def test_messages_come_in_the_order_of_time_from_all_bags(three):
    bags = MergedBags(three)
    found = [(message.log_time, message.data) for message in bags.messages(["/a", "/b"], 0, 2**62)]
    expected = [(time, point(1)) for time in times(0, 100, 2)] + [(time, point(2)) for time in times(51, 100, 2)]
    expected += [(time, point(3)) for time in times(1000, 10, 1)]
    assert found == sorted(expected)
    assert (bags.start, bags.end) == (BEGIN, BEGIN + 1009 * MS)
    assert {name: topic.message_count for name, topic in bags.topics.items()} == {"/a": 200, "/b": 10}
    assert len(list(bags.messages(["/b"], BEGIN + 1005 * MS, bags.end))) == 5
    found = [(message.log_time - BEGIN, message.data) for message in bags.last_before(BEGIN + 100 * MS, ["/a", "/b"])]
    assert found == [(98 * MS, point(1)), (99 * MS, point(2))]
    assert bags.last_before(BEGIN, ["/a"]) == []
    # The latched offer of one bag is among those of the merged topic, whatever its place.
    assert "transient_local" in [qos.durability for qos in bags.topics["/a"].qos]
    bags.close()


def test_a_bag_given_twice_or_missing_is_refused(three, tmp_path):
    link = tmp_path / "link.mcap"
    link.symlink_to(three[0])
    for again in (three[0], link):
        with pytest.raises(DiffbotError, match=r"bags = .*: must be a bag that is not given already"):
            MergedBags([three[0], three[1], again])
    with pytest.raises(DiffbotError, match=r"no bag .*nowhere: no such file"):
        MergedBags([three[0], tmp_path / "nowhere"])
