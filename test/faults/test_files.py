"""Hostile parameter files, and parameter calls of any length."""

import os
import signal
import time

import graph
import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from repeated import tried

from diffbot_control import controller_node
from diffbot_core.yaml_files import MAX_BYTES

NAME = "parameters.yaml"


def written(text):
    return lambda path: path.write_text(text)


BAD_FILES = {
    # The seed is a parameter of the plant.
    "a misspelt name": (written("/**: {ros__parameters: {seed: 1, hold_gaol: true}}"), "hold_gaol = True: must be"),
    "a value out of bounds": (written("/**/controller: {ros__parameters: {hold_goal: 3}}"), f"{NAME}, section /**/"),
    "too large": (written("/**: {ros__parameters: {\n" + "  a: 1,\n" * MAX_BYTES + "}}"), f"must be <= {MAX_BYTES}"),
    "a pipe": (os.mkfifo, "not a regular file"),
}
"""A function that makes the file, and a part of the line that refuses it; test_yaml_files.py has more contents."""


def array_of(length):
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=[0.0] * length)
    return SetParameters.Request(parameters=[Parameter(name="sigma_known", value=value)])


LONG_CALLS = (
    ("set", SetParameters, lambda: array_of(10**6)),
    ("set", SetParameters, lambda: SetParameters.Request(parameters=[Parameter(name="sigma_known")] * 5000)),
    ("get", GetParameters, lambda: GetParameters.Request(names=["sigma_known"] * 500_000)),
)
"""Service, its type, and a request; few parameters, since rclpy needs 60 us for each."""


@pytest.fixture
def controller():
    with graph.node("diffbot_control.controller_node") as running:
        yield running


@tried(80, once=3)
def test_a_node_answers_other_clients_within_half_a_second_during_calls_of_any_length(controller, trials):
    request = GetParameters.Request(names=["sigma_known"])
    with graph.peer("hostile") as hostile, graph.peer("other") as other:
        for number in trials:
            service, kind, make = LONG_CALLS[number % len(LONG_CALLS)]
            name = f"controller/{service}_parameters"
            client = hostile.node.create_client(kind, name)
            hostile.spin_until(client.service_is_ready, what=f"the service {name}")
            assert other.call(GetParameters, "controller/get_parameters", request).values
            answer = client.call_async(make())
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
