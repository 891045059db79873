"""The report in a browser: it draws the curves, loads no other file, and does not run scripts from the bag."""

import itertools
import math
import re

import browser
import pytest
import view_bags

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
    """Check after each test: the console has no error, and only the file itself was requested."""
    yield
    assert page.errors == []
    assert len(page.requests) == 1
    assert page.requests[0].startswith("file://")


def test_the_curves_have_the_values_of_the_bag_and_are_drawn(page):
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
    assert page.count(ESTIMATE, ".chart:visible canvas >> nth=4", apart=140) > 100


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


def test_an_event_leads_to_its_time_and_the_tables_show_goals_and_topics(page):
    events = page.tab.locator("#events button").all_inner_texts()
    assert any("goal 2: x 2.00 m, y 0.50 m, 14 deg" in text for text in events)
    goal, box = (page.tab.locator(place) for place in ("#events button", "#filters label"))
    goal = goal.filter(has_text="goal 2")
    goal.click()
    assert page.get("diffbotPage.player.time") == pytest.approx(5.002, abs=1e-3)
    box.filter(has_text="goal").locator("input").uncheck()
    assert not goal.is_visible()
    box.filter(has_text="goal").locator("input").check()
    assert goal.is_visible()
    rows = [row.locator("td").all_inner_texts() for row in page.tab.locator("#summary tbody tr").all()]
    assert [row[2].split(":")[0] for row in rows] == ["reached", "not reached"]
    # From the true pose at the end of the second goal to that goal.
    _, x, y, _ = view_bags.at(499)
    assert float(rows[1][4]) == pytest.approx(math.hypot(x - 2.0, y - 0.5), abs=1e-4)
    assert float(rows[0][6]) == pytest.approx(2.5, abs=0.03)
    topics = [row.locator("td").all_inner_texts() for row in page.tab.locator("#topics tbody tr").all()]
    (pose,) = [row for row in topics if row[0] == "/pose"]
    assert pose[2:] == ["500", "50.0", "0.020", "2.0", "2.0"]


def test_keys_move_the_map_the_wheel_zooms_about_the_pointer_and_a_drag_zooms_the_charts(page):
    page.tab.locator("#map").focus()
    page.tab.keyboard.press("0")
    x, scale = page.get("[diffbotPage.view.x, diffbotPage.view.scale]")
    page.tab.keyboard.press("ArrowRight")
    assert page.get("diffbotPage.view.x") > x
    page.get("diffbotPage.player.go(0)")
    page.tab.locator("#speed").select_option("20")
    page.tab.keyboard.press("0")
    page.tab.locator("#play").click()
    page.wait("!diffbotPage.player.isPlaying && diffbotPage.player.time === diffbotPage.player.end", "the end")
    before, box = page.get("diffbotPage.view.toWorld(200, 150)"), page.tab.locator("#map").bounding_box()
    page.tab.mouse.move(box["x"] + 200, box["y"] + 150)
    page.tab.mouse.wheel(0, -300)
    page.wait(f"diffbotPage.view.scale > {scale}", "the zoom")
    pixel = 1.0 / page.get("diffbotPage.view.scale")
    assert page.get("diffbotPage.view.toWorld(200, 150)") == pytest.approx(before, abs=pixel)
    canvas = page.tab.locator(".chart:visible canvas >> nth=2")
    canvas.scroll_into_view_if_needed()
    box, axis = canvas.bounding_box(), 62
    page.tab.mouse.move(box["x"] + axis + 0.2 * (box["width"] - axis), box["y"] + 30)
    page.tab.mouse.down()
    page.tab.mouse.move(box["x"] + axis + 0.6 * (box["width"] - axis), box["y"] + 30, steps=3)
    page.tab.mouse.up()
    assert page.get("diffbotPage.zoom") == pytest.approx([2.0, 6.0], abs=0.1)


def test_texts_of_a_bag_are_not_markup_and_markup_could_not_run_a_script(page, new_page, report):
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
    assert other.text("#title") == "0 of 2 goals reached"
    card, map_box = (other.tab.locator(place).bounding_box() for place in (".cards button >> nth=1", "#map"))
    assert card["y"] + card["height"] <= map_box["y"]
    assert card["y"] + card["height"] <= size[1]
    for panel in ("#filter", "#law"):
        other.tab.locator(f"{panel} summary").click()
    # No element is wider than the window or than its own box.
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


def test_a_report_of_two_bags_draws_both_and_compares_their_goals(circle, new_page, tmp_path):
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
