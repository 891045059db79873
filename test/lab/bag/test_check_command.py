"""``diffbot bag check``: exit statuses, lines, JSON, JUnit, drafts."""

import json
from xml.etree import ElementTree

import foreign_bags
import pytest
import view_bags

from diffbot_bag.tools.contract import read_contract
from diffbot_lab import cli

GOOD = "version: 1\nbag: {max_lost: 36}\ntopics:\n  /odom: {type: nav_msgs/msg/Odometry, min_rate: 40}\n"
BAD = GOOD + "  /scan: {}\nforbidden: [/pose]\n"


@pytest.fixture(autouse=True)
def handlers(kept_signal_handlers):
    pass


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return foreign_bags.write_folder(tmp_path_factory.mktemp("bags") / "run", foreign_bags.irregular(), "lz4", 2)


@pytest.fixture
def check(bag, tmp_path, capsys):
    """Run the command with a contract of this text; return status, output and the one line of its error."""

    def run(text, *arguments, path=bag):
        contract = tmp_path / "contract.yaml"
        contract.write_text(text)
        status = cli.main(["bag", "check", str(path), str(contract), *map(str, arguments)])
        written = capsys.readouterr()
        assert written.err.count("\n") <= 1
        return status, written.out, written.err

    return run


def test_a_bag_that_keeps_its_contract_is_status_0(check):
    status, out, _ = check(GOOD)
    assert status == 0
    assert [line.split(":")[0] for line in out.splitlines()] == [
        "PASS bag max_lost", "PASS /odom required", "PASS /odom type", "PASS /odom min_rate", "4 of 4 rules hold",
    ]  # fmt: skip


def test_a_broken_rule_is_status_1_with_its_line(check):
    status, out, _ = check(BAD)
    assert status == 1
    assert [line for line in out.splitlines() if line.startswith("FAIL")] == [
        "FAIL /pose forbidden: 194 messages, must be 0 messages",
        "FAIL /scan required: not in the bag, must be in the bag",
    ]
    assert out.splitlines()[-1] == "4 of 6 rules hold"


def test_a_bad_contract_or_bag_is_status_2_in_one_line(check, tmp_path, capsys, bag):
    assert check("version: 1\ntopics: {/odom: {min_rat: 3}}")[0] == 2
    status, out, err = check(GOOD, path=tmp_path / "none")
    assert (status, out) == (2, "")
    assert err.startswith("diffbot: no bag ")
    content = bytearray((bag / "run_0.mcap").read_bytes())
    content[1000:2000] = bytes(1000)
    (tmp_path / "bad.mcap").write_bytes(content)
    assert check(GOOD, path=tmp_path / "bad.mcap")[:2] == (2, "")
    for arguments in ([], ["c.yaml", "--write", "d.yaml"], ["--write", "d.yaml", "--json"]):
        assert cli.main(["bag", "check", str(bag), *arguments]) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_json(check, bag, tmp_path):
    status, out, _ = check(BAD, "--json")
    found = json.loads(out)
    assert status == 1
    assert {name: found[name] for name in ("schema_version", "bag", "contract", "passed")} == {
        "schema_version": 1, "bag": str(bag), "contract": str(tmp_path / "contract.yaml"), "passed": False,
    }  # fmt: skip
    rate = next(one for one in found["results"] if one["rule"] == "min_rate")
    assert rate == {
        "topic": "/odom", "rule": "min_rate", "passed": True, "bound": 40.0, "unit": "Hz", "measured": rate["measured"],
    }  # fmt: skip
    assert rate["measured"] == pytest.approx(48.5, abs=0.1)


def test_junit(check, tmp_path):
    assert check(BAD, "--junit", tmp_path / "results.xml")[0] == 1
    suite = ElementTree.parse(tmp_path / "results.xml").getroot()
    assert (suite.get("tests"), suite.get("failures")) == ("6", "2")
    failed = {(case.get("classname"), case.get("name")) for case in suite if case.find("failure") is not None}
    assert failed == {("/pose", "forbidden"), ("/scan", "required")}


def test_junit_that_cannot_be_written_is_status_2(check, tmp_path):
    status, out, err = check(GOOD, "--junit", tmp_path / "none" / "results.xml")
    assert (status, out) == (2, "")
    assert "cannot write" in err


def test_a_drafted_contract_is_kept_by_its_bag(check, bag, tmp_path, capsys):
    path = tmp_path / "draft.yaml"
    assert cli.main(["bag", "check", "--write", str(path), str(bag)]) == 0
    assert capsys.readouterr().out.strip() == str(path)
    assert set(read_contract(path).topics) == {"/odom", "/pose", "/cmd_vel"}
    status, out, _ = check(path.read_text())
    assert (status, "FAIL" in out) == (0, False)
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
