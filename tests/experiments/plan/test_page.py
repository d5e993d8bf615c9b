"""The planner's page in a browser: by mouse, by keyboard, and when the line breaks."""

import json
import re
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from browser_pages import start_browser
from plan_desks import few_poses, start_server  # noqa: F401

pytest.importorskip("starlette", reason="place-rsus[plan] is not installed")

from experiments.export.json import to_json_text
from experiments.plan.session import Variant
from experiments.results.numbers import percent
from experiments.results.result import build_evaluation_record
from experiments.study.layout import load_carlancap_layout
from geometry.poses import Pose
from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.evaluator import evaluate_layout
from placement.layout import load_layout

pytestmark = pytest.mark.system

PATIENCE_MS = 120_000


def expect(locator):
    """What playwright waits for; the tests are skipped where it is not installed."""
    return pytest.importorskip("playwright.sync_api").expect(locator)


@pytest.fixture(scope="module")
def browser():
    with start_browser() as opened:
        yield opened


@pytest.fixture
def serve(tmp_path, small_setting, few_poses):  # noqa: F811
    servers = []

    def start(units=(), **given):
        variants = [Variant(name="mine", units=tuple(units))] if units else []
        servers.append(start_server(tmp_path, small_setting, variants=variants, **given))
        return servers[-1]

    yield start
    for server in servers:
        server.stop()


@contextmanager
def opened(browser, server, *, width=1280, height=900, may_complain=False, before=None, **options):
    """The page; it must neither complain nor ask for anything from elsewhere."""
    context = browser.new_context(viewport={"width": width, "height": height}, **options)
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    complaints = []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    home = urlsplit(server.address).netloc
    page.on(
        "request",
        lambda request: (
            None if urlsplit(request.url).netloc in (home, "") else complaints.append(request.url)
        ),
    )
    if before is not None:
        before(page)
    page.goto(server.address)
    page.wait_for_selector("[data-site]")
    yield page
    context.close()
    assert may_complain or complaints == []


def middle(locator):
    box = locator.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def told(page, *sources):
    """What the page says once a source has answered."""
    named = sources or ("evaluator",)
    page.wait_for_selector(", ".join(f"#source.{source}" for source in named))
    return page.locator("#apr").inner_text()


def saved(page, tmp_path):
    with page.expect_download() as download:
        page.locator("#save-layout").click()
    path = tmp_path / "saved.json"
    download.value.save_as(path)
    return load_layout(path)


def test_a_camera_is_hung_and_dragged_by_mouse_and_the_numbers_are_those_of_evaluate(
    browser, serve, small_setting, tmp_path
):
    with opened(browser, serve()) as page:
        assert page.locator("#apr").inner_text() in ("No sensor yet", "computing \u2026")
        x, y = middle(page.locator('[data-site="corner-ne"]'))
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 160, y - 20, steps=4)  # along the eastern arm
        page.mouse.up()
        page.wait_for_selector("[data-aim]")
        away = told(page)
        yaw = page.locator("#yaw").input_value()
        x, y = middle(page.locator("[data-aim]"))
        site_x, site_y = middle(page.locator('[data-site="corner-ne"]'))
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(site_x - 60, site_y + 60, steps=12)
        page.mouse.up()
        expect(page.locator("#yaw")).not_to_have_value(yaw, timeout=PATIENCE_MS)
        shown = told(page)
        assert shown != away
        layout = saved(page, tmp_path)
        (unit,) = layout.units
        assert unit.site_id == "corner-ne"
        assert -180.0 < unit.pose.yaw_deg < -90.0
        evaluation = evaluate_layout(layout, small_setting, compute=Compute(workers=2))
        record = json.loads(to_json_text(build_evaluation_record(evaluation, small_setting.rule)))
        assert shown == percent(record["rsu_all"]["all"])
        for case, share in record["rsu_all"]["by_case"].items():
            row = page.locator("#by-case tr").filter(has_text=re.compile(f"^{case}"))
            assert row.locator("td").inner_text() == percent(share)
        assert percent(record["vut_and_rsus"]["all"]) in page.locator("#beside").inner_text()
        page.keyboard.press("Control+z")  # a drag is one step
        expect(page.locator("#yaw")).to_have_value(yaw, timeout=PATIENCE_MS)
        assert told(page) == away


def test_everything_by_keyboard(browser, serve, tmp_path):
    with opened(browser, serve()) as page:
        page.locator('[data-site="corner-sw"]').focus()
        page.keyboard.press("Enter")
        assert page.locator("#site").input_value() == "corner-sw"
        page.locator("#hang").focus()
        page.keyboard.press("Enter")
        page.wait_for_selector('[data-unit="U1"]')
        page.locator('[data-unit="U1"]').focus()
        yaw, pitch = (float(page.locator(name).input_value()) for name in ("#yaw", "#pitch"))
        for key in ("ArrowLeft", "Shift+ArrowLeft", "ArrowDown", "PageDown"):
            page.keyboard.press(key)
            page.wait_for_timeout(150)
        told(page)
        (unit,) = saved(page, tmp_path).units
        assert unit.pose.yaw_deg == pytest.approx(yaw + 11.0, abs=0.06)
        assert unit.pose.pitch_deg == pytest.approx(pitch - 1.0)
        page.locator("#show-help").focus()
        page.keyboard.press("Enter")
        assert page.locator("#help-dialog").is_visible()
        page.keyboard.press("Escape")
        page.locator('[data-unit="U1"]').focus()
        page.keyboard.press("Delete")
        page.wait_for_selector('[data-unit="U1"]', state="detached")
        page.keyboard.press("Control+z")
        page.wait_for_selector('[data-unit="U1"]')
        page.keyboard.press("Control+y")
        page.wait_for_selector('[data-unit="U1"]', state="detached")


def test_complete_to_two_take_it_over_and_undo(browser, serve):
    with opened(browser, serve(load_carlancap_layout().units[:1])) as page:
        page.locator("#complete-to").fill("2")
        page.locator('[data-ask="complete"]').click()
        card = page.locator("#proposals li")
        card.wait_for()
        assert "Completed to 2" in card.inner_text()
        card.get_by_text("Show on the plan").click()
        page.wait_for_selector("#proposals [aria-pressed=true]")
        page.locator("#proposals li").get_by_text("Take it over").click()
        expect(page.locator("#units button")).to_have_count(2, timeout=PATIENCE_MS)
        page.locator("#undo").click()
        expect(page.locator("#units button")).to_have_count(1, timeout=PATIENCE_MS)


def test_save_and_open_again_and_variants_side_by_side(browser, serve, tmp_path):
    study = load_carlancap_layout()
    with opened(browser, serve(study.units[:2]), may_complain=True) as page:
        page.locator("#copy-variant").click()
        expect(page.locator("#variants tbody tr")).to_have_count(2, timeout=PATIENCE_MS)
        page.locator("#variant-name").fill("fewer")
        page.locator("#variant-name").press("Enter")
        page.locator("#variants").get_by_text("fewer").wait_for()
        page.locator("#remove").click()
        expect(page.locator("#units button")).to_have_count(1, timeout=PATIENCE_MS)
        with page.expect_download() as download:
            page.locator("#save-plan").click()
        download.value.save_as(tmp_path / "plan.json")
        page.locator("#open-file").set_input_files(tmp_path / "plan.json")
        page.locator("#variants").get_by_text("fewer (2)").wait_for()
        assert "Opened: mine, fewer" in page.locator("#notice").inner_text()
        (tmp_path / "bad.json").write_text("{")
        page.locator("#open-file").set_input_files(tmp_path / "bad.json")
        page.get_by_text("bad.json: bad.json: got").wait_for()


def test_a_lost_run_is_told_and_played(browser, serve):
    with opened(browser, serve(load_carlancap_layout().units[7:8])) as page:
        told(page)
        page.locator("#lost button").first.click()
        page.locator("#run-why li").first.wait_for()
        assert "frames come early enough" in page.locator("#run-why").inner_text()
        page.locator("#play").click()
        frame = page.frame_locator("#player")
        frame.locator("#player-plan svg").wait_for()
        before = frame.locator("#player-status").inner_text()
        frame.locator("#player-frame").focus()
        page.keyboard.press("ArrowLeft")
        assert frame.locator("#player-status").inner_text() != before
        frame.locator("#view-show").click()
        frame.locator("#view-buttons").wait_for()
        assert frame.locator("#view-message").inner_text() == ""
        assert frame.locator("#view-3d canvas").count() > 0
        page.keyboard.press("Escape")


def test_a_map_is_dropped_and_a_junction_of_it_chosen(browser, serve):
    text = (Path(__file__).parents[3] / "docs" / "maps" / "crossing.osm").read_text()
    with opened(browser, serve(load_carlancap_layout().units[:1])) as page:
        dropped = page.evaluate_handle(
            """text => { const data = new DataTransfer();
            data.items.add(new File([text], "crossing.osm")); return data; }""",
            text,
        )
        page.dispatch_event("#plan", "drop", {"dataTransfer": dropped})
        page.locator("#map-dialog").wait_for()
        assert "crossing.osm has" in page.locator("#map-text").inner_text()
        assert (
            page.locator("#map-plan circle").count() == page.locator("#map-junction option").count()
        )
        page.locator("#map-take").click()
        page.locator("#map-dialog").wait_for(state="hidden")
        assert "town05" not in page.locator("#scene-name").inner_text()
        assert page.locator("#units button").count() == 0
        page.locator("#hang").click()
        page.locator('[data-unit="U1"]').wait_for()
        assert "%" in told(page, "table", "evaluator")


def test_a_lost_connection_is_told_and_mended(browser, serve):
    lines, is_broken = [], []

    def route(line):
        if is_broken:
            line.close()
            return
        line.connect_to_server()
        lines.append(line)

    with opened(
        browser,
        serve(load_carlancap_layout().units[:1]),
        before=lambda page: page.route_web_socket("**/live", route),
    ) as page:
        told(page)
        is_broken.append(True)
        lines[-1].close()
        page.locator("#connection").wait_for()
        assert "%" not in page.locator("#apr").inner_text()
        assert page.locator("#main").evaluate("element => element.inert")
        is_broken.clear()
        page.locator("#connection").wait_for(state="hidden")
        told(page)
        assert page.locator("#units button").count() == 1


def test_two_hundred_units_are_shown_and_turned(browser, serve, small_setting):
    camera = load_carlancap_layout().units[0].sensor
    rng = np.random.default_rng(0)
    units = [
        CandidatePose(
            id=f"U{index}",
            site_id="",
            pose=Pose(
                position_m=site.position_m + [0.0, 0.0, 5.0],
                yaw_deg=float(rng.uniform(-180.0, 180.0)),
                pitch_deg=-15.0,
            ),
            sensor=camera,
        )
        for index in range(200)
        for site in [small_setting.scene.sites[index % 28]]
    ]
    with opened(browser, serve(units)) as page:
        expect(page.locator("#units button")).to_have_count(200, timeout=PATIENCE_MS)
        page.locator('[data-chip="U7"]').click()
        page.locator("#yaw").fill("12")
        page.locator("#yaw").press("Tab")
        turned = page.locator('[data-unit="U7"] path').first
        expect(turned).to_have_attribute("transform", "rotate(-12)", timeout=PATIENCE_MS)
        told(page, "table", "evaluator")


def test_the_page_has_no_serious_fault_for_who_cannot_see_it(browser, serve):
    library = pytest.importorskip(
        "axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed"
    )
    with opened(browser, serve(load_carlancap_layout().units[:2])) as page:
        told(page)
        axe = library.Axe()
        for opens in (None, "#show-help", "#background"):
            if opens:
                page.locator(opens).click()
            found = axe.run(page).response["violations"]
            serious = [
                (one["id"], [node["target"] for node in one["nodes"]][:3])
                for one in found
                if one["impact"] in ("serious", "critical")
            ]
            assert serious == []
            page.keyboard.press("Escape")


@pytest.mark.parametrize("width", [820, 390])
def test_nothing_is_cut_off_on_tablets_and_phones(browser, serve, width):
    with opened(browser, serve(load_carlancap_layout().units[:1]), width=width) as page:
        told(page, "table", "evaluator")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
