"""The robot description beside the defaults of the nodes."""

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from diffbot_core.kinematics import WheelGeometry
from diffbot_sim.parameters import PlantNodeConfig

ROOT = Path(__file__).resolve().parents[2]
URDF = ET.parse(ROOT / "urdf" / "diffbot.urdf").getroot()


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
