"""Whether stamps advance: the only sign of life of a sender."""

import pytest

from diffbot_core.stamps import PeriodWatch, StampWatch


def test_only_a_later_stamp_advances_and_time_may_begin_anew():
    watch = StampWatch()
    #         first, later, again, out of order, again, later | restart by more than a second, and on
    stamps = [5_000_000_000, 5_100_000_000, 5_100_000_000, 5_000_000_000, 5_100_000_000, 5_200_000_000, 0, 0, 1]
    assert [watch.advances(stamp) for stamp in stamps] == [True, True, False, False, False, True, False, False, True]


def test_the_period_is_the_median_of_ten_whatever_gaps_and_repetitions_come_between():
    watch, stamp, found = PeriodWatch(), 0, []
    for step in [20] * 5 + [2670] + [20] * 4 + [0, -60, 20]:
        stamp += step * 10**6
        found.append(watch.next(stamp))
    assert found[:9] == [None] * 9
    assert found[9] is None, "ten stamps have nine periods between them"
    assert watch.next(stamp + 20 * 10**6) == pytest.approx(0.02)
    for _ in range(10):
        stamp += 100 * 10**6
        found.append(watch.next(stamp))
    assert found[-1] == pytest.approx(0.1)
