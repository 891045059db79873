"""``diffbot bag info``: its lines and its JSON."""

import json

import foreign_bags
import pytest

from diffbot_lab import cli


@pytest.fixture(autouse=True)
def environment(kept_signal_handlers, monkeypatch):
    monkeypatch.setenv("TZ", "UTC")


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    event = "/add/_service_event"
    rows = [
        ("/odom", foreign_bags.BEGIN + number * 10**8, number + 1, foreign_bags.odometry(foreign_bags.BEGIN, 1, 2, 3))
        for number in (0, 1, 2, 4)
    ]
    rows.append((event, foreign_bags.BEGIN + 1, 0, foreign_bags.command(0.0, 0.0)))
    return foreign_bags.write_folder(tmp_path_factory.mktemp("bags") / "run", sorted(rows, key=lambda row: row[1]))


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


def test_json_has_the_documented_keys(bag, capsys):
    assert cli.main(["bag", "info", str(bag), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found) == {
        "schema_version", "path", "storage", "ros_distro", "files", "size", "start", "end", "duration", "messages",
        "lost", "compression", "topics",
    }  # fmt: skip
    odom = next(topic for topic in found["topics"] if topic["name"] == "/odom")
    assert set(odom) == {
        "name", "type", "messages", "bytes", "first", "last", "rate", "gap", "gap_begin", "lost", "latency",
        "unstamped", "stamps_back", "stamp_gap", "qos",
    }  # fmt: skip
    assert (found["messages"], found["duration"], odom["lost"], odom["rate"]) == (5, 0.4, 1, 7.5)
    assert odom["latency"] == {"smallest": 0.0, "median": 0.1, "p99": 0.4}
    assert odom["gap_begin"] == foreign_bags.BEGIN + 2 * 10**8


def test_quick_has_no_figures_but_the_counts(bag, capsys):
    assert cli.main(["bag", "info", str(bag), "--quick", "--json"]) == 0
    topics = {topic["name"]: topic for topic in json.loads(capsys.readouterr().out)["topics"]}
    assert topics["/odom"]["messages"] == 4
    assert {topics["/odom"][name] for name in ("rate", "gap", "latency", "bytes", "unstamped")} == {None}
    assert cli.main(["bag", "info", str(bag), "--quick"]) == 0
    assert "rate" not in capsys.readouterr().out


def test_a_damaged_bag_is_one_line(bag, tmp_path, capsys):
    content = bytearray((bag / "run_0.mcap").read_bytes())
    content[1000:2000] = bytes(1000)
    path = tmp_path / "bad.mcap"
    path.write_bytes(content)
    assert cli.main(["bag", "info", str(path)]) == 1
    written = capsys.readouterr()
    assert written.out == ""
    assert written.err.startswith("diffbot: ")
    assert "bad.mcap" in written.err
    assert written.err.count("\n") == 1


def test_hostile_names_are_printed_on_one_line(tmp_path, capsys):
    name = "/a\x1b[2J\n/b" + "x" * 500
    folder = foreign_bags.write_folder(tmp_path / "run", [(name, 2**62, 0, foreign_bags.command(0.0, 0.0))])
    assert cli.main(["bag", "info", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(line.isprintable() and len(line) < 600 for line in lines)
