"""The services of rosbag2's player: names, fields and effects, with stand-ins for its types."""

from types import SimpleNamespace

import pytest
from bag_makers import BEGIN, MS, point

from diffbot_bag.bag.reader import RawMessage
from diffbot_bag.replay.playback_clock import Window
from diffbot_bag.replay.player import Pace, Player, Sink, Source
from diffbot_bag.ros.replay_services import ROSBAG2_SERVICES, ReplayServices

NAMES = {name: "".join(word.capitalize() for word in name.split("_")) for name in ROSBAG2_SERVICES}
MESSAGES = [RawMessage("/a", point(index), BEGIN + index * MS, 0) for index in range(100)]


@pytest.fixture
def player():
    window = Window(BEGIN, BEGIN + 99 * MS)
    return Player(window, Source(lambda _start: MESSAGES), Sink(lambda _message: None), Pace(start_paused=True))


@pytest.fixture
def served(player):
    """The services that a node is asked for, and a function that calls one of rosbag2's and returns its fields."""
    control = SimpleNamespace(
        seek=lambda time: BEGIN <= time <= BEGIN + 99 * MS and player.seek(time),
        set_rate=lambda rate: not player.set_rate(rate),
        end=player.stop,
    )
    offered, changes = {}, []
    node = SimpleNamespace(create_service=lambda kind, name, callback: offered.update({name: (kind, callback)}))
    services = ReplayServices(node, player, control, lambda: changes.append(1))
    services.offer_rosbag2(SimpleNamespace(**{kind: kind for kind in NAMES.values()}))

    def call(name, **request):
        before = len(changes)
        response = offered[f"rosbag2_player/{name}"][1](SimpleNamespace(**request), SimpleNamespace())
        assert len(changes) == before + 1
        return vars(response)

    return offered, call


def test_their_fields_carry_what_rosbag2_s_carry(served, player):
    offered, call = served
    kinds = {name.partition("/")[2]: kind for name, (kind, _) in offered.items() if name.startswith("rosbag2")}
    assert kinds == NAMES
    assert call("is_paused") == {"paused": True}
    assert call("resume") == {}
    assert call("is_paused") == {"paused": False}
    assert call("burst", num_messages=3) == {"actually_burst": 0}
    assert call("play_next") == {"success": False}
    assert call("toggle_paused") == {}
    assert player.progress().is_paused
    assert call("set_rate", rate=2.5) == {"success": True}
    assert call("get_rate") == {"rate": 2.5}
    for rate in (0.0, -1.0, float("nan"), float("inf")):
        assert call("set_rate", rate=rate) == {"success": False}
    assert call("get_rate") == {"rate": 2.5}
    sec, nanosec = divmod(BEGIN + 42 * MS, 10**9)
    assert call("seek", time=SimpleNamespace(sec=sec, nanosec=nanosec)) == {"success": True}
    assert player.progress().bag_time == BEGIN + 42 * MS
    assert call("seek", time=SimpleNamespace(sec=0, nanosec=0)) == {"success": False}
    assert call("stop") == {}
    player.play()
    assert call("seek", time=SimpleNamespace(sec=sec, nanosec=nanosec)) == {"success": False}
