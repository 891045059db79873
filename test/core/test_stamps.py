"""Whether stamps advance: the only sign of life of a sender."""

from diffbot_core.stamps import StampWatch


def test_only_a_later_stamp_advances_and_time_may_begin_anew():
    watch = StampWatch()
    #         first, later, again, out of order, again, later | restart by more than a second, and on
    stamps = [5_000_000_000, 5_100_000_000, 5_100_000_000, 5_000_000_000, 5_100_000_000, 5_200_000_000, 0, 0, 1]
    assert [watch.advances(stamp) for stamp in stamps] == [True, True, False, False, False, True, False, False, True]
