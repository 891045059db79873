"""When messages are due: pure functions against numbers worked out by hand."""

import pytest
from extremes import extreme_configs

from diffbot_bag.parameters import RecorderConfig, ReplayConfig
from diffbot_bag.playback_clock import (
    Timeline,
    Window,
    bag_time,
    due,
    first_tick,
    nanoseconds,
    parse_remap,
    paused,
    resumed,
    stepped,
    window,
)
from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import build, parameters_of

BEGIN = 1_700_000_000_000_000_000
SECOND = 1_000_000_000
LAST = BEGIN + 10 * SECOND


@pytest.mark.parametrize(
    ("options", "start", "end"),
    [
        ({}, 0.0, 10.0),
        ({"start_offset": 2.5}, 2.5, 10.0),
        ({"start_offset": 10.0}, 10.0, 10.0),
        ({"playback_duration": 3.0}, 0.0, 3.0),
        ({"playback_duration": 0.0}, 0.0, 0.0),
        ({"playback_duration": 99.0}, 0.0, 10.0),
        ({"start_offset": 2.0, "playback_duration": 3.0}, 2.0, 5.0),
        ({"playback_until": BEGIN / SECOND + 4.0}, 0.0, 4.0),
        ({"playback_until": BEGIN / SECOND + 4.0, "playback_duration": 3.0}, 0.0, 3.0),
        ({"playback_until": BEGIN / SECOND + 4.0, "playback_duration": 6.0}, 0.0, 4.0),
    ],
)
def test_the_part_that_is_played(options, start, end):
    assert window(BEGIN, LAST, **options) == Window(BEGIN + round(start * SECOND), BEGIN + round(end * SECOND))


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [(0.0, 0), (0.1, 100_000_000), (2.5, 2_500_000_000), (1_700_000_000.25, BEGIN + SECOND // 4)],
)
def test_seconds_keep_their_digits(seconds, expected):
    assert nanoseconds(seconds) == expected


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"start_offset": 10.1}, r"start_offset = 10.1: must be <= 10 s, the bag's length"),
        ({"playback_until": 5.0}, r"playback_until = 5.0: must be >= 1700000000.000000000 s"),
        ({"playback_until": BEGIN / SECOND + 1.0, "start_offset": 2.0}, r"must be >= 1700000002.0"),
    ],
)
def test_nothing_left_to_play(options, words):
    with pytest.raises(InvalidValueError, match=words):
        window(BEGIN, LAST, **options)


@pytest.mark.parametrize("rate", [0.1, 1.0, 2.0, 1000.0])
def test_time_runs_at_the_rate(rate):
    timeline = Timeline(BEGIN, 500, rate)
    assert bag_time(timeline, 500) == BEGIN
    assert bag_time(timeline, 500 + SECOND) == BEGIN + round(rate * SECOND)
    assert due(timeline, BEGIN) == 500
    assert due(timeline, BEGIN + 3 * SECOND) == 500 + round(3 * SECOND / rate)
    for log_time in (BEGIN + 1000, BEGIN + 7 * SECOND):
        assert bag_time(timeline, due(timeline, log_time)) == pytest.approx(log_time, abs=max(1, rate))


def test_a_pause_moves_what_comes_by_its_length():
    timeline = Timeline(BEGIN, 0, 2.0)
    halted = paused(timeline, 3 * SECOND)
    assert bag_time(halted, 3 * SECOND) == bag_time(halted, 9 * SECOND) == BEGIN + 6 * SECOND
    again = resumed(halted, 9 * SECOND)
    assert due(again, BEGIN + 8 * SECOND) == due(timeline, BEGIN + 8 * SECOND) + 6 * SECOND
    assert bag_time(again, 10 * SECOND) == BEGIN + 8 * SECOND


def test_pausing_and_resuming_twice_changes_nothing():
    halted = paused(Timeline(BEGIN, 0), SECOND)
    assert bag_time(paused(halted, 5 * SECOND), 7 * SECOND) == BEGIN + SECOND
    running = resumed(halted, 5 * SECOND)
    assert resumed(running, 8 * SECOND) == running


def test_a_step_moves_a_paused_replay_on_but_never_back():
    halted = paused(Timeline(BEGIN, 0), SECOND)
    assert stepped(halted, BEGIN + 4 * SECOND).bag == BEGIN + 4 * SECOND
    assert stepped(halted, BEGIN) == halted


@pytest.mark.parametrize(
    ("now", "last", "expected"),
    [(70, None, 70), (105, 100, 110), (110, 100, 110), (111, 100, 110), (129, 100, 120), (1000, 100, 1000)],
)
def test_ticks_stay_on_their_grid_and_late_ones_are_left_out(now, last, expected):
    assert first_tick(now, 10, last) == expected


def test_remapping_rules():
    assert parse_remap(()) == {}
    assert parse_remap(("odom:=other/odom", "/a:=/b")) == {"/odom": "/other/odom", "/a": "/b"}


@pytest.mark.parametrize("rule", ["odom", "odom:=", ":=odom", ""])
def test_a_wrong_remapping_rule_is_named(rule):
    with pytest.raises(InvalidValueError, match=r"remap = .*: must be old:=new"):
        build(ReplayConfig, {"remap": [rule]})


@pytest.mark.parametrize("config", [RecorderConfig, ReplayConfig])
def test_every_default_is_allowed_and_described(config):
    parameters = parameters_of(config)
    assert build(config, {p.name: p.default for p in parameters}) == config()
    assert all(parameter.spec.text for parameter in parameters)


@pytest.mark.parametrize("rate", [0.0, -1.0, 5e-324, 9e-7, 2e6, float("nan"), float("inf")])
def test_a_rate_out_of_its_bounds_is_refused(rate):
    with pytest.raises(InvalidValueError, match=r"rate = .*: must be >= 1e-06 and <= 1e\+06"):
        build(ReplayConfig, {"rate": rate})


@pytest.mark.parametrize("rate", [1e-6, 1e6])
def test_the_longest_bag_has_a_due_time_at_both_bounds_of_the_rate(rate):
    last = 2**63 - 1
    assert due(Timeline(0, 0, rate), last) == pytest.approx(last / rate)


def test_at_the_bounds_of_its_parameters_a_replay_has_whole_times_in_order():
    first, last = 1_700_000_000 * SECOND, 1_700_086_400 * SECOND
    played = 0
    for values, config in extreme_configs(ReplayConfig, 1, 100):
        try:
            part = window(first, last, config.start_offset, config.playback_duration, config.playback_until)
        except InvalidValueError:
            continue
        timeline = Timeline(part.start, 10**15, config.rate)
        times = due(timeline, part.start), due(timeline, part.end)
        assert 10**15 == times[0] <= times[1], values
        assert bag_time(timeline, times[1]) == pytest.approx(part.end, abs=1 + config.rate), values
        played += 1
    assert played > 100
