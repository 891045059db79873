"""When messages are due: pure functions against numbers worked out by hand."""

import pytest

from diffbot_bag.replay.playback_clock import Timeline, Window, bag_time, due, paused, resumed, stepped, window

BEGIN = 1_700_000_000_000_000_000
SECOND = 1_000_000_000
LAST = BEGIN + 10 * SECOND


@pytest.mark.parametrize(
    ("options", "start", "end"),
    [
        ({}, 0.0, 10.0),
        ({"start_offset": 2.0, "playback_duration": 3.0}, 2.0, 5.0),
        ({"playback_until": BEGIN / SECOND + 4.0, "playback_duration": 3.0}, 0.0, 3.0),
    ],
)
def test_the_part_that_is_played(options, start, end):
    assert window(BEGIN, LAST, **options) == Window(BEGIN + round(start * SECOND), BEGIN + round(end * SECOND))


def test_time_runs_at_the_rate_and_a_pause_moves_what_comes_by_its_length():
    timeline = Timeline(BEGIN, 0, 2.0)
    assert bag_time(timeline, SECOND) == BEGIN + 2 * SECOND
    assert due(timeline, BEGIN + 3 * SECOND) == 3 * SECOND // 2
    halted = paused(timeline, 3 * SECOND)
    assert bag_time(halted, 3 * SECOND) == bag_time(paused(halted, 5 * SECOND), 9 * SECOND) == BEGIN + 6 * SECOND
    again = resumed(halted, 9 * SECOND)
    assert resumed(again, 11 * SECOND) == again
    assert due(again, BEGIN + 8 * SECOND) == due(timeline, BEGIN + 8 * SECOND) + 6 * SECOND
    assert bag_time(again, 10 * SECOND) == BEGIN + 8 * SECOND
    # A step moves a paused replay on, but never back.
    assert stepped(halted, BEGIN + 9 * SECOND).bag == BEGIN + 9 * SECOND
    assert stepped(halted, BEGIN) == halted
