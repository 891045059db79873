"""Columns and texts from the bytes of messages, against rosbags' serialisation."""

import numpy as np
import pytest
import view_bags

from diffbot_bag.bag.number_rows import LAYOUTS, NumberRows


def data_of(message):
    kind, content = message
    return bytes(view_bags.STORE.serialize_cdr(content, kind))


def test_a_type_without_a_stamp_has_its_log_time_in_more_messages_than_a_batch():
    rows = NumberRows(LAYOUTS["geometry_msgs/msg/Twist"], (0, 5))
    data = data_of(view_bags.command(0.5, -1.0))
    for time in range(10_000):
        rows.add(time, data)
    stamps, _, numbers = rows.columns()
    assert np.array_equal(stamps, np.arange(10_000))
    assert np.array_equal(numbers, [[0.5, -1.0]] * 10_000)


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
