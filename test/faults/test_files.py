"""Hostile files and calls: parameter files, journals with a flipped bit, parameter calls of any length."""

import array
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor

import graph
import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from repeated import tried

from diffbot_control import controller_node
from diffbot_core.errors import DiffbotError
from diffbot_core.yaml_files import MAX_BYTES
from diffbot_lab.campaign import spec
from diffbot_lab.campaign.journal import JOURNAL, Journal, decode_line
from diffbot_lab.campaign.runner import run_campaign
from diffbot_lab.campaign.spec import make_campaign

CAMPAIGN = {
    "set": {"preset": "paper"},
    "runs": 40,
    "duration": 4.0,
    "feedback": "raw",
    "grid": {"k": [1.0, 4.0]},
}
NAME = "parameters.yaml"


def written(text):
    return lambda path: path.write_text(text)


BAD_FILES = {
    "missing": (lambda path: None, "No such file"),
    "nearly the node": (written("/**/controler: {ros__parameters: {sigma_known: 0.2}}"), "did you mean controller?"),
    "another node": (written("/**/plant: {ros__parameters: {seed: 1}}"), "has no section for /controller"),
    "a value out of bounds": (written("/**/controller: {ros__parameters: {hold_goal: 3}}"), f"{NAME}, section /**/"),
    "too large": (written("/**: {ros__parameters: {\n" + "  a: 1,\n" * MAX_BYTES + "}}"), f"must be <= {MAX_BYTES}"),
    "no YAML": (written("a: ["), "is not a YAML file"),
    "a pipe": (os.mkfifo, "not a regular file"),
}
"""A function that makes the file, and a part of the line that refuses it; test_yaml_files.py has more contents."""


def value(kind, **fields):
    return SetParameters.Request(
        parameters=[Parameter(name="sigma_known", value=ParameterValue(type=getattr(ParameterType, kind), **fields))]
    )


LONG_CALLS = (
    (
        "set",
        SetParameters,
        lambda n: value("PARAMETER_DOUBLE_ARRAY", double_array_value=array.array("d", bytes(8 * n))),
    ),
    ("set", SetParameters, lambda n: value("PARAMETER_STRING", string_value="x" * 10 * n)),
    ("set", SetParameters, lambda n: SetParameters.Request(parameters=[Parameter(name="sigma_known")] * (n // 200))),
    ("get", GetParameters, lambda n: GetParameters.Request(names=["sigma_known"] * (n // 2))),
    ("list", ListParameters, lambda n: ListParameters.Request(prefixes=["sigma_known"] * (n // 2))),
)
"""Service, its type, and a request of about 10 ``n`` bytes; n / 200 parameters, since rclpy needs 60 us for each."""


@pytest.fixture
def controller():
    with graph.node("diffbot_control.controller_node") as running:
        yield running


@tried(80, once=5)
def test_a_node_answers_other_clients_within_half_a_second_during_calls_of_any_length(controller, trials):
    request = GetParameters.Request(names=["sigma_known"])
    with graph.peer("hostile") as hostile, graph.peer("other") as other:
        for number in trials:
            service, kind, make = LONG_CALLS[number % len(LONG_CALLS)]
            name = "controller/list_parameters" if service == "list" else f"controller/{service}_parameters"
            client = hostile.node.create_client(kind, name)
            hostile.spin_until(client.service_is_ready, what=f"the service {name}")
            assert other.call(GetParameters, "controller/get_parameters", request).values
            answer = client.call_async(make(10**6))
            while not answer.done():
                begin = time.monotonic()
                assert other.call(GetParameters, "controller/get_parameters", request).values
                assert time.monotonic() - begin <= trials.bound(0.5)
                hostile.comes_true(answer.done, 0.001)
            refused = [one.reason for one in getattr(answer.result(), "results", ())]
            assert all(len(reason) < 300 for reason in refused)
            assert all("must be <= " in reason or "undeclared" in reason for reason in refused)
            hostile.node.destroy_client(client)
    assert controller.stop(signal.SIGTERM) == 0


@pytest.mark.parametrize("content", BAD_FILES)
@pytest.mark.usefixtures("kept_signal_handlers")
def test_a_bad_parameter_file_ends_the_start_in_one_line_that_names_it(content, tmp_path, capfd, monkeypatch):
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")  # the node sets it
    make, reason = BAD_FILES[content]
    make(tmp_path / NAME)
    assert controller_node.main(["--ros-args", "--params-file", str(tmp_path / NAME)]) == 1
    printed = capfd.readouterr().err
    (line,) = [one for one in printed.splitlines() if one.startswith("error: ")]
    assert reason in line
    assert NAME in line
    assert "Traceback" not in printed


@tried(30)
def test_a_signal_ends_a_node_while_it_reads_the_largest_file(tmp_path, trials, seeded):
    path = tmp_path / NAME
    names = "".join(f"    n{number}: 1\n" for number in range(MAX_BYTES // 16))
    own = "/**/controller:\n  ros__parameters:\n    hold_goal: true\n"
    path.write_text(f"{own}/**/plant:\n  ros__parameters:\n{names}")
    assert path.stat().st_size < MAX_BYTES
    for _ in trials:
        with graph.node("diffbot_control.controller_node", arguments=("--params-file", path)) as node:
            time.sleep(seeded.uniform(0.1, 3.0))  # at any moment of the start
            begin = time.monotonic()
            status = node.stop(seeded.choice((signal.SIGINT, signal.SIGTERM)))
            assert time.monotonic() - begin <= trials.bound(2.0)
            # Early in the start, the signal has the default action of the interpreter.
            assert status in (0, 130, -signal.SIGINT, -signal.SIGTERM)


@tried(3000, once=0)
def test_a_flipped_bit_changes_no_result_of_a_campaign(tmp_path, trials, seeded, monkeypatch):
    monkeypatch.setattr(spec, "_STEPS_PER_CHUNK", 10 * 40)
    campaign = make_campaign(CAMPAIGN)
    path = tmp_path / JOURNAL

    def entries():
        """Return what the journal counts, without the order of its lines."""
        found = map(decode_line, path.read_bytes().splitlines(keepends=True))
        return sorted(str(entry) for entry in found if entry is not None)

    def finish():
        journal = Journal(path, campaign)
        try:
            run_campaign(campaign, journal, lambda: ThreadPoolExecutor(1), 1)
        finally:
            journal.close()

    finish()
    whole, expected = path.read_bytes(), entries()
    for _ in trials:
        changed, bit = bytearray(whole), seeded.randrange(8 * len(whole))
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        try:
            finish()  # the chunk of the damaged line runs again
        except DiffbotError:
            assert path.read_bytes() == bytes(changed)
        else:
            assert entries() == expected
