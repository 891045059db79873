"""Whether stamps advance: the only sign of life of a sender."""

import pytest

from diffbot_core.stamps import Lateness, StampWatch


def test_only_a_later_stamp_advances_and_time_may_begin_anew():
    watch = StampWatch()
    #         first, later, again, out of order, again, later | restart by more than a second, and on
    stamps = [5_000_000_000, 5_100_000_000, 5_100_000_000, 5_000_000_000, 5_100_000_000, 5_200_000_000, 0, 0, 1]
    assert [watch.advances(stamp) for stamp in stamps] == [True, True, False, False, False, True, False, False, True]


def test_a_clock_that_is_set_back_by_less_than_a_second_advances_from_the_third_message_on():
    watch, period = StampWatch(), 50_000_000
    for number in range(40):
        assert watch.advances(number * period)
    assert [watch.advances((number - 16) * period) for number in range(40, 45)] == [False, False, True, True, True]
    # Two senders, one of them behind: only the other one advances.
    two = StampWatch()
    both = [stamp for number in range(20, 40) for stamp in (number * period, (number - 10) * period)]
    assert [two.advances(stamp) for stamp in both] == [True, False] * 20


def late(offset, arrivals):
    """Lateness of messages stamped (stamp [s], delay [s]) by a clock that is ``offset`` [s] ahead of the receiver's."""
    lateness = Lateness()
    return [lateness.next(round((stamp + offset) * 1e9), stamp + delay) for stamp, delay in arrivals]


@pytest.mark.parametrize("offset", [0.0, -3600.0, 1.8e9])
def test_a_message_is_late_by_what_it_is_older_than_usual_also_the_last_of_a_burst_after_silence(offset):
    usual = [(0.1 * number, 0.03 + 0.01 * (number % 3)) for number in range(50)]
    # Held up for 6 s: what waited arrives at once.
    burst = [(5.0 + 0.1 * number, 6.0 - 0.1 * number) for number in range(20)]
    found = late(offset, [*usual, *burst])
    assert found[3:50] == pytest.approx([delay - 0.03 for _, delay in usual[3:]], abs=1e-6)
    assert found[50:] == pytest.approx([delay - 0.03 for _, delay in burst], abs=1e-6)


def test_a_larger_delay_becomes_usual_within_seconds_and_a_clock_set_back_at_once():
    slower = [(0.1 * number, 0.03 if number < 30 else 0.83) for number in range(100)]
    found = late(0.0, slower)
    assert found[30:40] == pytest.approx([0.8] * 10)
    assert found[80:] == pytest.approx([0.0] * 20)
    lateness = Lateness()
    messages = [(1.0, 90.0), (1.1, 90.1), (1.2, 20.0)]
    assert [lateness.next(round(stamp * 1e9), now) for now, stamp in messages] == [0.0] * 3
