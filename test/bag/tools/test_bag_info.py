"""Figures of bags by several makers, against the same computed with numpy from what rosbags reads."""

import json
import tracemalloc

import foreign_bags
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from diffbot_bag.lost_messages import GapCounter
from diffbot_bag.tools import bag_info
from diffbot_bag.tools.bag_info import info_as_plain, read_info
from diffbot_bag.tools.topic_figures import MAX_TIME, TopicMeter
from diffbot_bag.writer import BagWriter
from diffbot_core.errors import DiffbotError

MAKERS = {
    "mcap zstd": lambda folder: foreign_bags.write_folder(folder, foreign_bags.irregular()),
    "mcap lz4, three files": lambda folder: foreign_bags.write_folder(folder, foreign_bags.irregular(), "lz4", 3),
    "mcap without compression": lambda folder: foreign_bags.write_folder(folder, foreign_bags.irregular(), "none"),
    "rosbags": lambda folder: foreign_bags.write_rosbags(folder, foreign_bags.irregular()),
}


@pytest.fixture(scope="module", params=MAKERS)
def bag(request, tmp_path_factory):
    return MAKERS[request.param](tmp_path_factory.mktemp("bags") / "run")


def independent(path):
    """Log times, sizes and stamps of each topic, as rosbags reads them."""
    found = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            header = getattr(message, "header", None)
            stamp = None if header is None else header.stamp.sec * 10**9 + header.stamp.nanosec
            found.setdefault(connection.topic, []).append((time, len(data), stamp))
    return found


def test_figures_are_those_of_an_independent_reader(bag):
    topics = {topic.name: topic for topic in read_info(bag).topics}
    expected = independent(bag)
    assert set(topics) == set(expected) == {"/odom", "/pose", "/cmd_vel"}
    for name, rows in expected.items():
        figures = topics[name].figures
        times = np.array([time for time, _, _ in rows])
        gaps = np.diff(times)
        assert figures.message_count == len(rows)
        assert figures.bytes == sum(size for _, size, _ in rows)
        assert (figures.first, figures.last) == (times[0], times[-1])
        assert figures.rate == pytest.approx((len(rows) - 1) / (1e-9 * (times[-1] - times[0])), rel=1e-12)
        assert figures.gap == pytest.approx(1e-9 * gaps.max(), rel=1e-12)
        assert figures.gap_begin == times[gaps.argmax()]
    assert topics["/odom"].figures.gap == pytest.approx(0.62, abs=0.002)


def test_latency_and_order_of_stamps_are_those_of_an_independent_reader(bag):
    topics = {topic.name: topic for topic in read_info(bag).topics}
    for name, rows in independent(bag).items():
        figures = topics[name].figures
        if rows[0][2] is None:
            assert (figures.latency, figures.unstamped, figures.stamps_back, figures.stamp_gap) == (None,) * 4
            continue
        known = [(time, stamp) for time, _, stamp in rows if stamp]
        delays = np.array([time - stamp for time, stamp in known]) * 1e-9
        stamps = np.array([stamp for _, stamp in known])
        assert figures.latency.smallest == pytest.approx(delays.min(), rel=1e-12)
        assert figures.latency.median == pytest.approx(np.quantile(delays, 0.5, method="inverted_cdf"), rel=2e-3)
        assert figures.latency.p99 == pytest.approx(np.quantile(delays, 0.99, method="inverted_cdf"), rel=2e-3)
        assert figures.unstamped == len(rows) - len(known)
        assert figures.stamps_back == np.count_nonzero(np.diff(stamps) < 0)
        assert figures.stamp_gap == pytest.approx(np.diff(stamps).max() * 1e-9, rel=1e-12)
    assert topics["/odom"].figures.stamps_back >= 1
    assert topics["/pose"].figures.unstamped == 2
    assert topics["/pose"].figures.latency.median == pytest.approx(-0.003, rel=1e-3)


def test_missing_sequence_numbers_are_lost_messages(tmp_path):
    info = read_info(foreign_bags.write_folder(tmp_path / "run", foreign_bags.irregular(), files=3))
    assert {topic.name: topic.lost for topic in info.topics} == {"/odom": 30, "/pose": 6, "/cmd_vel": None}
    assert info.lost == 36


def test_without_sequence_numbers_and_report_nothing_is_known_of_losses(tmp_path):
    info = read_info(foreign_bags.write_rosbags(tmp_path / "run", foreign_bags.irregular(1.0)))
    assert info.lost is None
    assert [topic.lost for topic in info.topics] == [None] * 3


def test_the_recorders_report_counts_if_it_knows_of_more(tmp_path):
    report = {"lost_messages": "50", "lost /odom": "7", "lost /cmd_vel": "43"}
    folder = foreign_bags.write_folder(tmp_path / "run", foreign_bags.irregular(), custom_data=report)
    info = read_info(folder)
    assert {topic.name: topic.lost for topic in info.topics} == {"/odom": 30, "/pose": 6, "/cmd_vel": 43}
    assert info.lost == 79
    assert {topic.name: topic.lost for topic in read_info(folder, quick=True).topics}["/cmd_vel"] == 43


@pytest.mark.parametrize("report", ["many", "-1", "9" * 30, "١"])
def test_a_report_that_is_no_number_is_none(tmp_path, report):
    data = {"lost_messages": report, "lost /odom": report}
    info = read_info(foreign_bags.write_folder(tmp_path / "run", foreign_bags.irregular(1.0), custom_data=data))
    assert info.recorder_lost is None


def test_two_publishers_have_sequences_of_their_own(tmp_path):
    rows = [("/odom", foreign_bags.BEGIN + n, 100 * (n % 2) + n // 2 + 1, message) for n, message in numbered(40)]
    offers = {"/odom": foreign_bags.qos(publishers=2)}
    info = read_info(foreign_bags.write_folder(tmp_path / "run", rows, offers=offers))
    assert info.topics[0].lost == 0
    assert len(info.topics[0].qos) == 2


def numbered(count):
    return [(number, foreign_bags.command(0.1, 0.2)) for number in range(count)]


def test_noting_many_numbers_is_noting_each():
    for publishers, numbers in ((1, [1, 2, 3, 7, 8, 2, 3, 9]), (2, [1, 50, 2, 51, 4, 52]), (1, [5]), (1, [])):
        one, many = GapCounter(), GapCounter()
        one.publishers = many.publishers = publishers
        for number in numbers:
            one.note(number)
        for part in (numbers[:3], numbers[3:5], numbers[5:]):
            many.note_all(part)
        assert many.lost == one.lost


def test_files_sizes_and_compression(tmp_path):
    folder = foreign_bags.write_folder(tmp_path / "run", foreign_bags.irregular(), "lz4", files=2)
    info = read_info(folder, quick=True)
    assert {file.name: file.size for file in info.files} == {
        f"run_{number}.mcap": (folder / f"run_{number}.mcap").stat().st_size for number in (0, 1)
    }
    ((kind, chunks, packed, unpacked),) = info.compression
    assert (kind, chunks >= 10) == ("lz4", True)
    assert 0 < packed < info.size < unpacked
    assert info.message_count == len(foreign_bags.irregular())


def test_quick_reads_no_message(tmp_path):
    folder = foreign_bags.write_folder(tmp_path / "run", foreign_bags.irregular())
    path = folder / "run_0.mcap"
    whole, content = read_info(folder, quick=True), bytearray(path.read_bytes())
    content[1000:2000] = bytes(1000)
    path.write_bytes(content)
    assert read_info(folder, quick=True) == whole
    assert all(topic.figures is None for topic in whole.topics)
    with pytest.raises(DiffbotError, match="damaged") as error:
        read_info(folder)
    assert "\n" not in str(error.value)


def test_an_empty_bag_has_no_figures(tmp_path):
    writer = BagWriter(tmp_path / "run")
    writer.add_topic("/a", "nav_msgs/msg/Odometry")
    writer.close()
    (topic,) = read_info(tmp_path / "run").topics
    assert topic.figures._replace(unstamped=None, stamps_back=None)._asdict() == {
        "message_count": 0, "bytes": 0, "first": 0, "last": 0,
        "rate": None, "gap": None, "gap_begin": None, "latency": None,
        "unstamped": None, "stamps_back": None, "stamp_gap": None, "missing": None,
    }  # fmt: skip
    json.dumps(info_as_plain(read_info(tmp_path / "run")), allow_nan=False)


def test_a_log_time_beyond_the_range_is_one_line(tmp_path):
    folder = foreign_bags.write_folder(tmp_path / "run", [("/a", MAX_TIME + 1, 0, foreign_bags.command(0.0, 0.0))])
    with pytest.raises(DiffbotError, match=r"/a: log time .*: must be <= "):
        read_info(folder)


def test_a_bag_of_too_many_topics_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(bag_info, "MAX_TOPICS", 2)
    folder = foreign_bags.write_folder(tmp_path / "run", foreign_bags.irregular(1.0))
    with pytest.raises(DiffbotError, match=r"has 3 topics: must be <= 2$"):
        read_info(folder)


def test_progress_counts_every_message(tmp_path):
    moved = []
    folder = foreign_bags.write_folder(tmp_path / "run", foreign_bags.irregular(40.0))
    info = read_info(folder, progress=moved.append)
    assert sum(moved) == info.message_count
    assert len(moved) > 2


def test_nothing_is_lost_between_two_batches():
    meter = TopicMeter(True)
    times = [*range(4096), 4095 + 700, 4095 + 701]
    for number, time in enumerate(times):
        stamp = 10**9 - 5 if number == 4096 else 10**9 + time
        data = b"\0\1\0\0" + (stamp // 10**9).to_bytes(4, "little") + (stamp % 10**9).to_bytes(4, "little")
        meter.add(10**10 + time, data, number)
    found = meter.figures()
    assert (found.gap, found.gap_begin) == (700e-9, 10**10 + 4095)
    assert found.stamps_back == 1
    assert found.stamp_gap == pytest.approx((4095 + 701 + 5) * 1e-9)
    assert found.missing == 0


def test_memory_of_a_meter_does_not_grow():
    meter, data = TopicMeter(True), b"\0\1\0\0" + (5).to_bytes(4, "little") + bytes(8)
    tracemalloc.start()
    try:
        sizes = []
        for number in range(1, 4 * 4096 + 1):
            meter.add(number * 1000 + 5 * 10**9, data, number)
            if number in (2 * 4096, 4 * 4096):
                sizes.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert meter.figures().message_count == 4 * 4096
    # Its buckets grow with the logarithm of the values only.
    assert sizes[1] - sizes[0] < 200_000
