"""Robot description and RViz configuration, beside the defaults and the topics that the nodes have."""

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import yaml

from diffbot_control.ros.parameters.controller import ControllerNodeConfig
from diffbot_core.kinematics import WheelGeometry
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


def test_rviz_uses_topics_of_the_nodes_by_their_relative_names_in_the_frame_of_the_map():
    topics = {one.text for one in ET.parse(ROOT / "config" / "sros2_policy.xml").iter("topic")}
    displays, tools = (
        {one["Topic"]["Value"] for one in RVIZ[kind] if "Topic" in one} for kind in ("Displays", "Tools")
    )
    assert displays - topics <= {"path", "landmarks"}, "others send these"
    assert tools == {"goal_pose", "initialpose"}
    assert tools <= topics
    assert RVIZ["Global Options"]["Fixed Frame"] == ControllerNodeConfig().map_frame
