"""Contracts: each rule on both sides of its bound, and the errors of invalid contracts."""

import json

import bag_makers
import pytest
import view_bags

from diffbot_bag.check import BAG, TopicRules, check_bag, read_contract
from diffbot_core.errors import DiffbotError

STEP = 100_000_000
TYPE = "nav_msgs/msg/Odometry"


@pytest.fixture(scope="module")
def info(tmp_path_factory):
    """/odom: 41 messages at 10 Hz, one gap of 0.3 s, two lost, 20 ms late, one 70 ms; /cmd_vel once, at the end."""
    begin, rows = bag_makers.BEGIN, []
    numbers = [number for number in range(43) if number not in (20, 21)]
    for number in numbers:
        time = begin + number * STEP
        late = 70_000_000 if number == 30 else 20_000_000
        rows.append(("/odom", time, number + 1, view_bags.odometry(time - late, 0.0, 0.0, 0.0)))
    rows.append(("/cmd_vel", begin + 43 * STEP, 0, view_bags.command(0.0, 0.0)))
    folder = tmp_path_factory.mktemp("bags") / "run"
    offers = {"/cmd_vel": bag_makers.qos(2, 1) + bag_makers.qos(1, 1)}
    return bag_makers.read_info(bag_makers.write_folder(folder, rows, offers=offers))


@pytest.fixture
def results(tmp_path):
    """Check a bag with a contract of these sections; return the results by topic and rule."""

    def run(info, **sections):
        path = tmp_path / "contract.yaml"
        path.write_text(json.dumps({"version": 1, **sections}))
        return {(one.topic, one.rule): one for one in check_bag(read_contract(path), info, {"/odom": 0.75})}

    return run


SIDES = {
    "type": (TYPE, "nav_msgs/msg/Path"),
    "min_count": (41, 42),
    "max_count": (41, 40),
    "min_rate": (9.523, 9.524),  # 40 intervals in 4.2 s
    "max_rate": (9.524, 9.523),
    "max_gap": (0.3, 0.299),
    "max_stamp_gap": (0.3, 0.299),
    "max_lost": (2, 1),
    "min_latency": (0.01999, 0.02001),
    "max_latency_p99": (0.0701, 0.0699),
    "reliability": ("reliable", "best_effort"),
    "durability": ("volatile", "transient_local"),
    "min_nis_inside": (0.75, 0.76),
}


def test_each_rule_passes_on_one_side_of_its_bound_and_fails_on_the_other(info, results):
    assert set(SIDES) == {*TopicRules._fields} - {"required", "stamped", "monotone_stamps"}
    for rule, (good, bad) in SIDES.items():
        assert results(info, topics={"/odom": {rule: good}})["/odom", rule].passed, rule
        assert not results(info, topics={"/odom": {rule: bad}})["/odom", rule].passed, rule
    for rule, good, bad in (("min_duration", 4.3, 4.31), ("max_duration", 4.31, 4.29), ("max_lost", 2, 1)):
        assert results(info, bag={rule: good})[BAG, rule].passed, rule
        assert not results(info, bag={rule: bad})[BAG, rule].passed, rule
    found = results(info, bag={"only_these_topics": True}, topics={"/odom": {}})[BAG, "only_these_topics"]
    assert (found.passed, found.measured) == (False, "/cmd_vel")
    topics = {"/odom": {}, "/cmd_vel": {}}
    assert results(info, bag={"only_these_topics": True}, topics=topics)[BAG, "only_these_topics"].passed


def test_rules_of_stamps_fail_for_missing_and_decreasing_stamps(info, results, tmp_path):
    rules = {"stamped": True, "monotone_stamps": True}
    stamps = ("/a", 5), ("/a", 9), ("/a", 8), ("/b", 0), ("/b", 5)
    rows = [
        (topic, bag_makers.BEGIN + number, 0, view_bags.odometry(stamp, 0, 0, 0))
        for number, (topic, stamp) in enumerate(stamps)
    ]
    other = bag_makers.read_info(bag_makers.write_folder(tmp_path / "run", rows))
    found = results(other, topics={"/a": rules, "/b": rules}) | results(info, topics={"/odom": rules})
    assert {place: one.passed for place, one in found.items() if place[1] != "required"} == {
        ("/a", "stamped"): True,
        ("/a", "monotone_stamps"): False,
        ("/b", "stamped"): False,
        ("/b", "monotone_stamps"): True,
        ("/odom", "stamped"): True,
        ("/odom", "monotone_stamps"): True,
    }


def test_a_rule_without_a_measured_value_and_a_missing_topic_fail(info, results):
    bounds = {"min_rate": 0.0, "max_gap": 9.0, "max_latency_p99": 9.0, "max_lost": 9, "stamped": True}
    found = results(info, topics={"/cmd_vel": bounds})
    assert [found["/cmd_vel", rule].passed for rule in bounds] == [False] * 5
    topics = {"/odom": {}, "/scan": {"min_rate": 1.0}, "/other": {"min_rate": 1.0, "required": False}}
    found = results(info, topics=topics)
    assert {place: one.passed for place, one in found.items()} == {
        ("/odom", "required"): True,
        ("/scan", "required"): False,
        ("/other", "required"): True,
    }


@pytest.mark.parametrize(
    ("sections", "expected"),
    [
        ({"topic": {}}, "'topic' is not a section: must be one of version, bag, topics"),
        ({"version": 2}, "version = 2: must be 1"),
        ({"topics": {"/a": {"min_rat": 1}}}, "/a: min_rat"),
        ({"topics": {"/a": {"min_rate": -1}}}, "/a: min_rate = -1.0: must be"),
        ({"topics": {"/a": {"min_rate": 2, "max_rate": 1}}}, "/a: min_rate = 2.0: must be <= max_rate = 1.0"),
        ({"topics": {"a": {}}}, "must be the full name of a topic"),
    ],
)
def test_an_invalid_contract_is_refused_with_the_reason(info, results, sections, expected):
    with pytest.raises(DiffbotError) as error:
        results(info, **sections)
    assert expected in str(error.value)
    assert "contract.yaml" in str(error.value)
    assert str(error.value).isprintable()
