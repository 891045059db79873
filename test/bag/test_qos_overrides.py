"""QoS overrides by file: rosbag2's form, what is left alone, and one line for what is not allowed."""

import pytest

from diffbot_bag.qos import INFINITE, Qos
from diffbot_bag.qos_overrides import overridden, read_overrides
from diffbot_core.errors import DiffbotError

TEXT = """\
/scan:
  reliability: best_effort
  history: keep_last
  depth: 5
  deadline: {sec: 1, nsec: 500}
  lifespan: {sec: 0, nsec: 0}
odom:
  durability: transient_local
  liveliness: manual_by_topic
  liveliness_lease_duration: {sec: 3, nsec: 0}
  avoid_ros_namespace_conventions: true
"""


@pytest.fixture
def file(tmp_path):
    def write(text):
        path = tmp_path / "qos.yaml"
        path.write_text(text)
        return path

    return write


def test_named_policies_change_and_the_others_stay(file):
    overrides = read_overrides(file(TEXT), "/robot")
    chosen = Qos("keep_last", 10, "reliable", "volatile", lifespan=7)
    assert overridden(chosen, "/scan", overrides) == Qos(
        "keep_last", 5, "best_effort", "volatile", 1_000_000_500, INFINITE
    )
    assert overridden(chosen, "/robot/odom", overrides) == chosen._replace(
        durability="transient_local",
        liveliness="manual_by_topic",
        liveliness_lease_duration=3_000_000_000,
        avoid_ros_namespace_conventions=True,
    )
    assert overridden(chosen, "/odom", overrides) == chosen
    assert read_overrides(file("")) == {}


BAD = {
    "policy": ("/a: {colour: red}", "/a.colour = 'red': must be a policy (history, depth,"),
    "word": ("/a: {reliability: sometimes}", "/a.reliability = 'sometimes': must be one of reliable, best_effort,"),
    "list": ("/a: {history: [1]}", "/a.history = '[1]': must be one of keep_last"),
    "depth": ("/a: {depth: 0}", "/a.depth = '0': must be a whole number, >= 1 and <= 1000000"),
    "bool depth": ("/a: {depth: true}", "/a.depth = 'True': must be a whole number"),
    "half a duration": ("/a: {deadline: {sec: 1}}", "/a.deadline = \"{'sec': 1}\": must be {sec: whole number"),
    "negative": ("/a: {deadline: {sec: -1, nsec: 0}}", "must be {sec: whole number, nsec: whole number}, both >= 0"),
    "flag": ("/a: {avoid_ros_namespace_conventions: 1}", "must be true or false"),
    "no map": ("- /a", "must be topics with their policies"),
    "no policies": ("/a: 5", "must be topics with their policies"),
    "alias": ("/a: &x {depth: 1}\n/b: *x", "has an alias"),
    "no YAML": ("{", "is not a YAML file"),
}


@pytest.mark.parametrize(("text", "words"), BAD.values(), ids=BAD)
def test_a_bad_file_is_one_line(file, text, words):
    path = file(text)
    with pytest.raises(DiffbotError) as error:
        read_overrides(path)
    assert str(error.value).startswith(str(path))
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file_is_one_line(tmp_path):
    with pytest.raises(DiffbotError, match=r"cannot open .*none.yaml: No such file"):
        read_overrides(tmp_path / "none.yaml")
