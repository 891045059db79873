"""The report in a real browser: it renders, needs nothing else, moves with the slider, and runs no script of a bag."""

import itertools
import json
import math
import re

import browser
import pytest
import view_bags

from diffbot_tools.view.page_file import page_text
from diffbot_tools.view.report_command import write_report

pytestmark = pytest.mark.graph
TRUTH, ESTIMATE = (0, 114, 178), (213, 94, 0)
"""Colours of the light style, Okabe and Ito's."""


@pytest.fixture(scope="module")
def report(circle, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(circle, path, "tuned")
    return path.as_uri()


@pytest.fixture(scope="module")
def page(new_page, report):
    return new_page().open(report)


@pytest.fixture(autouse=True)
def clean(page):
    """After each test: no error in the console, and nothing asked for but the file itself."""
    yield
    assert page.errors == []
    assert len(page.requests) == 1
    assert page.requests[0].startswith("file://")


def test_the_curves_are_those_of_the_bag_and_are_drawn(page):
    assert page.get("diffbotPage.robot.curves.truth.rows") == 500
    for step in (0, 123, 499):
        _, x, y, yaw = view_bags.at(step)
        got = page.get(f"['t', 'x', 'y', 'theta'].map((name) => diffbotPage.robot.curves.truth.columns[name][{step}])")
        assert got[:3] == pytest.approx([step / 50, x, y], abs=1e-5)
        assert math.remainder(got[3] - yaw, 2 * math.pi) == pytest.approx(0.0, abs=1e-5)
    # (0.03^2 + 0.02^2 + 0.01^2) / 0.05^2
    assert page.get("diffbotPage.robot.curves.error.at('nees', 5)") == pytest.approx(0.56, abs=2e-5)
    page.get("diffbotPage.player.go(8)")
    page.next_frame()
    assert page.count(TRUTH) > 200
    assert page.count(ESTIMATE) > 100
    assert page.tab.locator(".chart:visible").count() == 7
    for panel in ("#filter", "#law"):
        page.tab.locator(f"{panel} summary").click()
    assert page.tab.locator(".chart:visible").count() == 14
    page.next_frame()
    assert page.count(ESTIMATE, ".chart canvas >> nth=4", apart=140) > 100


def test_the_slider_moves_the_robot(page):
    slider = page.tab.locator("#slider")
    box = slider.bounding_box()
    page.tab.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.wait("Math.abs(diffbotPage.player.time - 5) < 0.2", "the middle")
    page.next_frame()
    time, pose = page.get("[diffbotPage.player.time, diffbotPage.robot.curves.truth.poseAt(diffbotPage.player.time)]")
    assert (pose["x"], pose["y"]) == pytest.approx((math.cos(0.5 * time), math.sin(0.5 * time)), abs=1e-3)
    assert f"{time:.1f} s" in page.text("#clock")
    before = page.pixels()
    slider.press("End")
    page.wait("diffbotPage.player.time === diffbotPage.player.end", "the end")
    page.next_frame()
    assert (page.pixels() != before).any()


def test_events_lead_to_their_time_and_the_table_says_how_each_goal_ended(page):
    events = page.tab.locator("#events button").all_inner_texts()
    assert any("goal 2: x 2.00 m, y 0.50 m, 14 deg" in text for text in events)
    goal, box = (page.tab.locator(place) for place in ("#events button", "#filters label"))
    goal = goal.filter(has_text="goal 2")
    goal.click()
    assert page.get("diffbotPage.player.time") == pytest.approx(5.0, abs=1e-3)
    box.filter(has_text="goal").locator("input").uncheck()
    assert not goal.is_visible()
    box.filter(has_text="goal").locator("input").check()
    assert goal.is_visible()
    rows = [row.locator("td").all_inner_texts() for row in page.tab.locator("#summary tbody tr").all()]
    assert [row[2].split(":")[0] for row in rows] == ["reached [goal_pose]", "not reached"]
    # From the true pose at the end of the second goal to that goal.
    _, x, y, _ = view_bags.at(499)
    assert float(rows[1][3]) == pytest.approx(math.hypot(x - 2.0, y - 0.5), abs=1e-4)
    assert float(rows[0][6]) == pytest.approx(2.5, abs=0.03)


def test_keys_wheel_and_drag_move_and_zoom_and_it_plays_until_the_end(page):
    page.tab.locator("#map").focus()
    page.tab.keyboard.press("0")
    x, scale = page.get("[diffbotPage.view.x, diffbotPage.view.scale]")
    page.tab.keyboard.press("ArrowRight")
    page.tab.keyboard.press("+")
    assert page.get("diffbotPage.view.x") > x
    assert page.get("diffbotPage.view.scale") == pytest.approx(1.25 * scale)
    page.tab.keyboard.press("f")
    assert page.get("diffbotPage.view.follow") is True
    page.get("diffbotPage.player.go(0); document.getElementById('speed').value = '1'")
    page.tab.keyboard.press(" ")
    assert page.get("diffbotPage.player.isPlaying") is True
    page.tab.keyboard.press(" ")
    assert page.get("diffbotPage.player.isPlaying") is False
    page.tab.locator("#speed").select_option("20")
    page.tab.locator("#play").click()
    page.wait("!diffbotPage.player.isPlaying && diffbotPage.player.time === diffbotPage.player.end", "the end")

    # A wheel zooms about the pointer, and a drag moves the map.
    page.tab.keyboard.press("0")
    point, scale = "diffbotPage.view.toWorld(200, 150)", page.get("diffbotPage.view.scale")
    before = page.get(point)
    box = page.tab.locator("#map").bounding_box()
    page.tab.mouse.move(box["x"] + 200, box["y"] + 150)
    page.tab.mouse.wheel(0, -300)
    page.wait(f"diffbotPage.view.scale > {scale}", "the zoom")
    pixel = 1.0 / page.get("diffbotPage.view.scale")
    assert page.get(point) == pytest.approx(before, abs=pixel)
    page.drag((200, 150), (240, 130))
    assert page.get("diffbotPage.view.toWorld(240, 130)") == pytest.approx(before, abs=2 * pixel)


def test_no_text_of_a_bag_runs_as_a_script_nor_would_markup(page, new_page, report):
    assert page.get("globalThis.broken") is None
    assert page.tab.locator("#events button", has_text="onerror=").count() == 1
    assert page.tab.locator("img").count() == 0
    victim = new_page().open(report)
    victim.get("document.body.insertAdjacentHTML('beforeend', '<img src=http://127.0.0.1:9/x onerror=\"broken = 1\">')")
    victim.wait_for(lambda: any("Content Security Policy" in line for line in victim.errors), "the refusal")
    assert victim.get("globalThis.broken") is None
    victim.tab.close()


@pytest.mark.parametrize(
    ("size", "scheme", "truth"), [(browser.WIDE, "light", TRUTH), (browser.NARROW, "dark", (86, 180, 233))]
)
def test_the_result_comes_first_and_nothing_is_cropped_or_overlaps(new_page, report, size, scheme, truth):
    other = new_page(size, scheme).open(report)
    other.next_frame()
    assert other.count(truth) > 100
    assert other.tab.locator("#play").bounding_box()["height"] >= (40 if size == browser.NARROW else 30)
    assert other.text("#result strong >> nth=0") == "0 of 2 goals reached"
    card, map_box = (other.tab.locator(place).bounding_box() for place in (".cards button >> nth=1", "#map"))
    assert card["y"] + card["height"] <= map_box["y"]
    assert card["y"] + card["height"] <= size[1]
    for panel in ("#filter", "#law"):
        other.tab.locator(f"{panel} summary").click()
    # Neither outside the window nor in a box that is too narrow; what scrolls, scrolls downwards only.
    cropped = """[...document.querySelectorAll("body *")].filter((one) => one.offsetParent && (
        one.getBoundingClientRect().right > innerWidth + 1 || one.scrollWidth > one.clientWidth + 1 && one.clientWidth
    )).map((one) => one.outerHTML.slice(0, 80))"""
    assert other.get(cropped) == []
    parts = ["#first > header", "#result", "#tools", "#map-box", "#legend", "#player", "#values"]
    boxes = [other.tab.locator(part).bounding_box() for part in parts]
    for above, below in itertools.pairwise(boxes):
        assert above["y"] + above["height"] <= below["y"] + 1
    assert other.errors == []
    other.tab.close()


def box_of(page, chart):
    canvas = page.tab.locator(f".chart canvas >> nth={chart}")
    canvas.scroll_into_view_if_needed()
    return canvas.bounding_box()


def test_one_cursor_in_all_charts_and_on_the_map_and_a_zoom_of_the_time(page):
    box = box_of(page, 0)
    left = 62  # of the axis
    page.tab.mouse.move(box["x"] + left + 0.25 * (box["width"] - left), box["y"] + 40)
    page.next_frame()
    assert page.get("diffbotPage.hover") == pytest.approx(2.5, abs=0.05)
    assert "cursor at 2.5" in page.text("#clock")
    lines = page.get("[...document.querySelectorAll('.chart:not(.hidden) .cursor')].map((one) => one.style.transform)")
    assert len(set(lines)) == 1
    assert float(re.search(r"[\d.]+", lines[0])[0]) == pytest.approx(left + 0.25 * (box["width"] - left), abs=2)
    # On the map, over the path: the time at which the robot was there, and the coordinates.
    page.get("diffbotPage.player.go(9.9)")
    x, y = page.get("diffbotPage.view.toScreen(Math.cos(1.5) + 0.03, Math.sin(1.5) - 0.02)")
    box = page.tab.locator("#map").bounding_box()
    page.tab.mouse.move(box["x"] + x, box["y"] + y)
    page.next_frame()
    assert page.get("diffbotPage.hover") == pytest.approx(3.0, abs=0.1)
    assert page.text("#place").startswith("x 0.1")
    page.tab.mouse.move(box["x"] + x, 2)
    page.wait("diffbotPage.hover === null", "the end of the cursor")

    # A drag zooms the time, and a double click shows all of it.
    box = box_of(page, 2)
    width = box["width"] - 62
    page.tab.mouse.move(box["x"] + 62 + 0.2 * width, box["y"] + 30)
    page.tab.mouse.down()
    page.tab.mouse.move(box["x"] + 62 + 0.6 * width, box["y"] + 30, steps=3)
    page.tab.mouse.up()
    assert page.get("diffbotPage.zoom") == pytest.approx([2.0, 6.0], abs=0.1)
    page.tab.mouse.dblclick(box["x"] + 100, box["y"] + 30)
    assert page.get("diffbotPage.zoom") is None


def test_a_link_leads_to_the_moment_and_the_view(page, new_page, report):
    page.get(
        "diffbotPage.player.go(3.25); Object.assign(diffbotPage.view, { x: 0.5, y: 1.5, scale: 99, follow: false })"
    )
    page.tab.keyboard.press("l")
    link = page.wait("location.hash.length > 1 && location.href", "the link")
    other = new_page().open(link)
    assert other.get("diffbotPage.player.time") == pytest.approx(3.25)
    assert other.get("[diffbotPage.view.x, diffbotPage.view.y, diffbotPage.view.scale]") == [0.5, 1.5, 99]
    other.tab.close()
    broken = new_page().open(f"{report}#t=x&map=1,2&zoom=9,1&robot=none")
    assert broken.get("[diffbotPage.player.time === diffbotPage.player.end, diffbotPage.zoom]") == [True, None]
    broken.tab.close()


STATES = [
    ({"text": "driving", "left": 3.2}, 0.4, "driving: 1.50 m and 14 deg to go, 3 s"),
    ({"text": "driving", "finish": "to and fro"}, 0.1, "correcting sideways, 98 cm"),
    ({"text": "driving", "isPaused": True}, 0.0, "paused"),
    ({"text": "goal reached", "isHeld": True}, 0.5, "moving after the goal was reached: 1.50 m and 14 deg to go"),
    ({"text": "stale pose", "filter": "odometry stands still"}, 0.0, "stopped: odometry stands still"),
    ({"text": "goal not reached", "reason": "no progress"}, 0.0, "gave up: no progress"),
]


def test_states_in_words(new_page):
    # Modules without a page.
    pure = page_text("geometry.js") + page_text("words.js")
    source = re.sub(r"^import .*|^export ", "", pure, flags=re.M)
    to_go = {"distance": 1.5, "heading": -0.25, "lateral": 0.98}
    blank = new_page().tab
    for status, speed, words in STATES:
        arguments = ", ".join(map(json.dumps, (status, to_go, {"v": speed, "omega": 0.0}, status.get("left"), 0.1)))
        assert blank.evaluate(f"() => {{ {source} return inWords({arguments})[1]; }}") == words
    blank.close()


def test_runs_are_laid_over_each_other(circle, new_page, tmp_path):
    other = view_bags.write(tmp_path / "bag", view_bags.drive(400, error=(0.5, 0.0, 0.0)))
    write_report(circle, tmp_path / "two.html", others=[other])
    both = new_page().open((tmp_path / "two.html").as_uri())
    both.get("diffbotPage.view.fit(diffbotPage.robot); diffbotPage.player.go(3)")
    both.next_frame()
    assert both.count(TRUTH) > 200
    assert both.count(ESTIMATE) > 200
    legend = both.tab.locator("#legend label")
    legend.nth(1).locator("input").uncheck()
    both.next_frame()
    assert both.count(ESTIMATE) < 20
    assert re.findall(r"(\d): \S+ [\d.]+ m", both.text(".chart:visible >> nth=0")) == ["1", "2"]
    rows = [row.locator("td").all_inner_texts() for row in both.tab.locator("#summary tbody tr").all()]
    assert [row[0][:2] for row in rows] == ["1:", "2:", "1:", "2:"]
    # The second goal came after 5 s and after 4 s of a drive at 0.5 m/s.
    assert rows[1][7].endswith(" (-0.50)")
    both.tab.locator("#robot").select_option(index=1)
    assert both.get("diffbotPage.robot.name").startswith("2: ")
    assert both.errors == []
    both.tab.close()
