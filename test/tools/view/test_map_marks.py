"""Positions on the map: landmarks, planned paths, dock and odometry, from a bag and from a running robot."""

import math

import numpy as np
import pytest
import view_bags

from diffbot_core.geometry import Pose, into_frame
from diffbot_tools.view.bag_source import BagRobot, read_bag
from diffbot_tools.view.model import RobotModel
from diffbot_tools.view.report_command import write_report
from diffbot_tools.view.track import PageClock

BEGIN = view_bags.BEGIN
TREE, POST = (2.0, 0.5), (-1.5, 5.0)
"""True places of the landmarks 7 and 40."""
CORNERS = ((0.0, 0.0), (1.5, 0.5), (1.5, 1.5))
LANDMARK, PLAN = (26, 28, 30), (168, 68, 127)
"""Colours of the light style."""


def measured(place, time):
    """Return the position of a place in the frame of the robot on the circle at a time [s]."""
    angle = view_bags.SPEED * time
    offset = complex(*place) - complex(math.cos(angle), math.sin(angle))
    turned = offset * complex(0.0, -1.0) * complex(math.cos(angle), -math.sin(angle))
    return turned.real, turned.imag


def marked_drive():
    """Yield a drive with a path, and with landmarks at 5 Hz: the tree always, the post before 2 s and after 6 s."""
    yield from view_bags.drive(500, error=(0.0, 0.0, 0.0))
    for step in range(48):
        time = 0.2 * step + 0.007
        stamp = BEGIN + step * 200_000_000 + 7_000_000
        points = [(7, *measured(TREE, time))]
        if time < 2.0 or time > 6.0:
            points.append((40, *measured(POST, time)))
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
    return view_bags.write(tmp_path_factory.mktemp("marks") / "bag", sorted(marked_drive(), key=lambda one: one[1]))


@pytest.fixture(scope="module")
def run(bag):
    return read_bag(bag)


@pytest.fixture(scope="module")
def page(bag, new_page, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_report(bag, path, "tuned")
    return new_page().open(path.as_uri())


def test_landmarks_are_placed_by_the_estimate_at_their_stamp_and_in_view_while_they_are_measured(run):
    tree, post = run.robots[0].landmarks()
    assert (tree[0], post[0]) == (7, 40)
    # An estimate that is 7 ms old would be off by 3.5 mm.
    assert tree[1:3] == pytest.approx(TREE, abs=1e-4)
    assert post[1:3] == pytest.approx(POST, abs=1e-4)
    # In view until two periods after the last measurement.
    assert tree[3] == pytest.approx([0.007, 9.407 + 0.4], abs=1e-3)
    assert post[3] == pytest.approx([0.007, 1.807 + 0.4, 6.007, 9.407 + 0.4], abs=1e-3)


def test_the_planned_path_ends_when_the_controller_has_no_waypoint(run):
    plan = run.robots[0].plan
    assert plan["t"].tolist() == pytest.approx([1.0, 1.0, 1.0, 4.0])
    assert np.column_stack((plan["x"], plan["y"]))[:3].tolist() == [list(corner) for corner in CORNERS]
    assert math.isnan(plan["x"][3])
    assert run.malformed == 3, "a cloud and a path in other frames, and a point that is not finite"


def drawn(page, time, colour):
    page.get(f"diffbotPage.player.go({time})")
    page.next_frame()
    return page.count(colour)


@pytest.mark.graph
def test_the_page_draws_the_planned_path_until_its_end_and_fills_landmarks_in_view(page):
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
    assert page.errors == []


class Sink:
    """Keeps the newest values and all rows of a model."""

    def __init__(self):
        self.values, self.rows = {}, {}

    def row(self, curve, values):
        self.rows.setdefault(curve, []).append(values)

    def events(self, events):
        pass

    def put(self, name, value):
        self.values[name] = value


@pytest.fixture
def live():
    """A model without a bag, and its sink."""
    kept = Sink()
    return RobotModel(PageClock(BEGIN), kept, roles=["estimate"]), kept


def content(message):
    return message[1]


def test_dock_and_detections_are_placed_by_the_estimates_at_their_stamps(live):
    model, kept = live
    dock, first, second = Pose(3.0, 1.0, 0.5), Pose(1.0, 0.0, 0.3), Pose(2.0, 0.5, -0.2)

    def detect(time, *pose):
        message = content(view_bags.goal(time, *pose))
        message.header.frame_id = "base_link"
        model.add("detections", message)

    model.add("estimate", content(view_bags.estimate(BEGIN, *first)))
    # Without an estimate at their stamp, dock and second detection wait.
    model.add("dock_pose", content(view_bags.estimate(BEGIN + 10**8, *into_frame(second, dock), sigma=0.01)))
    detect(BEGIN, *into_frame(dock, first))
    detect(BEGIN + 10**8, *into_frame(Pose(3.02, 0.97, 0.5), second))
    assert kept.values["dock"]["pose"] is None
    assert kept.values["dock"]["detections"] == [pytest.approx([3.0, 1.0])]
    model.add("estimate", content(view_bags.estimate(BEGIN + 10**8, *second)))
    found = kept.values["dock"]
    assert found["pose"] == pytest.approx([3.0, 1.0, 0.5])
    assert found["detections"] == [pytest.approx([3.0, 1.0]), pytest.approx([3.02, 0.97])]


def test_the_dock_of_a_bag_has_the_recorded_distance_and_direction():
    recorded = {"/r1/dock_controller": {"staging_distance": 0.5, "dock_backward": True, "law": "docking"}}
    robot = BagRobot("/r1", {}, PageClock(BEGIN), recorded)
    robot.model.add("estimate", content(view_bags.estimate(BEGIN, 1.0, 0.0, 0.0)))
    robot.model.add("dock_pose", content(view_bags.estimate(BEGIN, -1.0, 0.0, 0.0, sigma=0.01)))
    assert (robot.dock["pose"], robot.dock["staging"], robot.dock["isBackward"]) == ([2.0, 0.0, 0.0], 0.5, True)


def test_odometry_begins_at_the_estimate_if_there_is_no_truth(live):
    model, kept = live
    for step in range(4):
        time = BEGIN + step * 20_000_000
        model.add("odometry", content(view_bags.odometry(time, 0.1 * step, 0.0, 0.0)))
        model.add("estimate", content(view_bags.estimate(time, 5.5 + 0.1 * step, 3.0, 0.0)))
    assert [row[1] for row in kept.rows["odometry"]] == pytest.approx([5.5 + 0.1 * step for step in range(4)])
