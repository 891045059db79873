"""Message definitions and hashes: against rosbags, which computes both by itself, for every installed type."""

import sys
from pathlib import Path

import pytest
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from diffbot_bag.bag.message_definitions import DefinitionNotFoundError, MessageDefinitions, ament_prefixes

PACKAGES = ("std_msgs", "geometry_msgs", "nav_msgs", "sensor_msgs", "diagnostic_msgs", "rcl_interfaces")
# rosbags hashes `char` as a type of its own, ROS as uint8.
HASHED_OTHERWISE = {"std_msgs/msg/Char"}


@pytest.fixture
def prefix(tmp_path):
    def write(name, text, package="my_msgs", root="one"):
        path = tmp_path / root / "share" / package / "msg" / f"{name}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text.encode())
        return tmp_path / root

    return write


def test_text_and_hash_of_every_installed_type_agree_with_other_libraries():
    definitions = MessageDefinitions()
    share = next(path / "share" for path in ament_prefixes() if (path / "share" / "std_msgs").is_dir())
    names = [f"{package}/msg/{path.stem}" for package in PACKAGES for path in (share / package / "msg").glob("*.msg")]
    assert len(names) > 100
    for name in names:
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(definitions.schema_text(name), name))
        agree = store.hash_rihs01(name) == definitions.type_hash(name)
        assert agree == (name not in HASHED_OTHERWISE), name
        assert name in generate_dynamic(name, definitions.schema_text(name))


def test_the_first_prefix_wins_and_the_environment_comes_last(prefix, monkeypatch, tmp_path):
    first, second = prefix("A", "int8 a\n"), prefix("A", "int16 a\n", root="two")
    assert MessageDefinitions([first, second]).schema_text("my_msgs/msg/A") == "int8 a\n"
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{second}:{first}")
    assert ament_prefixes() == [second, first, Path(sys.prefix)]
    assert MessageDefinitions().schema_text("my_msgs/msg/A") == "int16 a\n"
    assert MessageDefinitions().schema_text("std_msgs/msg/Empty") == ""
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    assert ament_prefixes() == [Path(sys.prefix)]


@pytest.mark.parametrize("name", ["my_msgs/msg/Nothing", "std_msgs", "std_msgs/msg/../Bool"])
def test_what_is_not_installed_is_named(name, prefix):
    prefix("A", "int8 a\n")
    definitions = MessageDefinitions([prefix("Part", "Lost lost\n")])
    with pytest.raises(DefinitionNotFoundError, match=name):
        definitions.schema_text(name)
    with pytest.raises(DefinitionNotFoundError):
        definitions.type_hash(name)
    with pytest.raises(DefinitionNotFoundError, match="my_msgs/Lost"):
        definitions.schema_text("my_msgs/msg/Part")
