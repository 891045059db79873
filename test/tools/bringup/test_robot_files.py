"""Robot description and RViz configuration, beside the defaults and the topics that the nodes have."""

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import yaml

from diffbot_control.ros.parameters.controller import ControllerNodeConfig
from diffbot_core.kinematics import WheelGeometry
from diffbot_lab.security.policy import read_policy
from diffbot_sim.ros.parameters import PlantNodeConfig

ROOT = Path(__file__).resolve().parents[3]
URDF = ET.parse(ROOT / "urdf" / "diffbot.urdf").getroot()
RVIZ = yaml.safe_load((ROOT / "rviz" / "diffbot.rviz").read_text())["Visualization Manager"]


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
    a, b, c = numbers(box.find("collision/geometry/box").get("size"))
    cylinder = wheel.find("collision/geometry/cylinder")
    r, h = float(cylinder.get("radius")), float(cylinder.get("length"))
    factors = {
        box: [(b * b + c * c) / 12, (a * a + c * c) / 12, (a * a + b * b) / 12],
        wheel: [(3 * r * r + h * h) / 12, r * r / 2, (3 * r * r + h * h) / 12],
    }
    for link, expected in factors.items():
        m, inertia = float(link.find("inertial/mass").get("value")), link.find("inertial/inertia")
        found = [float(inertia.get(name)) / m for name in ("ixx", "iyy", "izz")]
        assert found == pytest.approx(expected, rel=1e-3)


def test_rviz_uses_topics_of_the_nodes_by_their_relative_names_in_the_frame_of_the_map():
    rights = [
        node for process in read_policy(ROOT / "config" / "sros2_policy.xml").values() for node in process.values()
    ]
    topics = {topic for node in rights for topic in node.publish | node.subscribe}
    displays, tools = (
        {one["Topic"]["Value"] for one in RVIZ[kind] if "Topic" in one} for kind in ("Displays", "Tools")
    )
    assert displays - topics <= {"path", "landmarks"}, "others send these"
    assert tools == {"goal_pose", "initialpose"}
    assert tools <= topics
    assert RVIZ["Global Options"]["Fixed Frame"] == ControllerNodeConfig().map_frame
