"""The report in a real browser: it renders, needs nothing else, moves with the slider, and runs no script of a bag."""

import math

import browser
import pytest
import view_bags

from diffbot_tools.view.report_command import write_report

pytestmark = pytest.mark.graph
TRUTH, ESTIMATE = (0, 114, 178), (213, 94, 0)
"""Colours of the light style, Okabe and Ito's."""
TRUTH_DARK = (86, 180, 233)


@pytest.fixture(scope="module")
def new_page():
    with browser.chromium() as make:
        yield make


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


def test_the_curves_are_those_of_the_bag(page):
    assert page.get("diffbotPage.robot.curves.truth.rows") == 500
    for step in (0, 123, 499):
        _, x, y, yaw = view_bags.at(step)
        got = page.get(f"['t', 'x', 'y', 'theta'].map((name) => diffbotPage.robot.curves.truth.columns[name][{step}])")
        assert got[:3] == pytest.approx([step / 50, x, y], abs=1e-5)
        assert math.remainder(got[3] - yaw, 2 * math.pi) == pytest.approx(0.0, abs=1e-5)
    errors = page.get(
        "['x', 'y', 'theta', 'three_sigma_x', 'nees'].map((name) => diffbotPage.robot.curves.error.at(name, 5))"
    )
    nees = (0.03**2 + 0.02**2 + 0.01**2) / 0.05**2
    assert errors == pytest.approx([0.03, -0.02, 0.01, 0.15, nees], abs=2e-5)


def test_paths_and_charts_are_drawn(page):
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


def test_a_click_on_an_event_goes_to_its_time(page):
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


def test_the_table_tells_how_each_goal_ended(page):
    rows = [row.locator("td").all_inner_texts() for row in page.tab.locator("#summary tbody tr").all()]
    assert [row[2].split(":")[0] for row in rows] == ["reached [goal_pose]", "not reached"]
    # From the true pose at the end of the second goal to that goal.
    _, x, y, _ = view_bags.at(499)
    assert float(rows[1][3]) == pytest.approx(math.hypot(x - 2.0, y - 0.5), abs=1e-4)
    assert float(rows[0][6]) == pytest.approx(2.5, abs=0.02)


def test_no_text_of_a_bag_runs_as_a_script(page):
    assert page.get("globalThis.broken") is None
    assert page.tab.locator("#events button", has_text="onerror=").count() == 1
    assert page.tab.locator("img").count() == 0


def test_keys_move_and_zoom_and_it_plays_until_the_end(page):
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


def test_a_wheel_zooms_about_the_pointer_and_a_drag_moves(page):
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


def test_it_fits_a_phone_in_the_dark(new_page, report):
    phone = new_page(browser.NARROW, "dark").open(report)
    phone.next_frame()
    assert phone.get("document.documentElement.scrollWidth") == 390
    assert phone.count(TRUTH_DARK) > 100
    assert phone.tab.locator("#play").bounding_box()["height"] >= 40
    assert phone.errors == []
    phone.tab.close()


def test_an_element_that_gets_in_cannot_load_or_run_anything(new_page, report):
    """The policy holds even if a text did become markup."""
    victim = new_page().open(report)
    victim.get("document.body.insertAdjacentHTML('beforeend', '<img src=http://127.0.0.1:9/x onerror=\"broken = 1\">')")
    victim.wait_for(lambda: any("Content Security Policy" in line for line in victim.errors), "the refusal")
    assert victim.get("globalThis.broken") is None
    victim.tab.close()
