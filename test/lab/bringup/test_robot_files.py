"""Robot description and RViz configuration, beside the defaults and the names of the graph."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import yaml

from diffbot_control.ros.controller_parameters import ControllerNodeConfig
from diffbot_core.kinematics import WheelGeometry
from diffbot_sim.ros.parameters import PlantNodeConfig

ROOT = Path(__file__).resolve().parents[3]
URDF = ET.parse(ROOT / "urdf" / "diffbot.urdf").getroot()
RVIZ = yaml.safe_load((ROOT / "rviz" / "diffbot.rviz").read_text())["Visualization Manager"]
PAGE = ROOT / "docs/reference/nodes/index.md"
WITH_TOPIC = [one for one in [*RVIZ["Displays"], *RVIZ["Tools"]] if "Topic" in one]
MESSAGE_OF_DISPLAY = {
    "Pose": "geometry_msgs/PoseStamped",
    "PoseWithCovariance": "geometry_msgs/PoseWithCovarianceStamped",
    "Odometry": "nav_msgs/Odometry",
    "Path": "nav_msgs/Path",
    "PointCloud2": "sensor_msgs/PointCloud2",
    "SetGoal": "geometry_msgs/PoseStamped",
    "SetInitialPose": "geometry_msgs/PoseWithCovarianceStamped",
}
"""What each display of rviz_default_plugins subscribes to, and each tool publishes."""


def topics_of_the_graph():
    """Return the types of the page of topics by topic."""
    rows = re.findall(r"^\| ([\w/, ]+) \| (\w+/\w+)", PAGE.read_text(), re.MULTILINE)
    return {topic.strip(): kind for topics, kind in rows for topic in topics.split(",")}


def numbers(text):
    return [float(word) for word in text.split()]


@pytest.mark.parametrize(("side", "sign"), [("left", 1), ("right", -1)])
def test_wheels_have_radius_and_separation_of_the_defaults(side, sign):
    wheels, plant = WheelGeometry(), PlantNodeConfig()
    joint = URDF.find(f"joint[@name='{getattr(plant, f'{side}_wheel_name')}']")
    assert joint.get("type") == "continuous"
    assert joint.find("parent").get("link") == plant.base_link_frame
    # base_link lies on the ground: the wheels touch it and turn forward about +y.
    assert numbers(joint.find("origin").get("xyz")) == [0.0, sign * wheels.wheel_separation / 2, wheels.wheel_radius]
    assert numbers(joint.find("axis").get("xyz")) == [0.0, 1.0, 0.0]
    link = URDF.find(f"link[@name='{joint.find('child').get('link')}']")
    assert {float(shape.get("radius")) for shape in link.iter("cylinder")} == {wheels.wheel_radius}


def test_description_is_one_tree_from_base_link():
    links = {link.get("name") for link in URDF.findall("link")}
    parent = {joint.find("child").get("link"): joint.find("parent").get("link") for joint in URDF.findall("joint")}
    assert len(parent) == len(URDF.findall("joint"))
    assert links - set(parent) == {PlantNodeConfig().base_link_frame}
    assert set(parent.values()) <= links


def test_inertias_are_those_of_the_shapes():
    # Of a box about its centre: m/12 (b^2 + c^2); of a wheel about y: m r^2 / 2, about x: m (3 r^2 + h^2) / 12.
    box, wheel = URDF.find("link[@name='chassis']"), URDF.find("link[@name='left_wheel']")
    m, (a, b, c) = (
        float(box.find("inertial/mass").get("value")),
        numbers(box.find("collision/geometry/box").get("size")),
    )
    inertia = {name: float(value) for name, value in box.find("inertial/inertia").attrib.items()}
    expected = [m / 12 * (b * b + c * c), m / 12 * (a * a + c * c), m / 12 * (a * a + b * b)]
    assert [inertia[name] for name in ("ixx", "iyy", "izz")] == pytest.approx(expected, rel=1e-3)
    cylinder, m = wheel.find("collision/geometry/cylinder"), float(wheel.find("inertial/mass").get("value"))
    r, h = float(cylinder.get("radius")), float(cylinder.get("length"))
    inertia = {name: float(value) for name, value in wheel.find("inertial/inertia").attrib.items()}
    expected = [m / 12 * (3 * r * r + h * h), m * r * r / 2, m / 12 * (3 * r * r + h * h)]
    assert [inertia[name] for name in ("ixx", "iyy", "izz")] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    "shown",
    [one for one in [*RVIZ["Displays"], *RVIZ["Tools"]] if "Topic" in one],
    ids=lambda one: one["Topic"]["Value"],
)
def test_rviz_uses_topics_of_the_graph_by_their_relative_names(shown):
    kind = shown["Class"].removeprefix("rviz_default_plugins/")
    assert topics_of_the_graph()[shown["Topic"]["Value"]] == MESSAGE_OF_DISPLAY[kind]


def test_rviz_shows_what_a_drive_needs():
    shown = {one["Topic"]["Value"] for one in RVIZ["Displays"] if "Topic" in one and one["Enabled"]}
    assert shown >= {"pose", "odometry/filtered", "goal_pose", "path", "landmarks"}
    assert {one["Topic"]["Value"] for one in RVIZ["Tools"] if "Topic" in one} == {"goal_pose", "initialpose"}
    (path,) = (one for one in RVIZ["Displays"] if one.get("Topic", {}).get("Value") == "odometry/filtered")
    assert path["Keep"] > 100
    assert {one["Class"].rpartition("/")[2] for one in RVIZ["Displays"]} >= {"TF", "RobotModel"}
    assert RVIZ["Global Options"]["Fixed Frame"] == ControllerNodeConfig().map_frame
