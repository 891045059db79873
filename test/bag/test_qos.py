"""QoS profiles against rosbags, the QoS of recorder and replay, overrides, and the selection of topics."""

import pytest
from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import parse_qos

from diffbot_bag.conversions import from_ros, to_ros
from diffbot_bag.qos import (
    Qos,
    dump_profiles,
    load_profiles,
    read_overrides,
    to_offer,
    to_plain,
    to_request,
)
from diffbot_bag.topic_selection import TopicSelection

RELIABLE = Qos()
BEST_EFFORT = Qos(reliability="best_effort")
LATCHED = Qos(durability="transient_local")
STRICT = Qos(
    "keep_last", 7, "reliable", "transient_local", 20_000_000, 3_000_000_001, "manual_by_topic", 5 * 10**9, True
)


def test_rosbags_reads_written_profiles():
    (first, second) = parse_qos(dump_profiles([STRICT, BEST_EFFORT]))
    assert first == (
        QosHistory.KEEP_LAST, 7, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, QosTime(0, 20_000_000),
        QosTime(3, 1), QosLiveliness.MANUAL_BY_TOPIC, QosTime(5, 0), True,
    )  # fmt: skip
    assert second.reliability == QosReliability.BEST_EFFORT
    assert second.deadline == QosTime(9223372036, 854775807)
    assert second.history == QosHistory.UNKNOWN


@pytest.mark.parametrize("profiles", [(), (RELIABLE,), (STRICT, BEST_EFFORT, LATCHED)])
def test_profiles_survive_writing_and_reading_and_the_conversion_to_ros(profiles):
    assert load_profiles(dump_profiles(profiles)) == profiles
    assert load_profiles([to_plain(qos) for qos in profiles]) == profiles
    for qos in profiles:
        assert from_ros(to_ros(qos)) == qos._replace(depth=qos.depth if qos.history == "keep_last" else 0)


@pytest.mark.parametrize(
    ("offers", "reliability", "durability"),
    [
        ([], "best_effort", "volatile"),
        ([RELIABLE], "reliable", "volatile"),
        ([RELIABLE, BEST_EFFORT], "best_effort", "volatile"),
        ([LATCHED, RELIABLE], "reliable", "volatile"),
        ([LATCHED, LATCHED], "reliable", "transient_local"),
    ],
)
def test_a_subscription_requests_only_policies_that_all_publishers_offer(offers, reliability, durability):
    assert to_request(offers) == Qos("keep_last", 10_000, reliability, durability)


@pytest.mark.parametrize(
    ("recorded", "offer"),
    [
        ([], Qos("keep_last", 10_000)),
        ([BEST_EFFORT, RELIABLE], Qos("keep_last", 10_000)),
        ([LATCHED], Qos("keep_last", 1, durability="transient_local")),
        ([LATCHED._replace(depth=5)], Qos("keep_last", 5, durability="transient_local")),
        ([RELIABLE._replace(deadline=10**7)], Qos("keep_last", 10_000, deadline=10**7)),
    ],
)
def test_the_offer_of_a_replay_replaces_all_recorded_publishers(recorded, offer):
    assert to_offer(recorded) == offer


def test_overrides_have_the_format_of_rosbag2(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    content = """
/a: {reliability: best_effort, durability: volatile, history: keep_all}
b: {reliability: reliable, depth: 5, deadline: {sec: 1, nsec: 500000000}}
"""
    (tmp_path / "qos.yaml").write_text(content)
    assert read_overrides("~/qos.yaml", "/robot") == {
        "/a": Qos("keep_all", 10_000, "best_effort", "volatile"),
        "/robot/b": Qos("keep_last", 5, "reliable", "volatile", deadline=1_500_000_000),
    }


@pytest.mark.parametrize(
    ("selection", "selected"),
    [
        (TopicSelection(), {"/odom", "/robot/odom", "/rosout"}),
        (TopicSelection(include_hidden_topics=True), {"/odom", "/robot/odom", "/rosout", "/_hidden", "/a/_b/c"}),
        (TopicSelection(topics=("/_hidden",), regex=".*/odom"), {"/odom", "/robot/odom", "/_hidden"}),
        (TopicSelection(exclude_topics=("/odom",), exclude_regex="/r.*t"), {"/robot/odom"}),
    ],
)
def test_topics_are_selected_by_name_and_regex_and_exclusions_take_precedence(selection, selected):
    topics = {"/odom", "/robot/odom", "/rosout", "/_hidden", "/a/_b/c"}
    assert {topic for topic in topics if selection.selects(topic)} == selected
