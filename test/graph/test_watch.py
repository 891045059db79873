"""`diffbot watch` with a simulated robot and a browser: goals, services and everything that the map shows."""

import math
import pathlib
import signal
import stat

import browser
import graph
import one_process
import pytest
import watch_page
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
from robot import LATCHED, planar, pose_stamped
from sensor_msgs.msg import PointCloud2, PointField

from diffbot_control.ros.messages.landmark_cloud import LandmarkPoint, fill_landmark_points
from diffbot_tools.watch.watch_node import WatchNode

START = -2.0, -5.5


@pytest.fixture(scope="module")
def robot():
    with graph.diffbot("run", "robot", "--with", "plant") as running:
        yield running


@pytest.fixture(scope="module")
def url(robot):
    with graph.diffbot("watch", "--port", "0") as running:
        running.wait_for_output("Page: ")
        yield watch_page.url_of(running)
        assert running.stop(signal.SIGINT) == 0


@pytest.fixture(scope="module")
def new_page():
    with browser.chromium() as make:
        yield make


@pytest.fixture(scope="module")
def page(new_page, url):
    opened = new_page().open(url)
    opened.wait("diffbotPage.robot.curves.estimate?.rows > 3 && diffbotPage.robot.curves.truth", "the robot")
    # Parts of the page that appear later would move the map under the pointer.
    opened.wait("document.querySelectorAll('#legend label').length === 5", "the legend")
    opened.wait("document.querySelector('#tools [title^=Reset]').offsetWidth", "the buttons of the plant")
    opened.wait("document.querySelectorAll('#values div').length === 9", "the values")
    opened.next_frame()
    return opened


@pytest.fixture(scope="module")
def peer():
    with graph.peer("watcher") as running:
        running.statuses = running.subscribe(DiagnosticStatus, "controller/status", LATCHED)
        running.truth = running.subscribe(Odometry, "ground_truth")
        running.spin_until(lambda: running.statuses and running.truth, what="the robot")
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


def place(peer):
    return planar(peer.truth[-1].pose.pose)


def press(page, key):
    page.tab.locator("#map").focus()
    page.tab.keyboard.press(key)


def look_at(page, x, y):
    page.get(f"Object.assign(diffbotPage.view, {{ x: {x}, y: {y}, scale: 120, follow: false, isMoved: true }})")


def test_a_drag_on_the_map_sends_a_goal_and_the_robot_arrives(page, peer):
    look_at(page, -1.5, -5)
    press(page, "g")
    # The canvas moves down while lines above it fill.
    page.wait("document.querySelectorAll('#diagnostics tbody tr').length >= 3", "the diagnostics")
    page.wait("document.getElementById('state').textContent !== ''", "the state")
    # 0.8 m ahead of the start; the heading is drawn 80 pixels long.
    goal = -1.31, -5.1, 0.6
    start = page.get(f"diffbotPage.view.toScreen({goal[0]}, {goal[1]})")
    page.drag(start, (start[0] + 80 * math.cos(goal[2]), start[1] - 80 * math.sin(goal[2])))
    peer.spin_until(lambda: newest_goal(peer), what="the goal")
    assert newest_goal(peer) == pytest.approx(goal, abs=0.02)
    peer.spin_until(lambda: peer.statuses[-1].message == "goal reached", what="the arrival")
    page.wait_for_message("goal reached")
    assert place(peer) == pytest.approx(goal, abs=0.1)
    # After sending, a drag moves the map again.
    assert page.get("diffbotPage.tools.current") == "pan"
    page.wait("document.getElementById('state').textContent.startsWith('holding, ')", "the state")

    def shows_a_true_pose():
        # The robot still turns to hold its heading, and the newest pose may arrive here or there first.
        shown = page.get("(() => { const c = diffbotPage.robot.curves.truth; return c.poseAt(c.t[c.rows - 1]); })()")
        newest = (planar(one.pose.pose) for one in peer.truth[-50:])
        return any((shown["x"], shown["y"], shown["theta"]) == pytest.approx(pose, abs=1e-5) for pose in newest)

    peer.spin_until(shows_a_true_pose, what="a newest true pose on the page")
    events = page.tab.locator("#events button")
    for text in ("controller: driving", "goal reached"):
        page.wait_for(lambda text=text: events.filter(has_text=text).count(), f"the event {text!r}")
    # Until the controller has answered, the page has the limits of the preset, which does not know the wheels.
    assert page.wait("diffbotPage.robot.constants.wheels", "the wheels") == [0.05, 0.6]
    assert page.get("diffbotPage.robot.constants.limits") == {"v": 1.3, "omega": 2.6, "rim": pytest.approx(1.3)}


def test_a_goal_from_the_form_is_sent_corrected_and_cancelled(page, peer):
    # A goal so far away that the robot does not arrive before the test has cancelled it.
    form = page.tab.locator("#pose-form")
    for name, value in (("x", "25"), ("y", "-3"), ("heading", "90")):
        form.locator(f"input[name={name}]").fill(value)
    form.locator("input[name=heading]").press("Enter")
    peer.spin_until(lambda: (newest_goal(peer) or (0.0,))[0] == 25, what="the goal")
    assert newest_goal(peer) == pytest.approx((25.0, -3.0, math.pi / 2), abs=1e-4)
    page.wait("diffbotPage.robot.goals.at(-1)?.[1] === 25", "the goal on the page")
    number = page.get("diffbotPage.robot.goals.length")
    updates = peer.publisher(PoseStamped, "goal_update")
    peer.wait_for_subscribers(updates)

    def is_corrected():
        updates.publish(pose_stamped(25.125, -3.0, math.pi / 2))  # again and again: it is received best effort
        return page.get("diffbotPage.robot.goals.at(-1)[1] === 25.125")

    page.wait_for(is_corrected, "the corrected goal")
    assert page.get("diffbotPage.robot.goals.length") == number
    press(page, "c")
    peer.spin_until(lambda: newest_goal(peer) is None, what="the cancellation")
    peer.spin_until(lambda: peer.statuses[-1].message == "idle", what="rest")
    form.locator("input[name=x]").fill("1,5")
    form.locator("button[value=goal]").click()
    page.wait_for_message("x = '1,5': must be a number with a decimal point")
    assert newest_goal(peer) is None


def test_the_page_pauses_and_resets_the_plant_and_sets_the_initial_pose(page, peer):
    for is_paused in ("true", "false"):
        press(page, "p")
        button = "document.querySelector('[title^=Pause]').getAttribute('aria-pressed')"
        page.wait(f"{button} === '{is_paused}'", f"paused: {is_paused}")
        assert page.text("[title^=Pause]") == ("Resume" if is_paused == "true" else "Pause")
        page.wait(f"(document.getElementById('state').textContent === 'paused') === {is_paused}", "the state")
    # The true pose at rest and not of the previous test: receive more poses than the queues hold.
    peer.truth.clear()
    peer.spin_until(lambda: len(peer.truth) > 12, what="true poses")
    before = place(peer)

    def asks_again():
        press(page, "x")
        return page.text("[title^=Reset]") == "Reset: press again"

    # After three seconds the button forgets that it was pressed.
    page.wait_for(asks_again, "the question")
    peer.spin_for(0.3)
    assert place(peer) == pytest.approx(before, abs=0.05)
    page.wait_for(lambda: press(page, "x") or page.get("messages.some((one) => one.includes('reset: '))"), "reset")
    page.wait_for_message("reset: ")
    peer.spin_until(lambda: math.dist(place(peer)[:2], START) < 0.01, what="reset")
    press(page, "i")
    look_at(page, *START)
    start = page.get("diffbotPage.view.toScreen(-2.2, -5.5)")
    page.drag(start, (start[0] + 60, start[1]))
    page.wait_for_message("initial pose set")


def test_landmarks_path_dock_and_the_phase_of_a_docking_appear(page, peer):
    clouds, paths = peer.publisher(PointCloud2, "landmarks"), peer.publisher(Path, "path")
    poses = peer.publisher(PoseWithCovarianceStamped, "dock/pose")
    detections = peer.publisher(PoseStamped, "detected_dock_pose")
    statuses = peer.publisher(DiagnosticStatus, "dock_controller/status", LATCHED)
    peer.wait_for_subscribers(clouds, poses, detections, statuses)
    peer.wait_for_subscribers(paths, count=2)
    peer.spin_until(lambda: peer.statuses[-1].message == "idle", what="rest")
    cloud, in_dock = PointCloud2(), PoseWithCovarianceStamped(pose=PoseWithCovariance(pose=pose_stamped(0, 0, 0).pose))
    in_dock.pose.covariance[[0, 7, 35]] = 1e-4
    detection = pose_stamped(20.0, 5.0, 0.5, frame="base_link")
    cloud.header.frame_id = "base_link"
    cloud.header.stamp = in_dock.header.stamp = detection.header.stamp = peer.truth[-1].header.stamp
    fill_landmark_points(cloud, [LandmarkPoint(31, 2.0, 0.5, 0.01, 0.001)], PointField)

    def shows_all():
        clouds.publish(cloud)  # best effort: a message may be lost
        poses.publish(in_dock)
        detections.publish(detection)
        shown = "diffbotPage.robot.dock?.pose && diffbotPage.robot.dock.detections.length"
        return page.get(f"diffbotPage.robot.landmarks.size && {shown}")

    page.wait_for(shows_all, "landmark and dock")
    assert page.get("[...diffbotPage.robot.landmarks.values()].map((one) => one.number)") == [31]

    values = [KeyValue(key="goal", value="0 0 0"), KeyValue(key="phase", value="approaching")]
    statuses.publish(DiagnosticStatus(name="/dock_controller", message="driving", values=values))
    page.wait("document.getElementById('state').textContent === 'docking: approaching'", "the phase")
    statuses.publish(DiagnosticStatus(name="/dock_controller", message="idle"))
    page.wait("!document.getElementById('state').textContent.startsWith('docking')", "the end of the docking")

    page.wait("!diffbotPage.robot.planAt(1e9).length", "no path")
    x, y, _ = place(peer)
    corners = [[x + 2.0, y], [x + 2.0, y + 2.0]]
    path = Path(poses=[pose_stamped(*corner, 0.5) for corner in corners])
    path.header.frame_id = "map"
    paths.publish(path)
    page.wait("diffbotPage.robot.planAt(1e9).length === 2", "the path")
    assert page.get("diffbotPage.robot.planAt(1e9)") == [pytest.approx(corner) for corner in corners]
    press(page, "c")
    page.wait("!diffbotPage.robot.planAt(1e9).length", "the end of the path")


def test_the_page_reports_when_the_robot_is_silent(page, robot):
    silent = "document.getElementById('state').textContent === 'no status from the controller'"
    page.wait(f"!({silent})", "a status")
    robot.send(signal.SIGSTOP)
    try:
        page.wait(silent, "the silence")
        assert page.get("document.getElementById('state').dataset.level") == "2"
        page.wait("document.querySelectorAll('#diagnostics .bad').length >= 3", "the missing diagnoses")
    finally:
        robot.send(signal.SIGCONT)
    page.wait("document.getElementById('state').dataset.level === '0'", "the status")
    page.wait("document.querySelectorAll('#diagnostics .bad').length === 0", "the diagnoses")


def test_a_browser_is_opened_without_the_token_on_its_command_line(url, tmp_path, monkeypatch):
    """All users of the machine can read command lines."""
    opened = []
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr("webbrowser.open", opened.append)
    with one_process.nodes() as nodes:
        node = nodes.add(WatchNode, {"port": 0, "open_browser": True})
        (address,) = graph.wait_for(lambda: opened, what="the browser")
        assert node.server.url.partition("token=")[2] not in address
        file = pathlib.Path(address.removeprefix("file://"))
        assert f'content="0; url={node.server.url}"' in file.read_text()
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
        node.before_shutdown()
        (client,) = node._robot_clients.values()
        # With a context of their own, their end could hang while other nodes are being discovered.
        assert client._client.context is client._dock_client.context is node.context
    assert not file.exists()
