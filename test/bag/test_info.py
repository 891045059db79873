"""Figures of bags of several writers, against figures computed with numpy from the messages that rosbags reads."""

import bag_makers
import numpy as np
import pytest
import view_bags
from bag_makers import read

from diffbot_tools.bag.info_text import info_text

YEAR = 365 * 86400 * 10**9


def by_rosbags(folder, rows):
    """Write with rosbags, which does not write sequence numbers."""
    return view_bags.write(folder, ((topic, time, message) for topic, time, _, message in rows))


MAKERS = {
    "mcap zstd": lambda folder: bag_makers.write_folder(folder, view_bags.irregular()),
    "mcap lz4, three files": lambda folder: bag_makers.write_folder(folder, view_bags.irregular(), "lz4", 3),
    "rosbags": lambda folder: by_rosbags(folder, view_bags.irregular()),
}


@pytest.fixture(scope="module", params=MAKERS)
def bag(request, tmp_path_factory):
    return MAKERS[request.param](tmp_path_factory.mktemp("bags") / "run")


def independent(path):
    """Return log times, sizes and stamps of each topic, as rosbags reads them."""
    sizes = {topic: [(time, len(data)) for time, data in rows] for topic, rows in read(path, raw=True).items()}
    found = {}
    for topic, rows in read(path).items():
        headers = [getattr(message, "header", None) for _, message in rows]
        stamps = [header and header.stamp.sec * 10**9 + header.stamp.nanosec for header in headers]
        found[topic] = [(*row, stamp) for row, stamp in zip(sizes[topic], stamps, strict=True)]
    return found


def test_figures_agree_with_numpy_and_rosbags(bag):
    moved = []
    info = bag_makers.read_info(bag, progress=moved.append)
    assert sum(moved) == info.message_count
    topics = {topic.name: topic for topic in info.topics}
    expected = independent(bag)
    assert set(topics) == set(expected) == {"/odom", "/pose", "/cmd_vel"}
    for name, rows in expected.items():
        figures = topics[name].figures
        times = np.array([time for time, _, _ in rows])
        gaps = np.diff(times)
        assert topics[name].message_count == len(rows)
        assert figures.bytes == sum(size for _, size, _ in rows)
        assert (figures.first, figures.last) == (times[0], times[-1])
        assert figures.rate == pytest.approx((len(rows) - 1) / (1e-9 * (times[-1] - times[0])), rel=1e-12)
        assert figures.gap == pytest.approx(1e-9 * gaps.max(), rel=1e-12)
        assert figures.gap_begin == times[gaps.argmax()]
        if rows[0][2] is None:
            assert (figures.latency, figures.unstamped, figures.stamps_back, figures.stamp_gap) == (None,) * 4
            continue
        known = [(time, stamp) for time, _, stamp in rows if stamp]
        delays = sorted(time - stamp for time, stamp in known)
        stamps = np.array([stamp for _, stamp in known])
        ranks = [0, -(-len(delays) // 2) - 1, -(-99 * len(delays) // 100) - 1]
        assert figures.latency == tuple(delays[rank] / 1e9 for rank in ranks)
        assert figures.unstamped == len(rows) - len(known)
        assert figures.stamps_back == np.count_nonzero(np.diff(stamps) < 0)
        assert figures.stamp_gap == pytest.approx(np.diff(stamps).max() * 1e-9, rel=1e-12)
    assert topics["/odom"].figures.gap == pytest.approx(0.62, abs=0.002)
    assert topics["/odom"].figures.stamps_back >= 1
    assert topics["/pose"].figures.unstamped == 2


def test_lost_is_the_recorders_count_or_the_missing_sequence_numbers_of_an_unfinished_bag(tmp_path):
    """Without the count of its recorder, a pause cannot be told from a loss."""
    info = bag_makers.read_info(by_rosbags(tmp_path / "rosbags", view_bags.irregular(1.0)))
    assert {topic.lost for topic in info.topics} == {info.lost} == {None}
    report = {"lost_messages": "50", "lost /odom": "7", "lost /cmd_vel": "43"}
    folder = bag_makers.write_folder(tmp_path / "run", view_bags.irregular(), files=3, custom_data=report)
    for quick in (False, True):
        info = bag_makers.read_info(folder, quick=quick)
        assert {topic.name: topic.lost for topic in info.topics} == {"/odom": 7, "/pose": 0, "/cmd_vel": 43}
        assert info.lost == 50
    last = folder / "run_2.mcap"
    last.write_bytes(last.read_bytes()[:-8])
    info = bag_makers.read_info(folder)
    assert {topic.name: topic.lost for topic in info.topics} == {"/odom": 30, "/pose": 6, "/cmd_vel": None}
    assert info.lost == 36


def test_time_jumps_and_other_encodings_are_reported(tmp_path):
    """The clock of the robot starts in 1970, and a bridge records JSON."""
    path = tmp_path / "run.mcap"
    kinds = {"/a": bag_makers.POINT, "/json": bag_makers.STRING}
    with (
        path.open("wb") as stream,
        bag_makers.mcap_writing(stream, {"/a": bag_makers.POINT}) as (writer, channels),
    ):
        channels["/json"] = writer.register_channel(
            "/json", "json", writer.register_schema("chat", "jsonschema", b"{}")
        )
        for time in (5 * 10**9, 6 * 10**9, 56 * YEAR, 56 * YEAR + 59 * 10**9):
            for topic in kinds:
                writer.add_message(channels[topic], time, b"{}", time)
    info = bag_makers.read_info(path)
    assert info.jumps == ((6 * 10**9, 56 * YEAR),)
    assert [(topic.name, topic.type, topic.encoding) for topic in info.topics] == [
        ("/a", bag_makers.POINT, "cdr"),
        ("/json", "chat", "json"),
    ]
    text = info_text(info)
    assert "Topic: /json | Type: chat | Count: 4 | Serialization Format: json" in text
    (line,) = [line for line in text.splitlines() if line.startswith("Time jump:")]
    assert "56.0 years, from 1.000 s on" in line
