"""``diffbot bag check``: exit statuses, lines, JSON, drafts."""

import json

import bag_makers
import pytest
import view_bags

from diffbot_bag.tools.contract import read_contract
from diffbot_tools import cli

GOOD = "version: 1\nbag: {max_lost: 36}\ntopics:\n  /odom: {type: nav_msgs/msg/Odometry, min_rate: 40}\n"
BAD = GOOD + "  /scan: {}\nforbidden: [/pose]\n"


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return bag_makers.write_folder(tmp_path_factory.mktemp("bags") / "run", view_bags.irregular(), "lz4", 2)


@pytest.fixture
def check(bag, tmp_path, capsys, kept_signal_handlers):
    """Run the command with a contract of this text; return status, output and the one line of its error."""

    def run(text, *arguments, path=bag):
        contract = tmp_path / "contract.yaml"
        contract.write_text(text)
        status = cli.main(["bag", "check", str(path), str(contract), *map(str, arguments)])
        written = capsys.readouterr()
        assert written.err.count("\n") <= 1
        return status, written.out, written.err

    return run


def test_a_bag_that_keeps_its_contract_is_status_0_and_a_broken_rule_status_1(check):
    status, out, _ = check(GOOD)
    assert status == 0
    assert [line.split(":")[0] for line in out.splitlines()] == [
        "PASS bag max_lost", "PASS /odom required", "PASS /odom type", "PASS /odom min_rate", "4 of 4 rules hold",
    ]  # fmt: skip
    status, out, _ = check(BAD)
    assert status == 1
    assert [line for line in out.splitlines() if not line.startswith("PASS")] == [
        "FAIL /pose forbidden: 194 messages, must be 0 messages",
        "FAIL /scan required: not in the bag, must be in the bag",
        "4 of 6 rules hold",
    ]


def test_what_cannot_be_checked_is_status_2_in_one_line(check, tmp_path, bag):
    content = bytearray((bag / "run_0.mcap").read_bytes())
    content[1000:2000] = bytes(1000)
    (tmp_path / "bad.mcap").write_bytes(content)
    for text, options in (
        ("version: 1\ntopics: {/odom: {min_rat: 3}}", {}),
        (GOOD, {"path": tmp_path / "none"}),
        (GOOD, {"path": tmp_path / "bad.mcap"}),
    ):
        status, out, err = check(text, **options)
        assert (status, out, err[:9]) == (2, "", "diffbot: ")


def test_json_holds_the_results(check, bag, tmp_path):
    status, out, _ = check(BAD, "--json")
    found = json.loads(out)
    assert status == 1
    assert (found["bag"], found["contract"], found["passed"]) == (str(bag), str(tmp_path / "contract.yaml"), False)
    rate = next(one for one in found["results"] if one["rule"] == "min_rate")
    assert (rate["topic"], rate["passed"], rate["bound"], rate["unit"]) == ("/odom", True, 40.0, "Hz")
    assert rate["measured"] == pytest.approx(48.5, abs=0.1)
    failed = {(one["topic"], one["rule"]) for one in found["results"] if not one["passed"]}
    assert (len(found["results"]), failed) == (6, {("/pose", "forbidden"), ("/scan", "required")})


def test_a_drafted_contract_is_kept_by_its_bag(check, bag, tmp_path, capsys):
    path = tmp_path / "draft.yaml"
    assert cli.main(["bag", "check", "--write", str(path), str(bag)]) == 0
    assert capsys.readouterr().out.strip() == str(path)
    assert set(read_contract(path).topics) == {"/odom", "/pose", "/cmd_vel"}
    assert check(path.read_text())[0] == 0
    before = path.read_text()
    assert cli.main(["bag", "check", str(bag), "--write", str(path)]) == 2
    assert path.read_text() == before
    assert "exists already" in capsys.readouterr().err


def test_consistency_of_a_filter_is_a_rule(check, tmp_path):
    circle = view_bags.write(tmp_path / "circle", view_bags.drive())
    rules = "version: 1\ntopics: {/ekf/status: {min_nis_inside: 1.0, min_white: 1.0}}"
    assert check(rules, path=circle)[0] == 0
    worse = [
        (topic, time, view_bags.filter_status("/ekf", 8) if topic == "/ekf/status" else message)
        for topic, time, message in view_bags.drive(steps=50)
    ]
    status, out, _ = check(rules, path=view_bags.write(tmp_path / "worse", worse))
    assert status == 1
    assert "FAIL /ekf/status min_nis_inside: 0, must be >= 1" in out
