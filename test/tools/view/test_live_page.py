"""The live page of two simulated states in a browser: what it shows, and which robot receives its requests."""

import time

import pytest

from diffbot_control.law.registry import PRESETS
from diffbot_tools.view.constants import constants_of
from diffbot_tools.view.live_state import LiveState
from diffbot_tools.view.server import Address, PageServer

pytestmark = pytest.mark.graph
SERVICES = {name: {"isThere": True, "isOn": False} for name in ("pause", "reset", "dock")}


class ServedPage:
    """A page server with two robots, a and b, and the received requests."""

    def __init__(self):
        self.state, self.requests, self.errors = LiveState(("a", "b")), [], []
        constants = constants_of(PRESETS["tuned"].config)
        self.server = PageServer(self.state, constants, self.on_request, self.errors.append, Address())
        self.server.start()
        self._time = 0.0
        for number, name in enumerate("ab", 1):
            self.state.put(name, "constants", constants | {"xy_tolerance": 0.1 * number})
            self.state.put(name, "services", SERVICES if name == "b" else {})

    def on_request(self, request, reply):
        self.requests.append(request)

    def move(self, name, x, y):
        self._time += 0.1
        self.state.put_row(name, "estimate", (self._time, x, y, 0.0, *[float("nan")] * 6))

    def wait_for_request(self, page):
        page.wait_for(lambda: self.requests, "a request")
        return self.requests.pop()


@pytest.fixture
def served():
    made = ServedPage()
    for name in "ab":
        made.move(name, 0.0, 0.0)
    yield made
    made.server.stop()
    assert made.errors == []


@pytest.fixture
def page(new_page, served):
    opened = new_page().open(served.server.url)
    opened.wait("diffbotPage.robots.length === 2 && diffbotPage.robots.every((one) => one.main)", "two robots")
    yield opened
    opened.tab.close()


IS_INSIDE = """(() => {{
  const [x, y] = diffbotPage.view.toScreen({}, {});
  return x > 0 && y > 0 && x < diffbotPage.view.width && y < diffbotPage.view.height;
}})()"""


def test_the_map_shows_five_metres_and_keeps_robot_and_goal_in_view_until_it_is_moved(page, served):
    assert page.get("Math.min(diffbotPage.view.width, diffbotPage.view.height) / diffbotPage.view.scale") >= 5
    served.move("a", 30.0, -4.0)
    page.wait(IS_INSIDE.format(30, -4), "the robot that has left the map")
    served.state.put("a", "goals", [[0.0, -50.0, 9.0, 0.0, None]])
    page.wait(IS_INSIDE.format(-50, 9), "the goal")
    page.tab.locator("#map").focus()
    page.tab.keyboard.press("ArrowRight")
    served.move("a", 500.0, 0.0)
    page.wait("diffbotPage.robot.main.columns.x[diffbotPage.robot.main.rows - 1] === 500", "the robot")
    page.next_frame()
    assert not page.get(IS_INSIDE.format(500, 0))


def test_a_page_that_connects_again_keeps_its_robot_with_its_limits_and_services(page, served):
    page.tab.locator("#robot").select_option("b")
    page.wait("diffbotPage.robot.constants.xy_tolerance === 0.2", "the limits of b")
    page.wait("!document.querySelector('[title^=Dock]').disabled", "the services of b")
    # The connection is aborted as by a failure of the network.
    page.errors.clear()
    for browser in list(served.server._browsers):
        served.server._loop.call_soon_threadsafe(browser.connection.transport.abort)
    page.wait("document.getElementById('alarm').textContent.startsWith('No connection')", "the failure")
    page.wait("document.getElementById('alarm').classList.contains('hidden')", "the connection")
    page.wait("diffbotPage.robot.constants.xy_tolerance === 0.2", "the limits of b again")
    assert page.tab.locator("#robot").input_value() == "b"
    form = page.tab.locator("#pose-form")
    for name in ("x", "y", "heading"):
        form.locator(f"input[name={name}]").fill("1")
    form.locator("button[value=goal]").click()
    request = served.wait_for_request(page)
    assert (request.kind, request.robot) == ("goal", "b")


def test_dock_and_undock_are_sent_to_the_robot_that_has_a_docking_controller(page, served):
    for name in ("Dock", "Undock", "Pause"):
        assert page.tab.locator(f"[title^={name}]").is_disabled(), "robot a has no services"
    page.tab.locator("#robot").select_option("b")
    for name in ("Dock", "Undock"):
        page.tab.locator(f"[title^={name}]").click()
        request = served.wait_for_request(page)
        assert (request.kind, request.robot) == (name.lower(), "b")
    served.state.put("b", "state", [time.time(), 0, "docked"])
    page.wait("document.getElementById('state').textContent === 'docked'", "the state")
    served.state.put("b", "services", SERVICES | {"pause": {"isThere": True, "isOn": True}})
    page.wait("document.querySelector('[title^=Pause]').textContent === 'Resume'", "the pause")
    page.tab.locator("#robot").select_option("a")
    assert page.text("[title^=Pause]") == "Pause"
