"""Counters of a node and what they say in /diagnostics."""

from diffbot_core.health import Health


def test_only_the_first_drop_of_a_kind_is_worth_a_line():
    health = Health()
    assert health.drop("odom", "too old")
    assert not health.drop("odom", "too old")
    assert health.drop("odom", "not finite")
    assert health.drop("pose", "too old")
    assert health.report(1.0) == {
        "odom dropped: not finite": "1",
        "odom dropped: too old": "2",
        "pose dropped: too old": "1",
    }


def test_rates_are_over_the_time_since_the_last_report():
    health = Health()
    health.accepted["odom"] += 5
    health.sent["odom"] += 8
    first = health.report(2.0)
    assert first == {
        "odom received": "5",
        "odom received [Hz]": "2.5",
        "odom sent": "8",
        "odom sent [Hz]": "4.0",
    }
    health.accepted["odom"] += 3
    second = health.report(0.5)
    assert second["odom received"] == "8"
    assert second["odom received [Hz]"] == "6.0"
    assert second["odom sent [Hz]"] == "0.0"


def test_no_rate_over_no_time():
    health = Health()
    health.accepted["odom"] += 5
    assert health.report(0.0) == {"odom received": "5"}
    # What was told then is not told again as a rate.
    assert health.report(1.0)["odom received [Hz]"] == "0.0"


def test_notes_are_told():
    health = Health()
    health.notes = {"steps": "7"}
    assert health.report(1.0) == {"steps": "7"}
