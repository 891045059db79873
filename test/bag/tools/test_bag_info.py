"""Figures of bags by several makers, against the same computed with numpy from what rosbags reads."""

import bag_makers
import numpy as np
import pytest
import view_bags
from bag_makers import read

from diffbot_bag.mcap.format import MAX_TIME
from diffbot_bag.tools import bag_info
from diffbot_bag.tools.bag_info import read_info
from diffbot_bag.tools.topic_figures import TopicMeter
from diffbot_core.errors import DiffbotError


def by_rosbags(folder, rows):
    """Write with rosbags, which gives no sequence numbers."""
    return view_bags.write(folder, ((topic, time, message) for topic, time, _, message in rows))


MAKERS = {
    "mcap zstd": lambda folder: bag_makers.write_folder(folder, view_bags.irregular()),
    "mcap lz4, three files": lambda folder: bag_makers.write_folder(folder, view_bags.irregular(), "lz4", 3),
    "mcap without compression": lambda folder: bag_makers.write_folder(folder, view_bags.irregular(), "none"),
    "rosbags": lambda folder: by_rosbags(folder, view_bags.irregular()),
}


@pytest.fixture(scope="module", params=MAKERS)
def bag(request, tmp_path_factory):
    return MAKERS[request.param](tmp_path_factory.mktemp("bags") / "run")


def independent(path):
    """Log times, sizes and stamps of each topic, as rosbags reads them."""
    sizes = {topic: [(time, len(data)) for time, data in rows] for topic, rows in read(path, raw=True).items()}
    found = {}
    for topic, rows in read(path).items():
        headers = [getattr(message, "header", None) for _, message in rows]
        stamps = [header and header.stamp.sec * 10**9 + header.stamp.nanosec for header in headers]
        found[topic] = [(*row, stamp) for row, stamp in zip(sizes[topic], stamps, strict=True)]
    return found


def test_figures_are_those_of_an_independent_reader(bag):
    moved = []
    info = read_info(bag, progress=moved.append)
    assert sum(moved) == info.message_count
    topics = {topic.name: topic for topic in info.topics}
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
    assert topics["/odom"].figures.gap == pytest.approx(0.62, abs=0.002)
    assert topics["/odom"].figures.stamps_back >= 1
    assert topics["/pose"].figures.unstamped == 2


def lost_in(info):
    return {topic.name: topic.lost for topic in info.topics}


def test_missing_sequence_numbers_are_lost_messages_and_the_recorders_report_counts_if_it_knows_of_more(tmp_path):
    info = read_info(by_rosbags(tmp_path / "rosbags", view_bags.irregular(1.0)))
    assert lost_in(info) == {"/odom": None, "/pose": None, "/cmd_vel": None}
    assert info.lost is None
    report = {"lost_messages": "50", "lost /odom": "7", "lost /cmd_vel": "43"}
    folder = bag_makers.write_folder(tmp_path / "run", view_bags.irregular(), files=3, custom_data=report)
    info = read_info(folder)
    assert lost_in(info) == {"/odom": 30, "/pose": 6, "/cmd_vel": 43}
    assert info.lost == 79
    assert lost_in(read_info(folder, quick=True))["/cmd_vel"] == 43


def test_quick_reads_no_message(tmp_path):
    folder = bag_makers.write_folder(tmp_path / "run", view_bags.irregular())
    path = folder / "run_0.mcap"
    whole, content = read_info(folder, quick=True), bytearray(path.read_bytes())
    content[1000:2000] = bytes(1000)
    path.write_bytes(content)
    assert read_info(folder, quick=True) == whole
    assert all(topic.figures is None for topic in whole.topics)
    with pytest.raises(DiffbotError, match="damaged"):
        read_info(folder)


def test_a_bag_beyond_the_bounds_is_refused(tmp_path, monkeypatch):
    folder = bag_makers.write_folder(tmp_path / "late", [("/a", MAX_TIME + 1, 0, view_bags.command(0.0, 0.0))])
    with pytest.raises(DiffbotError, match=r"late_0.mcap: log time .*: must be <= "):
        read_info(folder)
    monkeypatch.setattr(bag_info, "MAX_TOPICS", 2)
    with pytest.raises(DiffbotError, match=r"has 3 topics: must be <= 2$"):
        read_info(bag_makers.write_folder(tmp_path / "run", view_bags.irregular(1.0)))


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
