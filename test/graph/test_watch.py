"""`diffbot watch` with a simulated robot and a real browser: the goal that is drawn is sent, and the robot arrives."""

import contextlib
import math
import signal
import sys

import browser
import graph
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
from robot import pose_stamped
from sensor_msgs.msg import PointCloud2, PointField

from diffbot_bag.reader import BagReader
from diffbot_control.ros.landmark_cloud import LandmarkPoint, fill_landmark_points
from diffbot_core.errors import DiffbotError
from diffbot_core.ros.node import LATCHED

DIFFBOT = (sys.executable, "-m", "diffbot_lab.cli")


@pytest.fixture(scope="module")
def robot():
    with graph.process(*DIFFBOT, "run", "robot", "--with", "plant") as running:
        yield running


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    return tmp_path_factory.mktemp("recorded") / "bags"


@pytest.fixture(scope="module")
def url(robot, bags):
    with graph.process(*DIFFBOT, "watch", "--port", "0", "--record", str(bags)) as running:
        running.wait_for_output("Page: ")
        yield next(line.split()[-1] for line in running.output.splitlines() if line.startswith("Page: "))
        assert running.stop(signal.SIGINT) == 0


@pytest.fixture(scope="module")
def new_page():
    with browser.chromium() as make:
        yield make


@pytest.fixture(scope="module")
def page(new_page, url):
    opened = new_page().open(url)
    opened.wait("diffbotPage.robot.curves.estimate?.rows > 3 && diffbotPage.robot.curves.truth", "the robot")
    return opened


@pytest.fixture(scope="module")
def peer():
    with graph.peer("watcher") as running:
        running.statuses = running.subscribe(DiagnosticStatus, "controller/status", LATCHED)
        running.truth = running.subscribe(Odometry, "ground_truth")
        running.wait_for_publishers("controller/status", "ground_truth")
        yield running


@pytest.fixture(autouse=True)
def clean(page, url):
    """After each test: no error in the console, and no request but to the server of the page."""
    yield
    assert page.errors == []
    server = url.split("/")[2]
    assert {request.split("/")[2] for request in page.requests} == {server}


def newest_goal(peer):
    values = graph.values(peer.statuses[-1]) if peer.statuses else {}
    return tuple(map(float, values["goal"].split())) if "goal" in values else None


def place(message):
    position, q = message.pose.pose.position, message.pose.pose.orientation
    return position.x, position.y, 2.0 * math.atan2(q.z, q.w)


def test_a_drag_sends_the_goal_that_is_drawn_and_the_robot_arrives(page, peer):
    page.get("Object.assign(diffbotPage.view, { x: -1.5, y: -5, scale: 120, follow: false })")
    page.tab.locator("#map").focus()
    page.tab.keyboard.press("g")
    # 0.8 m ahead of the start; the heading is drawn 80 pixels long.
    goal = -1.31, -5.1, 0.6
    start = page.get(f"diffbotPage.view.toScreen({goal[0]}, {goal[1]})")
    end = start[0] + 80 * math.cos(goal[2]), start[1] - 80 * math.sin(goal[2])
    page.drag(start, end)
    peer.spin_until(lambda: newest_goal(peer), 15.0, "the goal")
    x, y, theta = newest_goal(peer)
    assert math.hypot(x - goal[0], y - goal[1]) <= 0.02
    assert abs(theta - goal[2]) <= 0.02
    page.wait_for_message("goal accepted")
    peer.spin_until(lambda: peer.statuses[-1].message == "goal reached", 30.0, "the arrival")
    page.wait_for_message("goal reached")
    x, y, theta = place(peer.truth[-1])
    assert math.hypot(x - goal[0], y - goal[1]) <= 0.1
    assert abs(theta - goal[2]) <= 0.1
    # After sending, a drag moves the map again.
    assert page.get("diffbotPage.tools.current") == "pan"
    assert page.text("#state") == "goal reached"


def test_the_page_shows_what_the_robot_publishes(page, peer):
    peer.truth.clear()
    peer.spin_until(lambda: peer.truth, what="the truth")
    shown = page.get("(() => { const c = diffbotPage.robot.curves.truth; return c.poseAt(c.t[c.rows - 1]); })()")
    x, y, theta = place(peer.truth[-1])
    assert (shown["x"], shown["y"], shown["theta"]) == pytest.approx((x, y, theta), abs=0.02)
    page.next_frame()
    assert page.count((0, 114, 178)) > 50
    events = page.tab.locator("#events button")
    for text in ("controller: driving", "goal reached"):
        page.wait_for(lambda text=text: events.filter(has_text=text).count(), f"the event {text!r}")
    page.wait("document.querySelectorAll('#diagnostics tbody tr').length >= 3", "the diagnostics")
    limits = page.wait("diffbotPage.constants.limits.v && diffbotPage.constants.limits", "the limits")
    assert limits == {"v": 1.3, "omega": 2.6}


def test_a_goal_by_keyboard_and_its_cancellation(page, peer):
    form = page.tab.locator("#pose-form")
    for name, value in (("x", "2.5"), ("y", "-3"), ("heading", "90")):
        form.locator(f"input[name={name}]").fill(value)
    form.locator("input[name=heading]").press("Enter")
    peer.spin_until(lambda: (newest_goal(peer) or (0.0,))[0] == 2.5, 15.0, "the goal")
    assert newest_goal(peer) == pytest.approx((2.5, -3.0, math.pi / 2), abs=1e-4)
    page.tab.locator("#map").focus()
    page.tab.keyboard.press("c")
    peer.spin_until(lambda: newest_goal(peer) is None, 15.0, "the cancellation")
    peer.spin_until(lambda: peer.statuses[-1].message == "idle", 15.0, "rest")
    form.locator("input[name=x]").fill("far")
    form.locator("button[value=goal]").click()
    page.wait_for_message("must be numbers")


def test_initial_pose_reset_and_pause(page, peer):
    page.tab.locator("#map").focus()
    page.tab.keyboard.press("p")
    page.wait("document.querySelector('[title^=Pause]').getAttribute('aria-pressed') === 'true'", "the pause")
    page.tab.keyboard.press("p")
    page.wait(
        "document.querySelector('[title^=Pause]').getAttribute('aria-pressed') === 'false'", "the end of the pause"
    )
    page.tab.keyboard.press("x")
    page.wait_for_message("reset: ")
    peer.spin_until(
        lambda: math.hypot(place(peer.truth[-1])[0] + 2.0, place(peer.truth[-1])[1] + 5.5) < 0.01, 10.0, "reset"
    )
    page.tab.keyboard.press("i")
    page.get("Object.assign(diffbotPage.view, { x: -2, y: -5.5, scale: 120, follow: false })")
    start = page.get("diffbotPage.view.toScreen(-2.2, -5.5)")
    page.drag(start, (start[0] + 60, start[1]))
    page.wait_for_message("initial pose set")


def placed_by(pose, x, y):
    """Return where a point in the frame of the robot is in the map."""
    px, py, theta = place(pose)
    point = complex(px, py) + complex(x, y) * complex(math.cos(theta), math.sin(theta))
    return point.real, point.imag


def test_landmarks_and_planned_path_appear_on_the_map(page, peer):
    estimates = peer.subscribe(PoseWithCovarianceStamped, "pose")
    clouds, paths = peer.publisher(PointCloud2, "landmarks"), peer.publisher(Path, "path")
    peer.wait_for_subscribers(clouds)
    peer.wait_for_subscribers(paths, count=2)
    peer.spin_until(lambda: len(estimates) > 5, what="estimates")
    cloud = PointCloud2(header=estimates[-2].header)
    cloud.header.frame_id = "base_link"
    points = [LandmarkPoint(31, 2.0, 0.5, 0.01, 0.001), LandmarkPoint(32, 3.0, -1.0, math.inf, 0.001)]
    fill_landmark_points(cloud, points, PointField)

    def shows_landmark():
        clouds.publish(cloud)  # best effort: one may be lost
        return page.get("diffbotPage.robot.landmarks.size")

    page.wait_for(shows_landmark, "a landmark")
    # 32 has no range: it is somewhere on a ray.
    ((number, x, y),) = page.get("[...diffbotPage.robot.landmarks.values()].map(({number, x, y}) => [number, x, y])")
    expected = placed_by(estimates[-2], 2.0 * math.cos(0.5), 2.0 * math.sin(0.5))
    assert number == 31
    assert (x, y) == pytest.approx(expected, abs=1e-5)
    page.wait("!diffbotPage.robot.planAt(1e9).length", "no path yet")
    start = place(estimates[-1])
    corners = [[start[0] + 2.0, start[1]], [start[0] + 2.0, start[1] + 2.0]]
    path = Path(poses=[pose_stamped(*corner, 0.5) for corner in corners])
    path.header.frame_id = "map"
    paths.publish(path)
    page.wait("diffbotPage.robot.planAt(1e9).length === 2", "the path")
    assert page.get("diffbotPage.robot.planAt(1e9)") == [pytest.approx(corner) for corner in corners]
    peer.spin_until(lambda: "waypoint" in graph.values(peer.statuses[-1]), 15.0, "the drive along the path")
    page.tab.locator("#map").focus()
    page.tab.keyboard.press("c")
    page.wait("!diffbotPage.robot.planAt(1e9).length", "the end of the path")


def test_the_page_tells_when_the_robot_stops_reporting(page, robot):
    assert page.text("#state") != "no status from the controller"
    robot.send(signal.SIGSTOP)
    try:
        page.wait("document.getElementById('state').textContent === 'no status from the controller'", "the silence")
        assert page.get("document.getElementById('state').dataset.level") == "2"
        page.wait("document.querySelectorAll('#diagnostics .bad').length >= 3", "the missing diagnoses")
    finally:
        robot.send(signal.SIGCONT)
    page.wait("document.getElementById('state').dataset.level === '0'", "the status")
    page.wait("document.querySelectorAll('#diagnostics .bad').length === 0", "the diagnoses")


def test_the_record_button_writes_a_bag(page, bags):
    button = page.tab.locator("[title^=Record]")
    button.click()
    page.wait_for_message("recording to")
    graph.wait_for(lambda: list(bags.glob("*/*.mcap")), 15.0, "the bag")

    def recorded():
        # Until the first flush, the file is empty.
        with contextlib.suppress(DiffbotError), BagReader(next(bags.iterdir())) as reader:
            return "/pose" in reader.topics and reader.topics["/pose"].message_count > 3

    # The recorder discovers topics at its polling interval, and the file grows by what is flushed.
    graph.wait_for(recorded, 20.0, "messages")
    button.click()
    page.wait_for_message("recorded /")
    (bag,) = bags.iterdir()
    with BagReader(bag) as reader:
        assert reader.topics["/pose"].message_count > 3


def test_a_second_page_sees_the_path_so_far_and_fits_a_phone(new_page, url, page):
    phone = new_page(browser.NARROW, "dark").open(url)
    phone.wait("diffbotPage.robot.curves.estimate?.rows > 20", "the history")
    assert phone.get("document.documentElement.scrollWidth") == 390
    assert phone.errors == []
    phone.tab.close()


def test_a_port_in_use_is_one_line(url):
    port = url.split("/")[2].split(":")[1]
    with graph.process(*DIFFBOT, "watch", "--port", port) as second:
        assert second.wait(30.0) == 1
        lines = [line for line in second.output.splitlines() if "cannot listen" in line]
        assert len(lines) == 1
        assert f"port {port}" in lines[0]
        assert "Traceback" not in second.output
