"""The rectangle around the boxes of a URDF: of a bag, on the page, and of hostile texts."""

import math
import time

import pytest
import view_bags
from requirements import ROOT

from diffbot_tools.view.footprint import MAX_URDF, footprint_of, read_footprint
from diffbot_tools.view.report_command import write_report

OUTLINE = """(() => {
  const map = document.getElementById("map");
  const { data, width, height } = map.getContext("2d").getImageData(0, 0, map.width, map.height);
  const places = [];
  for (let i = 0; i < data.length; i += 4) {
    const apart = Math.abs(data[i]) + Math.abs(data[i + 1] - 114) + Math.abs(data[i + 2] - 178);
    if (apart <= 60) places.push([(i / 4) % width, Math.floor(i / 4 / width)]);
  }
  const [xs, ys] = [0, 1].map((at) => places.map((place) => place[at]));
  return [height / 2 - Math.min(...ys), width / 2 - Math.min(...xs), Math.max(...xs) - width / 2];
})()"""
"""How far what has the truth's colour is above, left and right of the middle of the map [pixels]."""
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
        "<robot/>",
        "<a>" * (MAX_URDF // 3),
        '<!DOCTYPE r [<!ENTITY a "0.4 0.2 1">]>' + TURNED.replace("0.4 0.2 1", "&a;"),
        TURNED.replace("0.4 0.2 1", "nan 1 1"),
        TURNED.replace("0.4 0.2 1", "1e9 1 1"),
        TURNED.replace("0.4 0.2 1", "1 1"),
        TURNED.replace('child link="mast"', 'child link="base_link"')
        .replace("<collision>", "<other>")
        .replace("visual", "other"),
    ],
    ids=["cut off", "empty", "deep", "entity", "nan", "huge", "two numbers", "a loop without a box"],
)
def test_what_is_no_footprint(text):
    begin = time.process_time()
    assert footprint_of(text) is None
    assert time.process_time() - begin < 5.0


@pytest.mark.graph
def test_the_page_draws_the_box_of_the_bag(new_page, tmp_path):
    description = "std_msgs/msg/String", view_bags.make("std_msgs/msg/String", data=TURNED)
    assert read_footprint(view_bags.data_of(description)) is not None
    messages = [("/robot_description", view_bags.BEGIN, description), *view_bags.drive(100)]
    write_report(view_bags.write(tmp_path / "bag", messages), tmp_path / "page.html")
    page = new_page().open((tmp_path / "page.html").as_uri())
    page.get("Object.assign(diffbotPage.view, { scale: 120 }, diffbotPage.robot.curves.truth.poseAt(0))")
    page.get("['estimate', 'odometry', 'ellipses'].forEach((one) => diffbotPage.hidden.add(one))")
    page.get("diffbotPage.player.go(0)")
    page.next_frame()
    # At the start it faces y: its front, 1.3 m away, lies above the middle, and its left side to the left.
    top, left, right = page.get(OUTLINE)
    assert (top, left, right) == pytest.approx((120 * 1.3, 120 * 0.7, 120 * 0.1), abs=3)
