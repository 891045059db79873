"""Stamps from the first bytes of messages, against rosbags; quantiles from bounded storage, against numpy's."""

import math

import numpy as np
import pytest
import view_bags
from bag_makers import STORE
from hypothesis import given
from hypothesis import strategies as st

from diffbot_bag.tools.header_stamps import begins_with_header, stamps_of
from diffbot_bag.tools.quantiles import ACCURACY, Quantiles


def test_types_with_a_header_are_recognised_by_their_definition():
    stamped = set()
    for name, (_, fields) in STORE.fielddefs.items():
        is_stamped = bool(fields) and fields[0][1][0].name == "NAME" and fields[0][1][1] == "std_msgs/msg/Header"
        assert begins_with_header(STORE.generate_msgdef(name, ros_version=2)[0]) is is_stamped, name
        stamped |= {name} if is_stamped else set()
    assert len(stamped) > 40
    assert {"nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"} <= stamped


@pytest.mark.parametrize("little_endian", [True, False])
def test_stamps_of_both_byte_orders(little_endian):
    kind, times = "std_msgs/msg/Header", [(1_700_000_000, 123_456_789), (-5, 4), (0, 7), (2**31 - 1, 999_999_999)]
    heads = []
    for sec, nanosec in times:
        stamp = view_bags.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        message = view_bags.make(kind, stamp=stamp, frame_id="map")
        heads.append(bytes(STORE.serialize_cdr(message, kind, little_endian=little_endian))[:12])
    assert stamps_of(heads).tolist() == [sec * 10**9 + nanosec for sec, nanosec in times]


def test_what_has_no_stamp_is_zero():
    stamp = b"\x01\0\0\0\x02\0\0\0"
    good, short, parameters, unknown = b"\0\1\0\0", b"\0\1\0\0" + stamp[:-1], b"\0\3\0\0", b"\1\1\0\0"
    heads = [good + stamp, short, parameters + stamp, unknown + stamp, b"", good + bytes(8)]
    assert stamps_of(heads).tolist() == [1_000_000_002, 0, 0, 0, 0, 0]
    assert stamps_of([]).dtype == np.int64


INTEGERS = st.integers(-(2**62), 2**62) | st.integers(-5, 5)


@given(st.lists(st.lists(INTEGERS, max_size=30), min_size=1, max_size=4), st.floats(0.0, 1.0))
def test_a_quantile_is_within_the_accuracy_of_the_exact_one(parts, share):
    quantiles = Quantiles()
    for part in parts:
        quantiles.add(np.array(part, np.int64))
    values = np.sort(np.array([one for part in parts for one in part], np.int64))
    if len(values) == 0:
        assert math.isnan(quantiles.quantile(share))
        return
    exact = values[max(0, math.ceil(share * len(values)) - 1)]
    assert quantiles.quantile(share) == pytest.approx(exact, rel=ACCURACY, abs=0.0)
    assert (quantiles.count, quantiles.smallest, quantiles.largest) == (len(values), values[0], values[-1])
