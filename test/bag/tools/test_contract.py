"""Contracts: each rule on both sides of its bound, drafts, and one line for everything that is wrong with one."""

import bag_makers
import pytest
import view_bags
from hypothesis import given
from hypothesis import strategies as st

from diffbot_bag.tools import contract_draft
from diffbot_bag.tools.bag_info import read_info
from diffbot_bag.tools.contract import MAX_BYTES, TopicRules, parse_contract, read_contract
from diffbot_bag.tools.contract_check import BAG, Consistency, check_bag
from diffbot_bag.tools.contract_draft import draft_contract
from diffbot_core.bounded_yaml import load_yaml
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
    return read_info(bag_makers.write_folder(folder, rows, offers=offers))


def results(info, *, consistency=None, **sections):
    contract = parse_contract({"version": 1, **sections}, "test")
    return {(one.topic, one.rule): one for one in check_bag(contract, info, consistency or {})}


def passes(info, rule, bound, topic="/odom", consistency=None):
    found = results(info, topics={topic: {rule: bound}}, consistency=consistency)
    return found[topic, rule].passed


SIDES = {
    "type": (TYPE, "nav_msgs/msg/Path"),
    "min_count": (41, 42),
    "max_count": (41, 40),
    "min_rate": (9.523, 9.524),  # 40 intervals in 4.2 s
    "max_rate": (9.524, 9.523),
    "max_gap": (0.3, 0.299),
    "max_stamp_gap": (0.3, 0.299),
    "max_start": (0.0, None),
    "max_end": (0.1001, 0.0999),
    "max_lost": (2, 1),
    "min_latency": (0.01999, 0.02001),
    "max_latency_median": (0.02001, 0.01999),
    "max_latency_p99": (0.0701, 0.0699),
    "stamped": (True, None),
    "monotone_stamps": (True, None),
    "reliability": ("reliable", "best_effort"),
    "durability": ("volatile", "transient_local"),
    "min_nis_inside": (0.75, 0.76),
    "min_white": (0.5, 0.51),
}


@pytest.mark.parametrize("rule", sorted(set(TopicRules._fields) - {"required"}))
def test_a_rule_holds_on_one_side_of_its_bound_only(info, rule):
    good, bad = SIDES[rule]
    consistency = {"/odom": Consistency(0.75, 0.5)}
    assert passes(info, rule, good, consistency=consistency)
    if bad is not None:
        assert not passes(info, rule, bad, consistency=consistency)


def test_rules_of_the_bag(info):
    for rule, good, bad in (("min_duration", 4.3, 4.31), ("max_duration", 4.31, 4.29), ("max_lost", 2, 1)):
        assert results(info, bag={rule: good})[BAG, rule].passed
        assert not results(info, bag={rule: bad})[BAG, rule].passed
    found = results(info, forbidden=["/odom", "/scan"])
    assert (found["/odom", "forbidden"].passed, found["/scan", "forbidden"].passed) == (False, True)
    rule = {"only_these_topics": True}
    found = results(info, bag=rule, topics={"/odom": {}})[BAG, "only_these_topics"]
    assert (found.passed, found.measured) == (False, "/cmd_vel")
    assert results(info, bag=rule, topics={"/odom": {}, "/cmd_vel": {}})[BAG, "only_these_topics"].passed


def test_topics_that_begin_late_and_stamps_that_go_back_or_are_missing_break_their_rules(info, tmp_path):
    assert passes(info, "max_start", 4.31, "/cmd_vel")
    assert not passes(info, "max_start", 4.29, "/cmd_vel")
    rows = [
        ("/a", bag_makers.BEGIN + number, 0, view_bags.odometry(stamp, 0.0, 0.0, 0.0))
        for number, stamp in enumerate((5, 9, 8, 10))
    ] + [("/b", bag_makers.BEGIN, 0, view_bags.odometry(0, 0.0, 0.0, 0.0))]
    found = read_info(bag_makers.write_folder(tmp_path / "run", rows))
    assert not passes(found, "monotone_stamps", True, "/a")
    assert passes(found, "stamped", True, "/a")
    assert not passes(found, "stamped", True, "/b")
    assert ("/a", "monotone_stamps") not in results(found, topics={"/a": {"monotone_stamps": False}})


def test_what_is_not_measured_or_missing_fails(info):
    bounds = {"min_rate": 0.0, "max_gap": 9.0, "max_latency_p99": 9.0, "max_lost": 9, "stamped": True}
    for rule, bound in bounds.items():
        assert not passes(info, rule, bound, "/cmd_vel"), rule
    assert not passes(info, "min_white", 0.0)
    topics = {
        "/cmd_vel": {"max_gap": 9.0, "reliability": "reliable", "durability": "transient_local"},
        "/odom": {"min_rate": 9.0, "stamped": True},
        "/scan": {"min_rate": 1.0, "type": TYPE},
        "/other": {"min_rate": 1.0, "required": False},
    }
    found = results(info, topics=topics)
    assert [one.line() for one in found.values() if one.rule != "required"] == [
        "FAIL /cmd_vel max_gap: not measured, must be <= 9 s",
        "FAIL /cmd_vel reliability: best_effort and reliable, must be reliable",
        "PASS /cmd_vel durability: transient_local, must be transient_local",
        "PASS /odom min_rate: 9.52381 Hz, must be >= 9 Hz",
        "PASS /odom stamped: true, must be true",
    ]
    assert [found[topic, "required"].passed for topic in topics] == [True, True, False, True]


@given(st.floats(1e-9, 1e9), st.sampled_from((1, -1)))
def test_bounds_of_a_draft_are_rounded_outwards_to_two_digits(size, sign):
    value = sign * size
    low, high = contract_draft.round_down(value), contract_draft.round_up(value)
    assert low <= value <= high
    assert high - low <= 0.1 * size * (1 + 1e-9)
    assert all(float(f"{bound:.1e}") == pytest.approx(bound, rel=1e-14) for bound in (low, high))
    assert contract_draft.round_down(0.0) == contract_draft.round_up(0.0) == 0.0


def test_a_draft_refuses_a_bag_at_half_the_rate_with_a_longer_gap(info, tmp_path):
    contract = parse_contract(load_yaml(draft_contract(info, {}), "draft"), "draft")
    rows = [
        ("/odom", bag_makers.BEGIN + number * 2 * STEP, number, view_bags.odometry(1, 0.0, 0.0, 0.0))
        for number in [*range(12), *range(16, 25)]
    ]
    other = read_info(bag_makers.write_folder(tmp_path / "run", rows))
    failed = {(one.topic, one.rule) for one in check_bag(contract, other, {}) if not one.passed}
    assert failed == {
        (BAG, "max_lost"),
        ("/cmd_vel", "required"),
        ("/odom", "min_rate"),
        ("/odom", "max_gap"),
        ("/odom", "max_lost"),
        ("/odom", "max_latency_p99"),
    }


@pytest.fixture
def contract(tmp_path):
    def read(text):
        path = tmp_path / "contract.yaml"
        path.write_text(text, encoding="utf-8")
        return read_contract(path)

    return read


WRONG = {
    "no map": ("[1]", "the contract = [1]: must be a map"),
    "a truth for a version": ("version: true", "version = True: must be 1"),
    "unknown section": ("version: 1\ntopic: {}", "'topic' is unknown: must be one of version, bag, topics, forbidden"),
    "negative rate": ("version: 1\ntopics: {/a: {min_rate: -1}}", "/a: min_rate = -1.0: must be >= 0 and <= 1e+10"),
    "nan": (
        "version: 1\ntopics: {/a: {max_gap: .nan}}",
        "/a: max_gap = nan: must be >= 0 and <= 1e+10 (inf: no limit)",
    ),
    "bounds that cross": (
        "version: 1\ntopics: {/a: {min_rate: 2, max_rate: 1}}",
        "/a: min_rate = 2.0: must be <= max_rate = 1.0",
    ),
    "a relative name": ("version: 1\ntopics: {odom: {}}", "topics: 'odom': must be the full name of a topic"),
    "required and forbidden": ("version: 1\ntopics: {/a: {}}\nforbidden: [/a]", "must be in one of them"),
    "a rule twice": ("version: 1\ntopics: {/a: {max_gap: 1, max_gap: 9}}", "'max_gap' stands there twice"),
    "too large": (" " * (MAX_BYTES + 1), "is too large"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_refused_in_one_line(contract, name):
    text, expected = WRONG[name]
    with pytest.raises(DiffbotError) as error:
        contract(text)
    assert expected in str(error.value)
    assert "contract.yaml" in str(error.value)
    assert str(error.value).isprintable()
    assert len(str(error.value)) < 700
