"""The requests of the page to a robot, without a graph."""

import queue
import threading
from types import SimpleNamespace

import pytest

from diffbot_control.law.configuration import DockingConfig
from diffbot_core.geometry import Pose
from diffbot_tools.view.requests import Request
from diffbot_tools.watch.robot_client import RobotClient


def test_a_filter_that_does_not_answer_an_initial_pose_delays_a_cancellation_by_three_seconds_at_most():
    client, timeouts = object.__new__(RobotClient), []
    client._config = SimpleNamespace(map_frame="map")
    client._client = SimpleNamespace(setInitialPose=lambda _pose, timeout=10.0: timeouts.append(timeout))
    assert client._call_services(Request("initialpose", "", Pose(1.0, 2.0, 0.0)))[1] == 2
    assert timeouts == [3.0]


def test_a_restarted_node_is_asked_for_its_parameters_again():
    ready, infos = {"parameters", "docking", "pause"}, []
    constants = iter(({"xy_tolerance": 0.1}, {"xy_tolerance": 0.2}))
    docking = iter({"staging_distance": distance, "dock_backward": True} for distance in (0.5, 0.6))
    client = object.__new__(RobotClient)
    names = ("parameters", "docking", "pause", "reset")
    client._services = {name: SimpleNamespace(service_is_ready=lambda name=name: name in ready) for name in names}
    client._constants = client._docking = client._last_info = None
    client._is_paused, client._on_info = True, infos.append
    client._request_constants, client._request_parameters = constants.__next__, lambda *_: next(docking)
    for _ in range(2):
        client._update_info()
    ready.clear()
    client._update_info()
    ready |= {"parameters", "docking", "pause"}
    client._update_info()
    backward = DockingConfig(dock_backward=True)
    assert [one.constants for one in infos] == [{"xy_tolerance": 0.1}, None, {"xy_tolerance": 0.2}]
    assert [one.docking for one in infos] == [
        backward._replace(staging_distance=0.5),
        None,
        backward._replace(staging_distance=0.6),
    ]
    assert [one.services["pause"]["isOn"] for one in infos] == [True, False, False]


@pytest.mark.parametrize(
    ("answers", "answer"),
    [
        ({"cancel_dock": 0, "cancel": 2}, 0),  # a docking that another client has started
        ({"cancel_dock": 2, "cancel": 0}, 0),
        ({"cancel_dock": 2, "cancel": 2}, 2),
        ({"cancel": 0}, 0),
        ({"cancel_dock": 0}, 0),
        ({}, 2),
    ],
)
def test_cancel_stops_each_controller_that_runs(answers, answer):
    client, called = object.__new__(RobotClient), []
    names = ("cancel_dock", "cancel")
    client._services = {name: SimpleNamespace(service_is_ready=lambda name=name: name in answers) for name in names}
    client._call = lambda name, _: called.append(name) or (name, answers.get(name, 2))
    assert client._call_services(Request("cancel", ""))[1] == answer
    assert called == (list(answers) or ["cancel"])


def test_a_cancellation_interrupts_the_request_before_it_but_not_itself():
    client = object.__new__(RobotClient)
    client._requests, client._stopped = queue.Queue(), threading.Event()
    for kind, is_interrupted in (("initialpose", False), ("cancel", True)):
        client.add(Request(kind, ""), lambda text, level: None)
        assert client.is_interrupted() == is_interrupted
    for is_interrupted in (True, False):
        client._requests.get()
        assert client.is_interrupted() == is_interrupted
    client._stopped.set()
    assert client.is_interrupted()
