"""The rectangle around the boxes of a URDF: of the package, and of hostile texts."""

import math

import pytest
from requirements import ROOT

from diffbot_tools.view.footprint import MAX_URDF, footprint_of

BOX = "<{0}><origin xyz='{1}' rpy='{2}'/><geometry><box size='{3}'/></geometry></{0}>"
TURNED = f"""<robot name="a">
<link name="base_footprint"/><joint name="a" type="fixed"><parent link="base_footprint"/><child link="base_link"/>
<origin xyz="9 9 9"/></joint>
<link name="base_link">{BOX.format("visual", "0 0 0", "0 0 0", "9 9 9")}
{BOX.format("collision", "0.1 0 0", "0 0 0", "0.4 0.2 1")}</link>
<joint name="b" type="fixed"><parent link="base_link"/><child link="mast"/>
<origin xyz="1 0 0" rpy="0 0 {math.pi / 2}"/></joint>
<link name="mast">{BOX.format("visual", "0.5 0 0", f"{math.pi / 2} 0 {math.pi / 2}", "0.6 0.2 0.4")}</link>
<joint name="c" type="continuous"><parent link="base_link"/><child link="wheel"/></joint>
<link name="wheel">{BOX.format("visual", "0 0 0", "0 0 0", "50 50 50")}</link></robot>"""


def test_boxes_are_placed_by_fixed_joints_and_their_own_origins():
    # The mast lies across: 0.4 m along its x, which is the robot's y, about y = 0.5 m; 0.6 m wide about x = 1 m.
    assert footprint_of(TURNED) == pytest.approx((-0.1, 1.3, -0.1, 0.7))
    assert footprint_of((ROOT / "urdf" / "diffbot.urdf").read_text()) == pytest.approx((-0.2, 0.4, -0.25, 0.25))


@pytest.mark.parametrize(
    "text",
    [
        "<robot",
        "<a>" * (MAX_URDF // 3),
        '<!DOCTYPE r [<!ENTITY a "0.4 0.2 1">]>' + TURNED.replace("0.4 0.2 1", "&a;"),
        TURNED.replace("0.4 0.2 1", "nan 1 1"),
    ],
    ids=["cut off", "deep", "entity", "nan"],
)
def test_what_is_no_footprint(text):
    assert footprint_of(text) is None
