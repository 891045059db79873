"""Landmarks and planned paths on the map: of a bag, on the page, and of a running robot."""

import math

import numpy as np
import pytest
import view_bags

from diffbot_core.geometry import Pose, into_frame
from diffbot_core.uncertainty import Uncertainty
from diffbot_tools.view.landmarks import read_cloud
from diffbot_tools.view.live_dock import DockPlacer
from diffbot_tools.view.live_landmarks import LandmarkPlacer
from diffbot_tools.view.report import read_bag_run
from diffbot_tools.view.report_command import write_report

BEGIN = view_bags.BEGIN
TREE, POST = (2.0, 0.5), (-1.5, 5.0)
"""True places of the landmarks 7 and 40."""
CORNERS = ((0.0, 0.0), (1.5, 0.5), (1.5, 1.5))
LANDMARK, PLAN = (26, 28, 30), (168, 68, 127)
"""Colours of the light style."""


def seen(place, time):
    """Return where a robot on the circle sees a place at a time [s], in its own frame."""
    angle = view_bags.SPEED * time
    offset = complex(*place) - complex(math.cos(angle), math.sin(angle))
    turned = offset * complex(0.0, -1.0) * complex(math.cos(angle), -math.sin(angle))
    return turned.real, turned.imag


def marked_drive():
    """Yield a drive with landmarks at 5 Hz between two estimates: the post until 2 s and from 6 s; and with paths."""
    yield from view_bags.drive(500, error=(0.0, 0.0, 0.0))
    for step in range(48):
        time = 0.2 * step + 0.007
        stamp = BEGIN + step * 200_000_000 + 7_000_000
        points = [(7, *seen(TREE, time))]
        if time < 2.0 or time > 6.0:
            points.append((40, *seen(POST, time)))
        yield "/landmarks", stamp, view_bags.cloud(stamp, *points, (99, 1.0, 1.0, math.nan))
    yield "/landmarks", BEGIN, view_bags.cloud(BEGIN, (1, 1.0, 0.0), frame="camera")
    yield "/landmarks", BEGIN, view_bags.cloud(BEGIN, (1, math.nan, 0.0))
    yield "/landmarks", BEGIN, view_bags.cloud(BEGIN + 10**15, (1, 1.0, 0.0))
    broken = (math.nan, 1.0), (1e300, 0.0)
    yield "/path", BEGIN + 10**9, view_bags.path(0, *CORNERS[:2], *broken, CORNERS[2])
    yield "/path", BEGIN + 2 * 10**9, view_bags.path(0, (5.0, 5.0), frame="robot/odom")
    for second, values in ((1.1, {"waypoint": "1/3"}), (2.0, {"waypoint": "2/3"}), (4.0, {}), (5.0, {})):
        status = view_bags.status("/controller", "driving", goal="1.5 1.5 0", **values)
        yield "/controller/status", BEGIN + round(second * 1e9), status


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    # The writer of rosbags keeps the order, the reader sorts by log time where it matters.
    return view_bags.write(tmp_path_factory.mktemp("marks") / "bag", sorted(marked_drive(), key=lambda one: one[1]))


@pytest.fixture(scope="module")
def run(bag):
    return read_bag_run(bag)


@pytest.fixture(scope="module")
def page(bag, new_page, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_report(bag, path, "tuned")
    return new_page().open(path.as_uri())


def test_landmarks_are_placed_by_the_estimate_of_their_own_time_and_shown_while_they_are_measured(run):
    tree, post = run.robots[0].landmarks
    assert (tree.number, post.number) == (7, 40)
    # 7 ms are 3.5 mm of the path; between two estimates the circle is taken as straight.
    assert (tree.x, tree.y) == pytest.approx(TREE, abs=1e-4)
    assert (post.x, post.y) == pytest.approx(POST, abs=1e-4)
    # In view until two periods after the last measurement.
    assert tree.in_view == pytest.approx([0.007, 9.407 + 0.4], abs=1e-3)
    assert post.in_view == pytest.approx([0.007, 1.807 + 0.4, 6.007, 9.407 + 0.4], abs=1e-3)


def test_the_path_holds_until_the_controller_leaves_it(run):
    plan = run.robots[0].plan
    assert plan["t"].tolist() == pytest.approx([1.0, 1.0, 1.0, 4.0])
    assert np.column_stack((plan["x"], plan["y"]))[:3].tolist() == [list(corner) for corner in CORNERS]
    assert math.isnan(plan["x"][3])
    assert run.tables.malformed == 3, "clouds and paths that cannot be used"


def drawn(page, time, colour):
    page.get(f"diffbotPage.player.go({time})")
    page.next_frame()
    return page.count(colour)


@pytest.mark.graph
def test_the_page_draws_the_path_while_it_holds_and_the_landmarks_in_view_and_the_near_region(page):
    left, top = page.get("diffbotPage.view.toWorld(0, 0)")
    right, bottom = page.get("diffbotPage.view.toWorld(diffbotPage.view.width, diffbotPage.view.height)")
    assert all(left < x < right and bottom < y < top for x, y in (TREE, POST, *CORNERS))
    assert page.get("diffbotPage.robot.planAt(0.9)") == []
    assert page.get("diffbotPage.robot.planAt(3.9)") == pytest.approx(np.array(CORNERS), abs=1e-5)
    assert page.get("diffbotPage.robot.planAt(4.1)") == []
    assert drawn(page, 3.9, PLAN) > 110
    assert drawn(page, 4.1, PLAN) < 20
    assert page.get("[...diffbotPage.robot.landmarks.keys()]") == [7, 40]
    page.get("Object.assign(diffbotPage.view, { x: -1.5, y: 5, scale: 60, follow: false })")
    in_view, out_of_view = drawn(page, 7.0, LANDMARK), drawn(page, 4.0, LANDMARK)
    # The inside of one diamond of 7 pixels.
    assert 40 < in_view - out_of_view < 110
    box = page.tab.locator("#legend label", has_text="landmarks").locator("input")
    box.uncheck()
    assert drawn(page, 7.0, LANDMARK) < 0.3 * out_of_view
    box.check()
    assert page.errors == []
    # The radius eps_P is 0.4 m in this bag; Omega_L holds from 5 s on.
    page.get("Object.assign(diffbotPage.view, { x: 2, y: 0.5, scale: 300, follow: false })")
    page.next_frame()
    x, y = page.get("diffbotPage.view.toScreen(2, 0.5)")
    near = {}
    for time in (4.9, 7.0):
        page.get(f"diffbotPage.player.go({time})")
        page.next_frame()
        pixel = "Array.from(document.getElementById('map').getContext('2d').getImageData({}, {}, 1, 1).data)"
        # Inside the circle of 0.4 m and outside, off the axes of the arrow and the grid.
        near[time] = [page.get(pixel.format(x + 300 * r * 0.6, y + 300 * r * 0.8)) for r in (0.36, 0.44)]
    assert near[7.0][0] != near[4.9][0]
    assert near[7.0][1] == near[4.9][1]


def cloud_of(stamp, *landmarks, frame="base_link"):
    return read_cloud(view_bags.data_of(view_bags.cloud(stamp, *landmarks, frame=frame)))


def test_a_live_cloud_waits_for_the_estimate_of_its_time():
    placer = LandmarkPlacer()
    placer.add_pose(BEGIN, Pose(0.0, 0.0, 3.0))
    placer.add_cloud(cloud_of(BEGIN + 50_000_000, (4, 1.0, 0.0), (5, 1.0, 2.0, math.inf)))
    assert placer.newest() is None
    # The heading passes pi: halfway it is 3.1, not 0.
    placer.add_pose(BEGIN + 100_000_000, Pose(2.0, 0.0, 3.2 - 2.0 * math.pi))
    stamp, found = placer.newest()
    assert stamp == BEGIN + 50_000_000
    assert found == [pytest.approx([1.0 + math.cos(3.1), math.sin(3.1), 4])]
    assert placer.newest() is None
    # A new run does not wait for the old time.
    placer.add_cloud(cloud_of(BEGIN + 10**13, (4, 1.0, 0.0)))
    for step in range(3):
        placer.add_pose(BEGIN - 10**9 + step * 10**8, Pose(float(step), 0.0, 0.0))
    placer.add_cloud(cloud_of(BEGIN - 9 * 10**8, (4, 1.0, 0.0)))
    assert placer.newest() == (BEGIN - 9 * 10**8, [pytest.approx([2.0, 0.0, 4])])


CERTAIN, LOST = Uncertainty(0.01, 0.01), Uncertainty(0.3, 0.01)
DOCK = Pose(3.0, 1.0, 0.5)


def test_dock_and_detections_are_placed_by_the_estimates_of_their_own_time():
    placer = DockPlacer()
    first, second = Pose(1.0, 0.0, 0.3), Pose(2.0, 0.5, -0.2)
    placer.add_pose(BEGIN, first)
    assert placer.newest() is None
    # Of a time without an estimate in map yet: both wait, and are not placed by the old one.
    placer.add_dock_pose(BEGIN + 10**8, into_frame(second, DOCK), CERTAIN)
    placer.add_detection(BEGIN, into_frame(DOCK, first))
    placer.add_detection(BEGIN + 10**8, into_frame(Pose(3.02, 0.97, 0.5), second))
    found = placer.newest()
    assert found["pose"] is None
    assert found["detections"] == [pytest.approx([3.0, 1.0])]
    placer.add_pose(BEGIN + 10**8, second)
    found = placer.newest()
    assert found["pose"] == pytest.approx([3.0, 1.0, 0.5])
    assert found["detections"] == [pytest.approx([3.0, 1.0]), pytest.approx([3.02, 0.97])]


def test_a_dock_that_the_filter_has_lost_or_of_an_earlier_run_is_not_shown():
    placer = DockPlacer()
    for stamp in (BEGIN, BEGIN - 10**9):
        placer.add_pose(stamp, Pose(0.0, 0.0, 0.0))
        assert placer.newest() is None
        placer.add_dock_pose(stamp, Pose(-1.0, 0.0, 0.0), CERTAIN)
        assert placer.newest()["pose"] == pytest.approx([1.0, 0.0, 0.0])
    placer.add_dock_pose(BEGIN, Pose(-1.0, 0.0, 0.0), LOST)
    assert placer.newest() is None
