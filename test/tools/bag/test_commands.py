"""``diffbot bag``: exit statuses, printed lines, errors of one line, and complete output or none."""

import json

import bag_makers
import pytest
import view_bags
from bag_makers import BEGIN, LATCHED, POINT, STRING, chunks_of, facts, point, string, write_mcap

from diffbot_tools import cli
from diffbot_tools.bag.times import parse_duration, parse_time, resolve_time

S = 10**9
STEP = 10_000_000
LAST = BEGIN + 199 * STEP + 3


@pytest.fixture(autouse=True)
def environment(kept_signal_handlers, monkeypatch):
    monkeypatch.setenv("TZ", "UTC")


@pytest.fixture
def run(capsys):
    def call(*arguments):
        """Return exit status, lines of output, and the error, of one line at most."""
        status = cli.main(["bag", *map(str, arguments)])
        written = capsys.readouterr()
        assert written.err.count("\n") <= 1
        return status, written.out.splitlines(), written.err

    return call


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    rows = []
    for step in range(200):
        rows += [("/point", BEGIN + step * STEP, point(step)), ("/text", BEGIN + step * STEP + 3, string("text"))]
        if step in (7, 55):
            rows.append(("/map", BEGIN + step * STEP + 5, string("map")))
    kinds = {"/point": POINT, "/text": STRING, "/map": STRING}
    return write_mcap(tmp_path_factory.mktemp("bags") / "run.mcap", rows, kinds, {"/map": [LATCHED]})


def messages(path):
    return [(one.topic, one.log_time, one.data) for one in facts(path)]


@pytest.mark.parametrize(
    ("flags", "start", "end"),
    [
        (("--from", "0.5s", "--to", "end-0.5s"), BEGIN + S // 2, LAST + 1 - S // 2),
        (("--from", "1700000000.5", "--to", "start + 1s"), BEGIN + S // 2, BEGIN + S),
        (("--last", "1s"), LAST + 1 - S, LAST + 1),
    ],
)
def test_trim_keeps_the_span_of_time(bag, tmp_path, run, flags, start, end):
    expected = [one for one in messages(bag) if start <= one[1] < end]
    seconds = (expected[-1][1] - expected[0][1]) / S
    status, lines, _ = run("trim", bag, tmp_path / "part", "--no-latched", *flags)
    assert (status, messages(tmp_path / "part")) == (0, expected)
    assert lines == [f"{tmp_path / 'part'}: {len(expected)} messages of 3 topics, {seconds:.3f} s"]


def test_merging_filtered_parts_gives_the_original_bag(bag, tmp_path, run):
    assert run("filter", bag, tmp_path / "points", "--topics", "/point")[0] == 0
    assert run("filter", bag, tmp_path / "others", "--exclude", "/point")[0] == 0
    assert run("filter", bag, tmp_path / "texts", "--exclude-regex", "/(point|map)", "--types", STRING)[0] == 0
    assert {topic for topic, *_ in messages(tmp_path / "texts")} == {"/text"}
    assert run("merge", tmp_path / "points", tmp_path / "others", tmp_path / "all")[0] == 0
    assert messages(tmp_path / "all") == messages(bag)


def test_an_invalid_cut_is_refused_and_nothing_is_written(bag, tmp_path, run):
    for words, arguments in (
        ("must select a part of the bag, which lasts from 1700000000.000", ("trim", bag, "part", "--from", "2s")),
        ("must select a part of the bag", ("trim", bag, "part", "--from", "1s", "--to", "0.5s")),
        ("/scan is not in the bag", ("filter", bag, "part", "--topics", "/scan")),
        ("/scna is not in the bag", ("filter", bag, "part", "--exclude", "/scna")),
        ("regex", ("filter", bag, "part", "--regex", "(")),
        ("this bag is given twice", ("merge", bag, bag, "part")),
        ("this bag is given twice", ("merge", bag.parent, bag, "part")),
        ("File name too long", ("merge", bag, "a" * 300, "part")),
        ("the home folder of this user is unknown", ("trim", "~nobody-of-this-name/run", "part", "--last", "1s")),
    ):
        status, lines, error = run(*(tmp_path / one if one == "part" else one for one in arguments))
        assert (status, lines) == (1, [])
        assert words in error
    assert list(tmp_path.iterdir()) == []


def test_times_and_durations_are_parsed_without_rounding():
    durations = {"10s": 10 * S, "1.5min": 90 * S, "2h": 7200 * S, "250 ms": S // 4, "0.000000001": 1, "7ns": 7}
    assert {text: parse_duration(text) for text in durations} == durations
    times = {"1700000000.123456789": 1_700_000_000_123_456_789, "30ns": 130, "start+5ns": 105, "end-30ns": 171}
    assert {text: resolve_time(parse_time(text), 100, 200) for text in times} == times


@pytest.fixture(scope="module")
def odom(tmp_path_factory):
    rows = [
        ("/odom", BEGIN + number * 10**8, number + 1, view_bags.odometry(BEGIN, 1, 2, 3)) for number in (0, 1, 2, 4)
    ]
    rows.insert(1, ("/add/_service_event", BEGIN + 1, 0, view_bags.command(0.0, 0.0)))
    return bag_makers.write_folder(tmp_path_factory.mktemp("bags") / "run", rows)


def test_info_prints_the_lines_of_ros2_bag_info_and_a_table(odom, run):
    _, lines, _ = run("info", odom)
    size = (odom / "run_0.mcap").stat().st_size
    assert lines[:8] == [
        "Files:             run_0.mcap",
        f"Bag size:          {size / 1024:.1f} KiB",
        "Storage id:        mcap",
        "ROS Distro:        jazzy",
        "Duration:          0.400000000s",
        "Start:             Nov 14 2023 22:13:20.000000000 (1700000000.000000000)",
        "End:               Nov 14 2023 22:13:20.400000000 (1700000000.400000000)",
        "Messages:          5",
    ]
    assert "Topic: /odom | Type: nav_msgs/msg/Odometry | Count: 4 | Serialization Format: cdr" in "\n".join(lines)
    row = next(line.split() for line in lines if line.startswith("/odom "))
    assert row == ["/odom", "7.50", "0.200", "1", "100.000", "400.000", "2.8", "KiB", "reliable", "volatile"]


def test_info_as_json_has_figures_and_with_quick_only_counts(odom, run):
    info = json.loads("".join(run("info", odom, "--json")[1]))
    topic = next(one for one in info["topics"] if one["name"] == "/odom")
    assert (info["messages"], info["duration"], topic["lost"], topic["rate"]) == (5, 0.4, 1, 7.5)
    assert topic["latency"] == {"smallest": 0.0, "median": 0.1, "p99": 0.4}
    assert topic["gap_begin"] == BEGIN + 2 * 10**8
    quick = json.loads("".join(run("info", odom, "--json", "--quick")[1]))["topics"][1]
    assert (quick["name"], quick["messages"]) == ("/odom", 4)
    assert {quick[name] for name in ("rate", "gap", "latency", "bytes", "unstamped")} == {None}


def test_the_exit_status_of_check_tells_passed_failed_and_invalid(odom, tmp_path, run):
    path = tmp_path / "contract.yaml"
    path.write_text("version: 1\nbag: {max_lost: 1}\ntopics:\n  /odom: {min_rate: 7}\n")
    status, lines, _ = run("check", odom, path)
    assert status == 0
    assert [line.split(":")[0] for line in lines] == [
        "PASS bag max_lost",
        "PASS /odom required",
        "PASS /odom min_rate",
        "3 of 3 rules hold",
    ]
    path.write_text(path.read_text() + "  /scan: {}\n")
    status, lines, _ = run("check", odom, path)
    assert (status, lines[-2:]) == (
        1,
        ["FAIL /scan required: not in the bag, must be in the bag", "3 of 4 rules hold"],
    )
    status, lines, _ = run("check", odom, path, "--json")
    found = json.loads("".join(lines))
    assert (status, found["passed"], [one["passed"] for one in found["results"]]) == (1, False, [True] * 3 + [False])
    path.write_text("version: 1\nbag: {max_duration: .inf}")
    (result,) = json.loads("".join(run("check", odom, path, "--json")[1]), parse_constant=pytest.fail)["results"]
    assert (result["rule"], result["bound"]) == ("max_duration", "inf")
    path.write_text("version: 1\ntopics: {/odom: {min_rat: 3}}")
    assert run("check", odom, path)[0] == 2


def test_check_measures_the_consistency_of_a_filter(tmp_path, run):
    path = tmp_path / "contract.yaml"
    path.write_text("version: 1\ntopics: {/ekf/status: {min_nis_inside: 1.0}}")
    assert run("check", view_bags.write(tmp_path / "circle", view_bags.drive(steps=50)), path)[0] == 0
    worse = [
        (topic, time, view_bags.filter_status("/ekf", 8) if topic == "/ekf/status" else message)
        for topic, time, message in view_bags.drive(steps=50)
    ]
    status, lines, _ = run("check", view_bags.write(tmp_path / "worse", worse), path)
    assert (status, lines[1]) == (1, "FAIL /ekf/status min_nis_inside: 0, must be >= 1")


def test_check_decodes_only_topics_whose_nis_has_a_bound(tmp_path, run):
    source, path = tmp_path / "run.mcap", tmp_path / "contract.yaml"
    with source.open("wb") as stream, bag_makers.mcap_writing(stream, {}) as (writer, _):
        schema = writer.register_schema("diagnostic_msgs/msg/DiagnosticStatus", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/status", "json", schema), BEGIN, b"{}", BEGIN)
    for rule, status in (("min_count: 1", 0), ("min_nis_inside: 0.5", 2)):
        path.write_text(f"version: 1\ntopics: {{/status: {{{rule}}}}}")
        assert run("check", source, path)[0] == status


def test_repair_prints_what_is_lost(bag, tmp_path, run):
    source, content = tmp_path / "run.mcap", bytearray(bag.read_bytes())
    chunk = chunks_of(bag)[3]
    content[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 1
    source.write_bytes(content)
    status, lines, _ = run("repair", source, tmp_path / "fixed")
    lost = 402 - len(messages(tmp_path / "fixed"))
    assert (status, lines[0]) == (0, f"{tmp_path / 'fixed'}: {402 - lost} messages of 3 topics in 1.990 s")
    assert lines[1].startswith(f"run.mcap: lost: {chunk.chunk_length} damaged bytes, between 0.")
    assert lines[2].startswith(f"lost: {lost} messages that the index lists (/")
    assert run("repair", source, tmp_path / "fixed")[0] == 1
