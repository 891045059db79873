"""Columns and texts from the bytes of messages, against rosbags' serialisation."""

import numpy as np
import pytest
import view_bags

from diffbot_bag.bag.number_rows import LAYOUTS, NumberRows, labelled_layout, labels_of
from diffbot_core.cdr import MAX_ITEMS, CdrCursor, CdrError


def data_of(message):
    kind, content = message
    return bytes(view_bags.STORE.serialize_cdr(content, kind))


@pytest.mark.parametrize("frame", ["", "m", "map", "odom/x", "robot_17/odom"])
def test_numbers_are_read_at_the_places_of_the_definition_and_sorted_by_stamp(frame):
    rows = NumberRows(LAYOUTS["nav_msgs/msg/Odometry"], (0, 1, 43, 48, 84))
    late = view_bags.odometry(2_000_000_007, 3.0, 4.0, 0.0, 0.5, -0.25)
    early = view_bags.odometry(1_000_000_000, 1.0, 2.0, 0.0, 1.5, 0.75, frame=frame)
    early[1].twist.covariance[35] = 42.0
    rows.add(30, data_of(late))
    rows.add(20, data_of(early))
    stamps, log_times, numbers = rows.columns()
    assert stamps.tolist() == [1_000_000_000, 2_000_000_007]
    assert log_times.tolist() == [20, 30]
    assert numbers[:, :4].tolist() == [[1.0, 2.0, 1.5, 0.75], [3.0, 4.0, 0.5, -0.25]]
    assert numbers[0, 4] == 42.0
    assert rows.malformed == 0


def test_a_type_without_a_stamp_has_its_log_time_in_more_messages_than_a_batch():
    rows = NumberRows(LAYOUTS["geometry_msgs/msg/Twist"], (0, 5))
    data = data_of(view_bags.command(0.5, -1.0))
    for time in range(10_000):
        rows.add(time, data)
    stamps, _, numbers = rows.columns()
    assert np.array_equal(stamps, np.arange(10_000))
    assert np.array_equal(numbers, [[0.5, -1.0]] * 10_000)


def test_labelled_numbers_are_found_by_their_names():
    data = data_of(view_bags.law(1_500_000_000, 2.0, 1.0))
    labels = labels_of(data)
    assert labels == list(view_bags.LABELS)
    rows = NumberRows(labelled_layout(labels), [labels.index(name) for name in ("V", "rho", "stamp")])
    rows.add(1, data)
    assert rows.columns()[2].tolist() == [[4.0, 2.0, 1.5]]
    with pytest.raises(CdrError):
        labels_of(data[:40])


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: data[:-1],
        lambda data: data + b"\0",
        lambda data: b"",
        lambda data: b"\x00\x00" + data[2:],
        lambda data: data[:12] + b"\xff\xff\xff\xff" + data[16:],
    ],
    ids=["short", "long", "empty", "big-endian", "endless text"],
)
def test_a_message_that_is_none_is_left_out_and_counted(spoil):
    rows = NumberRows(LAYOUTS["nav_msgs/msg/Odometry"], (0,))
    good = data_of(view_bags.odometry(1, 9.0, 0.0, 0.0))
    rows.add(1, good)
    rows.add(2, spoil(good))
    assert rows.columns()[2].tolist() == [[9.0]]
    assert rows.malformed == 1


def test_a_sequence_cannot_claim_any_length():
    with pytest.raises(CdrError, match="items"):
        CdrCursor(b"\x00\x01\x00\x00" + (MAX_ITEMS + 1).to_bytes(4, "little")).length()
