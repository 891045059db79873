"""``diffbot bag info`` and ``diffbot bag repair``: what they print."""

import json

import bag_makers
import damaged_bags
import pytest
import view_bags

from diffbot_bag.bag.reader import BagReader
from diffbot_tools import cli


@pytest.fixture(autouse=True)
def environment(kept_signal_handlers, monkeypatch):
    monkeypatch.setenv("TZ", "UTC")


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    begin = bag_makers.BEGIN
    rows = [
        ("/odom", begin + number * 10**8, number + 1, view_bags.odometry(begin, 1, 2, 3)) for number in (0, 1, 2, 4)
    ]
    rows.insert(1, ("/add/_service_event", begin + 1, 0, view_bags.command(0.0, 0.0)))
    return bag_makers.write_folder(tmp_path_factory.mktemp("bags") / "run", rows)


def test_the_lines_are_those_of_ros2_bag_info(bag, capsys):
    assert cli.main(["bag", "info", str(bag)]) == 0
    lines = capsys.readouterr().out.splitlines()
    size = (bag / "run_0.mcap").stat().st_size
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


def test_json_has_the_same_figures_and_quick_only_the_counts(bag, capsys):
    def found(*flags):
        assert cli.main(["bag", "info", str(bag), "--json", *flags]) == 0
        info = json.loads(capsys.readouterr().out)
        return info, next(topic for topic in info["topics"] if topic["name"] == "/odom")

    info, odom = found()
    assert (info["messages"], info["duration"], odom["lost"], odom["rate"]) == (5, 0.4, 1, 7.5)
    assert odom["latency"] == {"smallest": 0.0, "median": 0.1, "p99": 0.4}
    assert odom["gap_begin"] == bag_makers.BEGIN + 2 * 10**8
    _, quick = found("--quick")
    assert quick["messages"] == 4
    assert {quick[name] for name in ("rate", "gap", "latency", "bytes", "unstamped")} == {None}


@pytest.fixture(scope="module")
def whole():
    return damaged_bags.original(damaged_bags.mcap_file(count=900))


def run(capsys, *arguments):
    status = cli.main(["bag", "repair", *map(str, arguments)])
    output = capsys.readouterr()
    return status, output.out.splitlines(), output.err


def test_what_is_lost_is_printed(tmp_path, capsys, whole):
    source = tmp_path / "run.mcap"
    content = bytearray(whole.content)
    begin, end, messages = whole.chunks[3]
    content[(begin + end) // 2] ^= 1
    source.write_bytes(content)
    status, lines, _ = run(capsys, source, tmp_path / "fixed")
    assert status == 0
    left = 900 - messages.total()
    times = sorted((time - damaged_bags.BEGIN) / 1e9 for _, time, *_ in messages)
    by_topic = ", ".join(
        f"{topic} {sum(count for (name, *_), count in messages.items() if name == topic)}"
        for topic in damaged_bags.TOPICS
    )
    assert lines == [
        f"{tmp_path / 'fixed'}: {left} messages of 3 topics in 0.899 s",
        f"run.mcap: lost: 1 damaged chunk, {end - begin} bytes that cannot be read",
        f"run.mcap: lost: {messages.total()} messages ({by_topic})",
        f"run.mcap: lost: messages between {times[0]:.3f} s and {times[-1]:.3f} s",
    ]
    status, _, error = run(capsys, source, tmp_path / "fixed")
    assert (status, error.count("\n")) == (1, 1)


def test_a_file_without_its_end_loses_nothing_in_place(tmp_path, capsys, whole):
    source = tmp_path / "run.mcap"
    source.write_bytes(whole.content[:-3000])
    status, lines, _ = run(capsys, source, "--in-place")
    assert (status, lines[-1]) == (0, "nothing that was written is lost")
    with BagReader(source) as reader:
        assert (reader.message_count, reader.warning) == (900, "")
