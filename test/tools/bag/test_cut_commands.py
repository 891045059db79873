"""``diffbot bag trim``, ``filter`` and ``merge``: usage, one line for each error, nothing half-written."""

import cut_bags
import pytest
from cut_bags import BEGIN, STEP, check_metadata, facts

from diffbot_bag.tools.span import Span
from diffbot_bag.tools.time_text import parse_duration, parse_time, span_of
from diffbot_tools import cli

pytestmark = pytest.mark.usefixtures("kept_signal_handlers")
S = 10**9
LAST = BEGIN + 199 * STEP + 3


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return cut_bags.write_bag(tmp_path_factory.mktemp("bags") / "run", "zstd")


def run(*arguments):
    return cli.main(["bag", *map(str, arguments)])


@pytest.mark.parametrize(
    ("flags", "start", "end"),
    [
        (("--from", "0.5s", "--to", "end-0.5s"), BEGIN + S // 2, LAST + 1 - S // 2),
        (("--last", "0.25"), LAST + 1 - S // 4, LAST + 1),
        (("--from", "1700000000.5", "--to", "start + 1s"), BEGIN + S // 2, BEGIN + S),
    ],
)
def test_trim(bag, tmp_path, capsys, flags, start, end):
    assert run("trim", bag, tmp_path / "part", "--no-latched", *flags) == 0
    expected = [one for one in facts(bag) if start <= one.log_time < end]
    assert check_metadata(tmp_path / "part") == expected
    times = [one.log_time for one in expected]
    seconds = (max(times) - min(times)) / S
    assert capsys.readouterr().out == f"{tmp_path / 'part'}: {len(expected)} messages of 3 topics, {seconds:.3f} s\n"


def test_a_merge_of_what_a_filter_took_apart_is_the_bag(bag, tmp_path):
    assert run("filter", bag, tmp_path / "points", "--topics", "/point") == 0
    assert run("filter", bag, tmp_path / "others", "--exclude", "/point") == 0
    assert run("filter", bag, tmp_path / "texts", "--exclude-regex", "/(point|map)", "--types", cut_bags.STRING) == 0
    assert {one.topic for one in facts(tmp_path / "texts")} == {"/text"}
    assert run("merge", tmp_path / "points", tmp_path / "others", tmp_path / "all") == 0
    assert check_metadata(tmp_path / "all") == facts(bag)


def test_a_span_outside_of_the_bag_is_one_line(bag, tmp_path, capsys):
    for flags, words in (
        (("--from", "2s"), "from = '2s': must be before the end of the bag (the bag lasts 1.99"),
        (("--from", "10"), "from = '10': must be in the bag (1700000000.000000000 to 17"),
        (("--from", "1s", "--to", "1s"), "from = '1s': must be before to = '1s'"),
    ):
        assert run("trim", bag, tmp_path / "part", *flags) == 1
        written = capsys.readouterr()
        assert (written.out, written.err.count("\n")) == ("", 1)
        assert written.err.startswith(f"diffbot: {words}")
    assert list(tmp_path.iterdir()) == []


def test_times_and_durations_are_exact():
    durations = {"10s": 10 * S, "1.5min": 90 * S, "2h": 7200 * S, "250 ms": S // 4, "0.000000001": 1, "7ns": 7}
    assert {text: parse_duration(text) for text in durations} == durations
    assert parse_time("1700000000.123456789").in_span(Span(5, 9)) == 1_700_000_000_123_456_789
    assert span_of(Span(100, 200), parse_time("30ns"), parse_time("end-30ns")) == (130, 170)
    assert span_of(Span(100, 200), parse_time("end-500ns"), parse_time("500ns")) == (100, 200)
