"""Counters of a node for /diagnostics, and the log throttle."""

import math

from diffbot_core import health as module
from diffbot_core.health import Health, Throttle


def test_only_the_drops_of_the_last_ten_seconds_are_recent(monkeypatch):
    health, now = Health(), [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    for now[0] in (100.0, 103.0):
        health.drop("odom", "too old")
    assert [health.recent_drops(when) for when in (103.0, 110.0, 110.1, 113.1)] == [2, 2, 1, 0]
    assert health.dropped["odom", "too old"] == 2


def test_the_report_has_counts_rates_since_the_last_report_and_ages_of_the_newest_messages():
    health = Health()
    health.accept("odom", 10.0)
    health.accept("fix", 11.0)
    health.accept("odom", 12.5)
    health.sent["odom"] += 8
    drops = (("fix", "not finite"), ("fix", "not finite"), ("fix", "too old"), ("odom", "too old"))
    assert [health.drop(*one) for one in drops] == [True, False, True, True]
    assert health.ages(13.0) == {"fix age [s]": "2.00", "odom age [s]": "0.50"}
    first = health.report(2.0)
    assert (first["odom received"], first["odom received [Hz]"], first["odom sent [Hz]"]) == ("2", "1.0", "4.0")
    assert (first["fix dropped: not finite"], first["odom dropped: too old"]) == ("2", "1")
    health.accepted["odom"] += 3
    second = health.report(0.5)
    assert (second["odom received"], second["odom received [Hz]"], second["odom sent [Hz]"]) == ("5", "6.0", "0.0")
    health.reset()
    assert (health.report(1.0), health.ages(14.0)) == ({}, {})
    health.sent["pose"] += 3
    assert health.report(2.0) == {"pose sent": "3", "pose sent [Hz]": "1.5"}
    assert health.drop("fix", "not finite")


def test_a_drop_explains_a_silent_topic_until_a_message_is_accepted_or_for_two_seconds(monkeypatch):
    health, now = Health(), [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    health.accept("odom", 99.0)
    assert health.newest_drop("odom", 100.0) == ""
    health.drop("odom", "wrong frame_id", "wrong frame_id: 'a', not 'b'")
    health.drop("fix", "too old")
    found = [(health.newest_drop("odom", when), health.newest_drop("fix", when)) for when in (102.0, 102.1)]
    assert found == [("wrong frame_id: 'a', not 'b'", "too old"), ("", "")]
    assert health.newest_drop("fix", 1e6, math.inf) == "too old"
    health.accept("fix", 100.5)
    assert health.newest_drop("fix", 101.0) == ""


def test_the_throttle_lets_each_key_pass_once_per_period():
    throttle = Throttle(2.0)
    assert [throttle.is_due("a", now) for now in (5.0, 5.1, 6.9, 7.0, 7.1)] == [True, False, False, True, False]
    assert throttle.is_due("b", 7.1)
