"""Messages, definitions and type hashes: against rclpy, mcap-ros2-support, and rosbags' own hashes."""

import random
import sys

import pytest
from bag_makers import POINT
from geometry_msgs.msg import PoseWithCovarianceStamped
from hypothesis import given
from hypothesis import strategies as st
from mcap_ros2._dynamic import generate_dynamic
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from diffbot_bag.conversions import message_class
from diffbot_bag.definitions import DefinitionNotFoundError, ament_prefixes, schema_text, type_hash
from diffbot_bag.messages import decode, encode, make
from diffbot_core.errors import DiffbotError

ODOMETRY, POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped"
PACKAGES = ("std_msgs", "geometry_msgs", "nav_msgs", "sensor_msgs", "diagnostic_msgs", "rcl_interfaces")
# rosbags hashes `char` as a type of its own, ROS as uint8.
HASHED_OTHERWISE = {"std_msgs/msg/Char"}
FRAMES = st.text(st.characters(exclude_categories=("Cs", "Cc")), max_size=9)


def odometry(frame, child):
    """An odometry of rclpy with a different number in each field."""
    draw = random.Random(7).uniform
    message = Odometry(child_frame_id=child)
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = -5, 999_999_999
    for part in (message.pose.pose.position, message.twist.twist.linear, message.twist.twist.angular):
        part.x, part.y, part.z = draw(-9, 9), draw(-9, 9), draw(-9, 9)
    message.pose.pose.orientation.z, message.pose.pose.orientation.w = 0.6, -0.8
    message.pose.covariance[:] = [draw(-1, 1) for _ in range(36)]
    message.twist.covariance[:] = [draw(-1, 1) for _ in range(36)]
    return message


def plain(message):
    """Return the fields of a message of rclpy, rosbags or mcap-ros2-support as maps, lists and numbers."""
    if hasattr(message, "get_fields_and_field_types"):
        return {name: plain(getattr(message, name)) for name in message.get_fields_and_field_types()}
    names = getattr(message, "__dataclass_fields__", getattr(message, "__slots__", None))
    if names and not isinstance(message, (str, int, float)):
        return {name: plain(getattr(message, name)) for name in names if name != "__msgtype__"}
    return [plain(one) for one in message] if hasattr(message, "__len__") and not isinstance(message, str) else message


@given(FRAMES, FRAMES)
def test_encode_and_decode_agree_with_rclpy(frame, child):
    theirs = odometry(frame, child)
    pose = PoseWithCovarianceStamped(header=theirs.header, pose=theirs.pose)
    for name, message in ((ODOMETRY, theirs), (POSE, pose)):
        decoded = decode(name, serialize_message(message))
        assert plain(decoded) == plain(message)
        data = encode(name, decoded)
        assert len(data) == len(serialize_message(message))
        assert deserialize_message(data, type(message)) == message
        assert encode(name, message) == data


def test_make_sets_given_fields_and_zeros_the_others():
    made = make(ODOMETRY, header={"stamp": {"sec": 3}, "frame_id": "odom"}, pose={"covariance": range(36)})
    expected = Odometry()
    expected.header.stamp.sec, expected.header.frame_id = 3, "odom"
    expected.pose.covariance[:] = range(36)
    expected.pose.pose.orientation.w = 0.0
    assert deserialize_message(encode(ODOMETRY, made), Odometry) == expected
    array = make("std_msgs/msg/Float64MultiArray", layout={"dim": [{"label": "a"}, {"size": 7}]}, data=[1, 2.5])
    assert [(one.label, one.size) for one in array.layout.dim] == [("a", 0), ("", 7)]
    assert array.data.tolist() == [1.0, 2.5]
    with pytest.raises(DiffbotError, match=r"Odometry does not have a field child$"):
        make(ODOMETRY, child="base_link")


def test_the_definition_of_the_bag_takes_precedence_over_the_installed_type():
    own = "float32 height\nmy_msgs/Part[] parts\n" + "=" * 80 + "\nMSG: my_msgs/Part\nuint8 kind\nstring name"
    data = b"\0\1\0\0" + b"\0\0\x20\x41" + b"\1\0\0\0" + b"\7" + b"\0\0\0" + b"\3\0\0\0hi\0"
    expected = generate_dynamic(POINT, own)[POINT](data)
    for _ in range(2):
        found = decode(POINT, data, own)
        assert (found.height, found.parts[0].kind, found.parts[0].name) == (10.0, 7, "hi")
        assert (expected.height, expected.parts[0].kind, expected.parts[0].name) == (10.0, 7, "hi")
        assert decode(POINT, encode(POINT, make(POINT, x=1.5)), schema_text(POINT)).x == 1.5


@pytest.mark.parametrize(
    ("definition", "data", "words"),
    [
        (None, b"\0\1\0\0short", "cannot decode 9 bytes as geometry_msgs/msg/Point"),
        (None, bytes(28) + b"\0\0\0\0\0", "cannot decode 33 bytes as"),
        (None, b"\0\7\0\0" + bytes(24), "cannot decode 28 bytes as"),
        ("float64 [x]\n", bytes(28), "the definition of geometry_msgs/msg/Point cannot be parsed"),
        ("my_msgs/Lost x\n", bytes(28), "the definition of geometry_msgs/msg/Point cannot be parsed"),
    ],
)
def test_invalid_messages_and_definitions_are_refused_in_one_line(definition, data, words):
    with pytest.raises(DiffbotError, match=words) as error:
        decode(POINT, data, definition)
    assert str(error.value).isprintable()


def test_definitions_and_hashes_of_all_installed_types_agree_with_other_libraries():
    share = next(path / "share" for path in ament_prefixes() if (path / "share" / "std_msgs").is_dir())
    names = [f"{package}/msg/{path.stem}" for package in PACKAGES for path in (share / package / "msg").glob("*.msg")]
    assert len(names) > 100
    for name in names:
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(schema_text(name), name))
        assert (store.hash_rihs01(name) == type_hash(name)) == (name not in HASHED_OTHERWISE), name
        assert name in generate_dynamic(name, schema_text(name))


def test_the_first_prefix_takes_precedence_and_a_missing_type_is_named(monkeypatch, tmp_path):
    for root, name, text in (("one", "A", "int8 a\n"), ("two", "A", "int16 a\n"), ("two", "B", "Lost lost\n")):
        path = tmp_path / root / "share/my_msgs/msg" / f"{name}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'two'}:{tmp_path / 'one'}")
    assert schema_text("my_msgs/msg/A") == "int16 a\n"
    assert schema_text("std_msgs/msg/Empty") == "", "sys.prefix comes last"
    assert decode("my_msgs/msg/A", b"\0\1\0\0\5\1").a == 261
    for name, missing in (
        ("my_msgs/msg/B", "my_msgs/Lost"),
        ("std_msgs", "std_msgs"),
        ("std_msgs/msg/../Bool", "Bool"),
    ):
        with pytest.raises(DefinitionNotFoundError, match=missing):
            schema_text(name)
        with pytest.raises(DefinitionNotFoundError):
            type_hash(name)


@pytest.mark.parametrize("name", ["this/x/y", "evil/msg/X", "../evil/msg/X"])
def test_message_class_imports_only_installed_interface_packages(tmp_path, name, monkeypatch):
    (tmp_path / "evil").mkdir()
    for file in ("evil/__init__.py", "evil/msg.py"):
        (tmp_path / file).write_text(f"from pathlib import Path\nPath({str(tmp_path / 'ran')!r}).touch()\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert message_class(POINT)().x == 0.0
    with pytest.raises(DiffbotError) as error:
        message_class(name)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "ran").exists()
    assert "this" not in sys.modules
