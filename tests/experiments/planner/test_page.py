"""The planner's page in a browser: by mouse, by keyboard, and when the line breaks."""

import io
import re
import time
from contextlib import contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from urllib.parse import urlsplit

import numpy as np
import pytest
from browser_pages import ENGINES, open_page, start_browser
from city_maps import write_city
from json_files import as_json
from made_up_language import Bracketed, left_over
from osm_text import OsmText
from partial_pages import blank_pictures
from PIL import Image
from plan_sessions import few_poses, start_server  # noqa: F401
from private_garden import write_garden
from pyproj import Transformer

pytest.importorskip("starlette", reason="place-rsus[plan] is not installed")

from experiments.figures.axes import describe_run
from experiments.language import speaking
from experiments.parts.camera_views import draw_view
from experiments.parts.result import build_evaluation_record
from experiments.planner.files import MapFile
from experiments.planner.tasks import Tasks
from experiments.planner.tiles import read_tile_server
from experiments.results.numbers import percent
from geometry.study_scene import load_study_scene
from placement.compute import Compute
from placement.evaluation import apr, run_outcomes
from placement.evaluator import evaluate_layout
from placement.layout import Layout, load_carlancap_layout, load_layout
from scenarios.cases import load_case_sets
from scenarios.weights import WEIGHT_WORDS

# In a browser, which takes long. What the page is made of, quickly:
# test_server.py and test_plan.py
pytestmark = [pytest.mark.system, pytest.mark.long]

PATIENCE_MS = 120_000
UNITS = load_carlancap_layout().units
CROSSING = Path(__file__).parents[3] / "docs/maps/crossing.osm"


def expect(locator):
    """What playwright waits for; the tests are skipped where it is not installed."""
    library = pytest.importorskip("playwright.sync_api")
    library.expect.set_options(timeout=PATIENCE_MS)
    return library.expect(locator)


@pytest.fixture(scope="module", params=ENGINES)
def browser(request, tmp_path_factory):
    with start_browser(
        request.param, folder=tmp_path_factory.mktemp("browser")
    ) as opened:
        yield opened


@pytest.fixture
def drawn_pictures():
    """What a camera sees is drawn; without this it is grey, as most tests do not look
    at it.
    """


@pytest.fixture(autouse=True)
def grey_pictures(request):
    """Pictures are grey unless a test asks for `drawn_pictures`."""
    if "drawn_pictures" in request.fixturenames:
        yield
    else:
        with blank_pictures():
            yield


@pytest.fixture
def garden(tmp_path):
    """Private ground beside the junction."""
    return write_garden(tmp_path, (-146.4, 7.6, -130.4, 17.6))


@pytest.fixture
def serve(tmp_path, small_setting, few_poses):  # noqa: F811
    """Starts servers of plans with some units; they end with the test."""
    servers = []

    def start(units=(), **given):
        servers.append(start_server(tmp_path, small_setting, units=units, **given))
        return servers[-1]

    yield start
    for server in servers:
        server.stop()


@pytest.fixture
def visit(browser, serve):
    """Opens the page of a plan with some units; options of both."""

    def look(units=(), *, asked=None, map_file=None, **options):
        return opened(browser, serve(units, asked=asked, map_file=map_file), **options)

    return look


@contextmanager
def opened(browser, server, *, foreign=(), before=None, **options):
    """The page of a plan; it asks for nothing from elsewhere but `foreign` hosts."""

    def prepare(page):
        page.set_default_timeout(PATIENCE_MS)
        if before is not None:
            before(page)

    hosts = (urlsplit(server.address).netloc, *foreign)
    own = [f"{kind}://{host}/" for kind in ("http", "ws") for host in hosts]
    own += ["data:", "blob:"]
    options |= {"own": tuple(own), "before": prepare, "may_ask_people": True}
    with open_page(browser, server.address, **options) as page:
        page.wait_for_selector("[data-site]")
        yield page


def middle(locator):
    """Middle of an element on the screen. [px]"""
    while (box := locator.bounding_box()) is None:
        locator.wait_for()  # it is being drawn anew
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def pole(page, name):
    """Where a pole is on the screen. [px]"""
    return middle(page.locator(f'[data-site="{name}"]'))


def aim(page):
    """Where the handle is that turns the chosen unit. [px]"""
    return middle(page.locator("[data-aim]"))


def drag(page, start, *places, steps=4):
    """Press the mouse and move it over some places; it stays pressed."""
    page.mouse.move(*start)
    page.mouse.down()
    for place in places:
        page.mouse.move(*place, steps=steps)


def has_units(page, count):
    """Wait until as many units are mounted."""
    expect(page.locator("#units button")).to_have_count(count)


def has_value(page, field, value):
    """Wait until a field has a value."""
    expect(page.locator(field)).to_have_value(value)


def told(page, *sources):
    """What the page says once a source has answered about what is shown."""
    named = sources or ("evaluator",)
    answered = (f"p:has(> #apr:not(.old)) + #source.{source}" for source in named)
    page.wait_for_selector(", ".join(answered))
    return page.inner_text("#apr")


def downloaded(page, button, path):
    """File that a button saves."""
    with page.expect_download() as download:
        page.click(button)
    download.value.save_as(path)
    return path


def saved(page, tmp_path):
    """The layout that is shown, as it is saved."""
    return load_layout(downloaded(page, "#save-layout", tmp_path / "saved.json"))


def write(field, text):
    """Type in place of what a field has; ``fill`` adds to numbers in Firefox."""
    field.focus()
    field.press("Control+a")
    field.press_sequentially(text)


def drop(page, name, content):
    """Drop a file on the plan."""
    dropped = page.evaluate_handle(
        """([name, text]) => { const data = new DataTransfer();
        data.items.add(new File([text], name)); return data; }""",
        [name, content],
    )
    page.dispatch_event("#plan", "drop", {"dataTransfer": dropped})


def test_a_camera_is_hung_and_dragged_by_mouse_and_the_numbers_are_those_of_evaluate(
    visit, small_setting, tmp_path
):
    with visit() as page:
        assert page.inner_text("#apr") in ("No sensor yet", "computing \u2026")

        x, y = pole(page, "corner-ne")
        drag(page, (x, y), (x + 160, y - 20))  # along the eastern arm

        # The button is still pressed: the sensor is there, with a number.
        has_units(page, 1)
        expect(page.locator("#apr")).to_have_text(re.compile(r"\d %"))

        page.mouse.up()
        page.wait_for_selector("[data-aim]")
        away = told(page)

        has_value(page, "#site", "corner-ne")  # the pole that was in hand
        expect(page.locator("#site-text")).to_contain_text("EUR (assumed) once")

        yaw = page.input_value("#yaw")
        x, y = aim(page)
        site_x, site_y = pole(page, "corner-ne")
        drag(page, (x, y), (site_x - 60, site_y + 60), steps=12)
        page.mouse.up()
        # The last step's: others may be evaluated, too.
        south_west = re.compile(r"^-13[45]\b")

        has_value(page, "#yaw", south_west)

        shown = told(page)
        assert shown != away

        layout = saved(page, tmp_path)
        (unit,) = layout.units

        assert unit.site_id == "corner-ne"
        assert -180.0 < unit.pose.yaw_deg < -90.0

        evaluation = evaluate_layout(layout, small_setting, compute=Compute(workers=2))
        record = as_json(build_evaluation_record(evaluation, small_setting.rule))
        assert shown == percent(record["rsu_all"]["all"])

        for case, share in record["rsu_all"]["by_case"].items():
            row = page.locator("#by-case tr").filter(has_text=re.compile(f"^{case}"))
            assert row.locator("td").inner_text() == percent(share)
        met = np.array([run.road_user for run in small_setting.runs])
        for group in set(met):
            share = apr(evaluation.rsu_all, evaluation.axis, met == group)
            row = page.locator("#by-road-user tr").filter(
                has_text=re.compile(f"^{group}")
            )
            assert row.locator("td").inner_text() == percent(share)

        assert percent(record["vut_and_rsus"]["all"]) in page.inner_text("#beside")

        page.keyboard.press("Control+z")  # a drag is one step
        has_value(page, "#yaw", yaw)
        assert told(page) == away

        page.keyboard.press("Control+z")  # and so is the one that hung the sensor
        has_units(page, 0)


def test_everything_by_keyboard(visit, tmp_path):
    with visit() as page:
        page.focus('[data-site="corner-sw"]')
        page.keyboard.press("Enter")
        assert page.input_value("#site") == "corner-sw"

        page.focus("#hang")
        page.keyboard.press("Enter")
        page.wait_for_selector('[data-unit="U1"]')
        page.focus('[data-unit="U1"]')
        yaw, pitch = (
            float(page.locator(name).input_value()) for name in ("#yaw", "#pitch")
        )
        for key in ("ArrowLeft", "Shift+ArrowLeft", "ArrowDown", "PageDown"):
            page.keyboard.press(key)  # faster than answers come

        has_value(page, "#yaw", re.compile(rf"^{yaw + 11.0:.1f}"))

        told(page)
        (unit,) = saved(page, tmp_path).units

        assert unit.pose.yaw_deg == pytest.approx(yaw + 11.0, abs=0.06)
        assert unit.pose.pitch_deg == pytest.approx(pitch - 1.0)

        page.focus("#show-help")
        page.keyboard.press("Enter")
        page.wait_for_selector("#help-dialog")
        page.keyboard.press("Escape")
        page.wait_for_selector("#help-dialog", state="hidden")
        page.focus('[data-unit="U1"]')
        page.keyboard.press("Delete")
        page.wait_for_selector('[data-unit="U1"]', state="detached")
        page.keyboard.press("Control+z")
        page.wait_for_selector('[data-unit="U1"]')
        page.keyboard.press("Control+y")
        page.wait_for_selector('[data-unit="U1"]', state="detached")


def test_a_button_is_clicked_although_its_list_is_drawn_anew_while_it_is_pressed(
    browser, serve
):
    server = serve(UNITS[:1])
    with opened(browser, server) as page, opened(browser, server) as other:
        write(page.locator("#complete-to"), "2")
        page.click('[data-ask="complete"]')
        page.locator("#proposals").get_by_text("By the evaluator: APR").wait_for()
        page.locator("#proposals").get_by_text("Show on the plan").hover()
        page.mouse.down()
        write(other.locator("#complete-to"), "3")
        other.click('[data-ask="complete"]')

        expect(other.locator("#proposals li")).to_have_count(2)
        assert page.locator("#proposals li").count() == 1

        page.mouse.up()
        page.wait_for_selector("#proposals [aria-pressed=true]")
        expect(page.locator("#proposals li")).to_have_count(2)

        # A window behind another one has no focus that `to_be_focused` accepts.
        page.wait_for_function(
            "document.activeElement.ariaPressed === 'true'"
            " && document.activeElement.closest('#proposals') !== null"
        )
        pressed = page.locator("[aria-pressed=true]")
        shown = page.locator("#proposals li").filter(has=pressed)

        expect(shown).to_contain_text("Completed to 2")

        shown.get_by_text("Accept").click()
        has_units(page, 2)

        page.click("#undo")
        has_units(page, 1)


def test_save_and_open_again_and_variants_side_by_side(visit, tmp_path):
    with visit(UNITS[:2], may_complain=True) as page:
        page.click("#copy-variant")
        expect(page.locator("#variants tbody tr")).to_have_count(2)

        write(page.locator("#variant-name"), "fewer")
        page.press("#variant-name", "Enter")
        page.locator("#variants").get_by_text("fewer").wait_for()
        page.click("#remove")

        has_units(page, 1)

        plan = downloaded(page, "#save-plan", tmp_path / "plan.json")
        page.set_input_files("#open-file", plan)
        page.locator("#variants").get_by_text("plan: fewer").wait_for()
        notice = page.locator("#notice")  # comes by another way than the variants

        expect(notice).to_contain_text("Opened: mine, fewer")

        (tmp_path / "bad.json").write_text("{")
        page.set_input_files("#open-file", tmp_path / "bad.json")
        page.get_by_text(re.compile(r"^bad\.json: got")).wait_for()


def test_an_image_lies_below_the_plan_and_is_kept_with_it(visit, tmp_path):
    Image.new("RGB", (200, 100), (90, 120, 90)).save(tmp_path / "aerial.png")
    with visit(UNITS[:1]) as page:
        page.click("#background")
        page.set_input_files("#image-file", tmp_path / "aerial.png")
        page.click("#image-shown", position={"x": 20, "y": 10})

        assert float(page.input_value("#x1")) == pytest.approx(20.0, abs=1.0)

        points = (
            (0.0, 0.0, -20.0, 10.0),
            (200.0, 0.0, 20.0, 10.0),
        )
        for number, point in enumerate(points, start=1):
            for name, value in zip(("x", "y", "east", "north"), point, strict=True):
                write(page.locator(f"#{name}{number}"), f"{value:g}")
        page.click("#image-lay")
        image = page.locator('#plan image[href^="background"]')
        image.wait_for(state="attached")
        lies = "matrix(20 0 0 -20 -2000 1000)"  # 40 m over 200 pixels, in centimetres

        assert image.get_attribute("transform") == lies

        plan = downloaded(page, "#save-plan", tmp_path / "plan.json")
        page.click("#background")
        page.click("#image-drop")
        image.wait_for(state="detached")
        page.set_input_files("#open-file", plan)
        image.wait_for(state="attached")
        page.reload()
        image.wait_for(state="attached")

        assert image.get_attribute("transform") == lies

        fetched = page.evaluate(
            """async () => { const image = new Image();
            image.src = document.querySelector('#plan image[href^="background"]')
                .getAttribute("href");
            await image.decode(); return [image.naturalWidth, image.naturalHeight]; }"""
        )
        assert fetched == [200, 100]


def test_all_ends_when_the_page_is_closed_but_not_when_it_is_loaded_again(
    browser, serve, monkeypatch
):
    from experiments.planner import server as module

    monkeypatch.setattr(module, "LINGER_S", 3.0)
    server = serve(UNITS[:1], keeps_open=False)
    with opened(browser, server) as page:
        page.reload()
        page.wait_for_selector("[data-unit]")
        page.wait_for_timeout(4000)

        assert server.is_alive
    server.wait()

    assert not server.is_alive


def test_a_plan_that_is_in_no_file_is_not_closed_without_a_word(visit, tmp_path):
    with visit(UNITS[:2]) as page:
        asked = []
        page.on("dialog", lambda dialog: (asked.append(dialog.type), dialog.accept()))
        page.click("#remove")

        has_units(page, 1)

        page.reload()
        page.wait_for_selector("[data-unit]")
        assert asked == ["beforeunload"]

        page.click("#undo")
        has_units(page, 2)

        downloaded(page, "#save-plan", tmp_path / "plan.json")
        page.reload()
        page.wait_for_selector("[data-unit]")

        assert asked == ["beforeunload"]


def test_a_lost_run_is_told_and_played(visit):
    with visit(UNITS[7:8]) as page:
        told(page)
        page.locator("#lost button").first.click()
        page.click("#played-why")
        page.locator("#run-why li").first.wait_for()

        assert "frames come early enough" in page.inner_text("#run-why")

        page.click("#play")
        frame = page.frame_locator("#player")
        frame.locator("#player-plan svg").wait_for()
        before = frame.locator("#player-status").inner_text()
        frame.locator("#player-frame").focus()
        page.keyboard.press("ArrowLeft")

        assert frame.locator("#player-status").inner_text() != before

        page.keyboard.press("Escape")


def test_a_map_is_dropped_a_junction_of_it_chosen_and_undo_leads_back(visit):
    with visit(UNITS[:1]) as page:
        drop(page, "crossing.osm", CROSSING.read_text())
        page.wait_for_selector("#map-choice .junction-chooser")
        said = page.inner_text("#map-text")

        assert "crossing.osm has" in said
        assert "Undo returns to the plan at town05" in said
        assert page.locator("#map-choice circle").count() == 1
        assert page.locator("#map-choice circle.chosen").count() == 1

        street = page.locator("#map-choice li button").first.inner_text().split("\n")[0]
        page.click("#map-take")
        page.wait_for_selector("#map-dialog", state="hidden")

        assert page.inner_text("#scene-name").startswith(f"at {street},")
        has_units(page, 0)

        page.click("#hang")
        page.wait_for_selector('[data-unit="U1"]')
        assert "%" in told(page, "table", "evaluator")

        page.click("#undo")
        has_units(page, 0)

        page.click("#undo")
        expect(page.locator("#scene-name")).to_contain_text("town05")
        has_units(page, 1)


def test_a_lost_connection_is_told_and_mended(visit):
    lines = []
    is_broken = []

    def route(line):
        if is_broken:
            line.close()
            return
        line.connect_to_server()
        lines.append(line)

    with visit(
        UNITS[:1],
        before=lambda page: page.route_web_socket("**/live", route),
    ) as page:
        told(page)
        is_broken.append(True)
        lines[-1].close()
        page.wait_for_selector("#connection")

        assert "%" not in page.inner_text("#apr")
        assert page.locator("#main").evaluate("element => element.inert")

        is_broken.clear()
        page.wait_for_selector("#connection", state="hidden")
        told(page)

        assert page.locator("#units button").count() == 1


def test_a_unit_is_chosen_although_its_number_comes_while_the_button_is_pressed(visit):
    with visit(UNITS[6:8]) as page:
        told(page)
        first, second = page.locator("#units button").all()
        before = second.inner_text()
        page.mouse.move(*middle(first))
        page.mouse.down()
        for _ in range(4):
            # Turns the last unit, which is still chosen.
            page.keyboard.press("Shift+ArrowLeft")

        expect(second).to_have_attribute("aria-pressed", "true")
        expect(second).not_to_have_text(before)

        told(page)
        expect(second).to_contain_text("%")

        page.mouse.up()
        expect(first).to_have_attribute("aria-pressed", "true")


def test_the_page_has_no_serious_fault_for_who_cannot_see_it(visit, garden):
    library = pytest.importorskip(
        "axe_playwright_python.sync_playwright",
        reason="axe-playwright-python is not installed",
    )
    units = UNITS[7:8]
    text = CROSSING.read_text()
    with visit(units, asked={"no_look": str(garden)}) as page:
        told(page)
        axe = library.Axe()

        def has_no_fault():
            found = axe.run(page).response["violations"]
            serious = [one for one in found if one["impact"] in ("serious", "critical")]
            assert serious == []
            page.keyboard.press("Escape")

        has_no_fault()
        for opens in (
            "[data-chip]",
            "#question summary",
            "#own-poles summary",
            "#danger",
            "#pole",
        ):
            page.locator(opens).click()
        page.locator("#danger-key").filter(has_text="within 2 m").wait_for()
        page.wait_for_selector('#seen[data-smooth="1"]')
        has_no_fault()
        for opens in ("#show-help", "#background"):
            page.locator(opens).click()
            has_no_fault()
        page.click("#copy-variant")
        page.select_option("#compare", "mine")
        page.locator("#compare-units li").first.wait_for()
        page.locator("#lost button").first.click()
        page.wait_for_selector("#played")
        has_no_fault()
        page.click("#played-why")
        page.locator("#run-why li").first.wait_for()
        page.click("#picture-show")
        page.wait_for_selector("#picture")
        has_no_fault()
        drop(page, "crossing.osm", text)
        page.wait_for_selector("#map-choice .junction-chooser")
        has_no_fault()


# ---------- hands


def number(page, field):
    """Number in a field."""
    return float(page.locator(field).input_value())


def test_keys_work_after_a_slider_and_escape_gives_a_drag_up(visit):
    with visit(UNITS[:2]) as page:
        page.click('[data-chip="RSU0"]')
        before = number(page, "#yaw")
        slider = page.locator("#yaw-slide")
        slider.focus()
        slider.press("ArrowRight")

        expect(page.locator("#yaw")).not_to_have_value(f"{before:g}")

        slider.press("Control+z")
        has_value(page, "#yaw", f"{before:g}")

        write(page.locator("#yaw"), "12")
        page.press("#yaw", "Enter")
        has_value(page, "#yaw-slide", "12")

        page.press("#yaw", "Control+z")  # what is typed is done
        expect(page.locator("#yaw-slide")).not_to_have_value("12")

        page.locator("#plan").scroll_into_view_if_needed()
        x, y = aim(page)
        drag(page, (x, y), (x + 60, y + 60))

        expect(page.locator("#yaw-slide")).not_to_have_value(f"{round(before)}")

        page.keyboard.press("Escape")
        has_value(page, "#yaw-slide", f"{round(before)}")

        page.mouse.move(x + 90, y)
        page.mouse.up()
        assert page.is_disabled("#redo")  # the drag has left nothing

        x, y = pole(page, "corner-sw")
        drag(page, (x, y), (x + 60, y - 60))
        page.keyboard.press("Escape")
        page.mouse.up()
        slider.focus()
        slider.press("Delete")

        has_units(page, 1)


def test_a_key_right_after_escape_is_for_the_unit_chosen_before_the_drag(visit):
    with visit(UNITS[:2]) as page:
        page.click('[data-chip="RSU0"]')
        x, y = pole(page, "corner-sw")
        drag(page, (x, y), (x + 60, y - 60))

        has_units(page, 3)

        # Both in one step, so that the session cannot answer between them.
        page.evaluate(
            """() => ["Escape", "Delete"].forEach((key) => document.body
            .dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true })))"""
        )
        page.mouse.up()

        has_units(page, 1)
        expect(page.locator("#units button")).to_contain_text("RSU1")


def test_a_pole_with_a_unit_takes_a_second_one_and_what_is_moved_keeps_its_aim(
    visit, tmp_path
):
    with visit(UNITS[1:2]) as page:
        x, y = pole(page, "corner-ne")
        drag(page, (x, y), (x - 80, y + 20))
        page.mouse.up()

        has_units(page, 2)

        first, second = saved(page, tmp_path).units
        assert first.site_id == second.site_id == "corner-ne"

        page.click('[data-chip="RSU1"]')
        expect(page.locator("[data-aim]")).to_have_attribute("data-aim", "RSU1")

        aimed = aim(page)
        drag(
            page,
            middle(page.locator('[data-unit="RSU1"] circle')),
            pole(page, "corner-sw"),
        )
        page.mouse.up()

        has_value(page, "#unit-site", "corner-sw")
        assert aim(page) == pytest.approx(aimed, abs=2.0)


TOUCH = """([kind, fingers]) => {
    const svg = document.querySelector("#plan svg");
    svg.setPointerCapture = () => {};
    fingers.forEach(([x, y], index) => svg.dispatchEvent(new PointerEvent(kind, {
        pointerId: 7 + index,
        pointerType: "touch",
        clientX: x,
        clientY: y,
        bubbles: true,
    })));
}"""


def test_the_ground_between_two_fingers_stays_and_a_wheel_goes_the_way_it_is_turned(
    visit,
):
    with visit() as page:
        site = page.locator('[data-site="corner-ne"]')
        far = page.locator('[data-site="corner-sw"]')
        x, y = middle(site)
        fingers = [
            [x - 40, y - 40],
            [x + 40, y + 40],
        ]
        page.evaluate(TOUCH, ["pointerdown", fingers])
        apart = abs(middle(far)[0] - x)
        moved = [
            [x + 30 - 80, y + 20 - 80],
            [x + 30 + 80, y + 20 + 80],
        ]
        page.evaluate(TOUCH, ["pointermove", moved])
        page.evaluate(TOUCH, ["pointerup", moved])

        assert middle(site) == pytest.approx((x + 30, y + 20), abs=1.5)
        assert abs(middle(far)[0] - middle(site)[0]) == pytest.approx(
            2.0 * apart, rel=0.01
        )

        x, y = middle(site)
        page.mouse.move(x, y)
        page.mouse.wheel(60, 0)
        page.wait_for_function(
            "x => document.querySelector('[data-site=corner-ne]')"
            ".getBoundingClientRect().x < x",
            arg=x - 20,
        )
        moved = middle(site)

        assert moved[1] == pytest.approx(y, abs=0.5)
        assert abs(middle(far)[0] - moved[0]) == pytest.approx(2.0 * apart, rel=0.01)


# ---------- words and widths


def held_back(page, lines):
    """Let no change reach the session until it is released."""
    held = []

    def route(line):
        server = line.connect_to_server()
        line.on_message(
            lambda text: held.append(text) if "change" in text else server.send(text)
        )
        lines.append((server, held))

    page.route_web_socket("**/live", route)


def test_a_server_that_does_not_answer_makes_numbers_old(visit):
    lines = []
    with visit(UNITS[:1], before=lambda page: held_back(page, lines)) as page:
        told(page)
        write(page.locator("#yaw"), "12")
        page.wait_for_selector("#silence")

        assert "has not answered for" in page.inner_text("#silence")
        assert "old" in page.get_attribute("#apr", "class")

        server, held = lines[-1]
        server.send(held[-1])
        page.wait_for_selector("#silence", state="hidden")


@pytest.mark.parametrize(
    "size",
    [
        (1280, 900),
        (820, 1180),
        (844, 390),
        (390, 844),
    ],
)
def test_the_key_of_densities_and_the_page_are_no_wider_than_the_screen(visit, size):
    width, height = size
    units = UNITS[:1]
    with visit(units, width=width, height=height) as page:
        page.check("#coverage")
        page.locator("#coverage-key .key").first.wait_for()
        assert page.evaluate("document.documentElement.scrollWidth") <= width

        key = page.locator("#coverage-key").bounding_box()
        stage = page.locator("#stage").bounding_box()

        assert key["x"] + key["width"] <= stage["x"] + stage["width"]
        assert page.locator("#plan").bounding_box()["height"] >= 0.4 * min(height, 600)


def test_the_position_error_is_told_where_the_mouse_is(visit):
    with visit(UNITS[:1]) as page:
        page.check("#coverage")
        page.check("#errors")
        # Both colour the same ground.
        assert not page.is_checked("#coverage")

        page.locator("#coverage-key .key").first.wait_for()
        assert "by position error" in page.inner_text("#coverage-key")

        plan = page.locator("#plan svg").bounding_box()
        told = set()
        for step in range(1, 12):
            x = plan["x"] + plan["width"] * step / 12
            page.mouse.move(x, plan["y"] + plan["height"] / 2)
            told.add(page.inner_text("#errors-here"))
        known = [text for text in told if re.search(r"here: \d\.\d\d m", text)]

        assert known
        assert "Here no camera sees an adult." in told

        page.uncheck("#errors")
        assert page.locator("#errors-here").is_hidden()
        assert page.locator("#coverage-key").is_hidden()


# ---------- handled as in the tools people know


def chosen(page):
    """Names of the units whose buttons are pressed."""
    return page.locator("#units [aria-pressed=true]").all_inner_texts()


def rested(page):
    """Wait until numbers and the chosen unit's view are there: nothing in the panel
    moves then.
    """
    told(page)
    page.get_by_text(re.compile(r"its detector reaches \d+ m")).wait_for()
    places = []
    while len(places) < 5 or len(set(places[-5:])) > 1:
        places.append(middle(page.locator("#unit")))
        page.wait_for_timeout(100)


def scale_m(page):
    """Metres of a pixel of the plan, by its bar."""
    bar = page.locator('#plan path[d^="M12 "]')
    (length,) = re.findall(r"h([\d.]+)$", bar.get_attribute("d"))
    return float(
        bar.locator("xpath=following-sibling::*[1]").text_content()[:-2]
    ) / float(length)


def empty_place(page):
    """A place of the plan without any view: a corner of its window."""
    box = page.locator("#plan").bounding_box()
    return box["x"] + 6, box["y"] + 6


def test_nothing_is_chosen_by_a_press_on_nothing_and_a_view_chooses_its_unit(visit):
    with visit(UNITS[:2]) as page:
        page.wait_for_selector('[data-view="RSU0"][d]', state="attached")
        page.wait_for_selector('[data-view="RSU1"][d]', state="attached")
        page.click('[data-chip="RSU0"]')
        last = page.locator("#plan [data-view]").last  # drawn above the other

        expect(last).to_have_attribute("data-view", "RSU0")

        page.click('[data-chip="RSU1"]')
        expect(last).to_have_attribute("data-view", "RSU1")

        page.mouse.click(*empty_place(page))
        expect(page.locator("#unit")).to_be_hidden()
        assert chosen(page) == []
        assert page.locator("[data-aim]").count() == 0

        x, y = (
            (a + b) / 2  # both look at the junction's middle
            for a, b in zip(
                pole(page, "corner-ne"), pole(page, "corner-sw"), strict=True
            )
        )
        page.mouse.click(x, y)
        first = chosen(page)
        page.mouse.click(x, y)  # the view below it
        second = chosen(page)

        assert {name[0].split()[0] for name in (first, second)} == {"RSU0", "RSU1"}

        page.keyboard.press("Escape")
        expect(page.locator("#unit")).to_be_hidden()


def test_backspace_and_delete_take_down_and_nothing_is_chosen_then(visit):
    with visit(UNITS[:3]) as page:
        for key, left in (
            ("Backspace", 2),
            ("Delete", 1),
        ):
            page.locator("[data-chip]").first.click()
            page.keyboard.press(key)

            has_units(page, left)
            assert chosen(page) == []
        page.keyboard.press("Delete")  # nothing is chosen
        page.locator("[data-chip]").first.click()
        write(page.locator("#yaw"), "12")
        page.press("#yaw", "Backspace")  # of what is typed

        has_value(page, "#yaw", "1")
        has_units(page, 1)


def test_ring_outline_compass_and_side_view_follow_before_any_answer(visit):
    lines = []
    with visit(UNITS[:1], before=lambda page: held_back(page, lines)) as page:
        told(page)
        x, y = aim(page)
        drag(page, (x, y), (x + 90, y - 60))

        assert aim(page) == pytest.approx((x + 90, y - 60), abs=1.5)
        assert page.get_attribute("#plan .open-view", "d").startswith("M")

        yaw = number(page, "#yaw")
        bearing = float(page.get_attribute("#compass", "aria-valuenow"))
        assert bearing == pytest.approx((90.0 - yaw) % 360.0, abs=0.1)

        tilt = page.get_attribute('#side [data-part="tilt"]', "aria-valuenow")
        assert float(tilt) == pytest.approx(number(page, "#pitch"), abs=0.06)

        page.mouse.up()
        server, held = lines[-1]
        assert len(held) == 1  # the others wait for its answer

        server.send(held[0])
        # The newest step is next.
        page.wait_for_selector("#plan .open-view", state="attached")


@pytest.mark.parametrize(
    "part", ["#yaw-slide", "#compass", '#side [data-part="height"]']
)
def test_escape_gives_up_a_drag_of_slider_compass_and_side_view(visit, part):
    with visit(UNITS[:1]) as page:
        rested(page)
        fields = ("#yaw", "#pitch", "#height")
        before = [number(page, field) for field in fields]
        page.locator(part).scroll_into_view_if_needed()

        def is_turned():
            values = [number(page, field) for field in fields]
            return not np.allclose(values, before, atol=0.2)

        # What arrives between looking and pressing may push the panel down: then the
        # press has met nothing, and a person would press again.
        for _ in range(5):
            x, y = middle(page.locator(part))
            if part == "#yaw-slide":
                box = page.locator(part).bounding_box()
                share = (before[0] + 180.0) / 360.0
                x = box["x"] + 8 + share * (box["width"] - 16)  # the thumb
            away = {"#yaw-slide": (x - 40, y), "#compass": (x - 30, y + 30)}.get(
                part, (x, y + 20)
            )
            drag(page, (x, y), away)
            page.wait_for_timeout(1_000)
            if is_turned():
                break
            page.mouse.up()

        assert is_turned()

        page.keyboard.press("Escape")
        page.mouse.move(away[0] + 5, away[1] - 5, steps=3)
        page.mouse.up()

        for field, value in zip(fields, before, strict=True):
            expect(page.locator(field)).to_have_value(f"{value:g}")
        assert page.is_disabled("#redo")
        assert page.is_disabled("#undo")


WHEEL = """([x, y, given]) => document.querySelector("#plan svg").dispatchEvent(
    new WheelEvent("wheel", {
        clientX: x, clientY: y, bubbles: true, cancelable: true, ...given }))
"""


def test_a_trackpad_pans_while_notches_and_pinches_zoom_about_the_pointer(visit):
    with visit() as page:
        near, far = (
            page.locator(f'[data-site="corner-{name}"]') for name in ("ne", "sw")
        )

        def turned(*events):
            """How far the pole below the pointer has moved, and what distances have
            become.
            """
            (x, y) = middle(near)
            (u, v) = middle(far)
            for given in events:
                page.evaluate(WHEEL, [x, y, given])
            (x2, y2) = middle(near)
            (u2, v2) = middle(far)
            page.wait_for_timeout(400)  # what comes later is another turn
            return (x2 - x, y2 - y), np.hypot(u2 - x2, v2 - y2) / np.hypot(u - x, v - y)

        moved, size = turned({"deltaX": 3, "deltaY": 4}, {"deltaX": 12, "deltaY": 80})

        assert moved == pytest.approx((-15.0, -84.0), abs=1.0)
        assert size == pytest.approx(1.0)

        moved, size = turned({"deltaY": -100})
        assert moved == pytest.approx((0.0, 0.0), abs=1.0)
        assert size == pytest.approx(1.2, rel=0.01)

        moved, size = turned({"deltaY": 3, "deltaMode": 1})  # lines, as Firefox tells
        assert moved == pytest.approx((0.0, 0.0), abs=1.0)
        assert size == pytest.approx(1.0 / 1.2, rel=0.01)

        moved, size = turned(*[{"deltaY": -4, "ctrlKey": True}] * 5)
        assert moved == pytest.approx((0.0, 0.0), abs=1.0)
        assert size == pytest.approx(1.2 ** (20 / 38), rel=0.01)


def test_height_and_tilt_are_dragged_in_the_side_view(visit, tmp_path):
    with visit(UNITS[:1]) as page:
        rested(page)
        grip = page.locator('#side [data-part="height"]')
        grip.scroll_into_view_if_needed()
        low, high = (
            float(grip.get_attribute(f"aria-value{end}")) for end in ("min", "max")
        )
        before = number(page, "#height")
        x, y = middle(grip)
        drag(page, (x, y), (x, y + 24))
        page.mouse.up()

        expect(page.locator("#height")).not_to_have_value(f"{before:g}")

        height = number(page, "#height")
        assert low <= height < before
        assert middle(grip)[1] == pytest.approx(y + 24, abs=1.5)

        x, y = middle(grip)
        drag(page, (x, y), (x, y + 400))  # no lower than the pole carries
        page.mouse.up()

        has_value(page, "#height", f"{low:g}")

        grip.focus()
        grip.press("ArrowUp")
        has_value(page, "#height", f"{low + 0.25:g}")

        (x, y) = middle(grip)
        knob = page.locator('#side [data-part="tilt"]')
        drag(page, middle(knob), (x + 60, y + 60))
        page.mouse.up()

        has_value(page, "#pitch", re.compile("^-4[45]"))

        told(page)
        (unit,) = saved(page, tmp_path).units
        assert unit.pose.pitch_deg == pytest.approx(-45.0, abs=1.5)

        # The picture's lower edge meets the road as far away as its angle says.
        pose = unit.pose
        half = 0.5 * unit.sensor.vertical_fov_deg
        away_m = (low + 0.25) / np.tan(np.radians(half - pose.pitch_deg))
        ray = page.get_attribute("#side .ray-lower", "d")
        x, y, x2, y2 = (float(value) for value in re.findall(r"[\d.]+", ray))

        assert (x2 - x) / (y2 - y) == pytest.approx(away_m / (low + 0.25), rel=1e-3)
        assert high > low


def test_the_compass_turns_in_steps_with_shift_or_by_the_switch(visit):
    with visit(UNITS[:1]) as page:
        rested(page)
        compass = page.locator("#compass")
        compass.scroll_into_view_if_needed()
        x, y = middle(compass)
        drag(page, (x + 30, y), (x + 38, y - 3))

        # A pixel.
        assert float(compass.get_attribute("aria-valuenow")) == pytest.approx(
            85.5, abs=1.0
        )

        page.keyboard.down("Shift")
        page.mouse.move(x + 30, y - 13)
        page.keyboard.up("Shift")

        assert compass.get_attribute("aria-valuetext").startswith(
            "60.0 degrees, north-east"
        )

        page.mouse.up()
        has_value(page, "#yaw", "30")

        page.check("#snap")
        x, y = aim(page)
        drag(page, (x, y), (x + 33, y + 47), (x - 20, y + 90))
        page.mouse.up()
        told(page, "table", "evaluator")

        assert number(page, "#yaw") % 15.0 == 0.0
        assert number(page, "#yaw") != 30.0

        compass.focus()
        yaw = number(page, "#yaw")
        compass.press("ArrowRight")  # clockwise

        has_value(page, "#yaw", f"{yaw - 1:g}")


def test_a_copy_keeps_angles_height_and_lens_on_another_pole(visit, tmp_path):
    (unit,) = UNITS[:1]
    with visit([unit]) as page:
        page.click('[data-chip="RSU0"]')
        page.focus('[data-site="corner-nw"]')
        page.keyboard.press("Enter")
        page.keyboard.press("Control+c")
        page.locator("#notice").get_by_text("RSU0 is copied").wait_for()
        page.keyboard.press("Control+v")

        has_units(page, 2)

        first, second = saved(page, tmp_path).units
        assert first.site_id == "corner-se"
        assert second.site_id == "corner-nw"
        assert second.sensor == first.sensor

        angles = [(each.pose.yaw_deg, each.pose.pitch_deg) for each in (first, second)]
        assert angles[0] == pytest.approx(angles[1])
        assert chosen(page)[0].startswith(second.id)

        page.click("#remove")
        has_units(page, 1)

        page.click("#paste-unit")  # the copy outlives what it is of
        has_units(page, 2)


def test_a_ruler_measures_between_places_and_poles(visit, small_setting):
    places = {site.id: site.position_m[:2] for site in small_setting.scene.sites}
    apart_m = np.hypot(*(places["corner-ne"] - places["corner-sw"]))
    with visit(UNITS[:1]) as page:
        x, y = pole(page, "corner-ne")
        page.keyboard.press("m")
        expect(page.locator("#ruler")).to_have_attribute("aria-pressed", "true")

        drag(page, (x + 3, y), pole(page, "corner-sw"))
        page.mouse.up()
        said = page.locator("#ruler-text")

        expect(said).to_have_text(f"{apart_m:.2f} m")  # poles are met exactly

        page.mouse.click(x - 90, y + 60)
        page.mouse.click(x - 90, y + 160)

        expect(said).to_have_text(re.compile(r"^[\d.]+ m$"))
        assert float(said.inner_text()[:-2]) == pytest.approx(
            100.0 * scale_m(page), rel=0.01
        )

        for name in ("corner-ne", "corner-sw"):
            page.focus(f'[data-site="{name}"]')
            page.keyboard.press("Enter")
        expect(said).to_have_text(f"{apart_m:.2f} m")

        page.keyboard.press("Escape")
        expect(page.locator("#ruler")).to_have_attribute("aria-pressed", "false")
        has_units(page, 1)


def test_what_is_locked_is_not_dragged_turned_or_taken_down(visit, tmp_path):
    with visit(UNITS[:1]) as page:
        page.click('[data-chip="RSU0"]')
        page.keyboard.press("l")

        expect(page.locator("#plan .lock")).to_have_count(1)
        assert page.locator("[data-aim]").count() == 0
        assert "locked" in page.inner_text('[data-chip="RSU0"]')

        for key in ("ArrowLeft", "Delete", "PageUp"):
            page.keyboard.press(key)
        drag(
            page,
            middle(page.locator('[data-unit="RSU0"] circle')),
            pole(page, "corner-sw"),
        )
        page.mouse.up()
        drag(page, middle(page.locator("#compass")), (900.0, 300.0))
        page.mouse.up()
        page.locator("#notice").get_by_text("RSU0 is locked").wait_for()

        assert page.is_disabled("#yaw")
        assert page.is_disabled("#remove")

        (unit,) = saved(page, tmp_path).units
        (before,) = UNITS[:1]

        assert unit.site_id == before.site_id
        assert unit.pose.yaw_deg == before.pose.yaw_deg
        assert page.is_disabled("#undo")

        page.click("#lock")
        page.click("#remove")
        has_units(page, 0)


def test_two_variants_are_compared_by_units_and_cases(visit):
    with visit(UNITS[:3]) as page:
        told(page)
        page.click("#copy-variant")
        page.wait_for_selector("#compare-row")
        page.select_option("#compare", "mine")
        page.locator("#compare-units").get_by_text("The same units").wait_for()
        page.click('[data-chip="RSU2"]')
        page.click("#remove")
        page.click('[data-chip="RSU1"]')
        yaw = number(page, "#yaw")
        write(page.locator("#yaw"), f"{yaw - 40:g}")
        page.press("#yaw", "Enter")
        page.select_option("#site", "corner-sw")
        page.click("#hang")
        said = page.locator("#compare-units li")

        expect(said).to_have_count(3)

        told(page)
        expect(said.nth(0)).to_contain_text("only here, at corner-sw")
        expect(said.nth(1)).to_contain_text("RSU2: only in mine, at corner-nw")
        expect(said.nth(2)).to_contain_text(
            re.compile(r"RSU1: turned by (40|39\.9|40\.1)")
        )
        assert page.locator("#plan .other").count() == 2

        row = page.locator("#compare-points tbody tr").first
        row.get_by_text("APR").wait_for()
        here, there, points = row.locator("td").all_inner_texts()
        if points.startswith("\u2212"):
            sign = -1.0
        else:
            sign = 1.0
        difference = sign * float(re.sub(r"[^\d.]", "", points))

        assert difference == pytest.approx(
            float(here[:-2]) - float(there[:-2]), abs=0.051
        )

        write(page.locator("#variant-name"), "Mine!")  # similar to the other's
        page.press("#variant-name", "Enter")
        page.locator("#notice").get_by_text('is too similar to "mine"').wait_for()


def test_a_lost_run_is_shown_on_the_plan_over_time(visit, small_setting):
    with visit(UNITS[7:8]) as page:
        told(page)
        page.locator("#lost button").first.click()
        strip = page.locator("#played")
        strip.wait_for()
        run_id = page.get_attribute("#lost [aria-pressed=true]", "data-run")
        (run,) = (run for run in small_setting.runs if run.id == run_id)

        assert run.case.title in page.inner_text("#played-title")
        assert re.search(r"(comes nearest|No unit|Lost whatever)", strip.inner_text())

        slider = page.locator("#played-frame")
        assert int(slider.get_attribute("max")) == len(run.time_s) - 1

        def apart_m():
            """Between car and road user as the plan draws them, all at one moment."""
            pixels, bar = page.evaluate(
                """() => { const [a, b] = ["car", "user"].map((who) =>
                    document.querySelector(`.played-${who}`).getBoundingClientRect());
                const bar = document.querySelector('#plan path[d^="M12 "]');
                return [Math.hypot(a.x + a.width / 2 - b.x - b.width / 2,
                    a.y + a.height / 2 - b.y - b.height / 2),
                    [bar.getAttribute("d"), bar.nextElementSibling.textContent]]; }"""
            )
            length = re.search(r"h([\d.]+)$", bar[0])[1]
            metres = bar[1].split()[0]
            return pixels * float(metres) / float(length)

        for frame in (0, len(run.time_s) // 2, len(run.time_s) - 1):
            slider.evaluate(
                """(slider, frame) => { slider.value = frame;
                slider.dispatchEvent(new Event("input")); }""",
                frame,
            )
            true_m = np.hypot(
                *(run.vut_position_m[frame] - run.vru_position_m[frame])[:2]
            )

            assert apart_m() == pytest.approx(true_m, abs=0.7)
            assert f"{abs(run.time_s[frame]):.1f} s" in page.inner_text("#played-time")
        page.click("#played-play")
        page.wait_for_function(
            "() => document.querySelector('#played-frame').valueAsNumber > 3"
        )
        page.click("#played-play")
        row = page.locator('#played-rows [aria-label^="RSU7"]')

        assert re.search("sees the road user", row.get_attribute("aria-label"))

        page.click("#played-close")
        strip.wait_for(state="hidden")
        assert page.is_hidden(".played-car")


# ---------- what a camera sees


def pixels_of(page):
    """The picture as the browser decodes it, (h, w, 3), in grey levels."""
    size, flat = page.evaluate(
        """async () => {
            const image = document.getElementById("seen-image");
            await image.decode();
            const width = image.naturalWidth;
            const height = image.naturalHeight;
            const canvas = document.createElement("canvas");
            Object.assign(canvas, { width, height });
            const context = canvas.getContext("2d");
            context.drawImage(image, 0, 0);
            const levels = context.getImageData(0, 0, width, height).data;
            return [[height, width], [...levels]];
        }"""
    )
    return np.array(flat, dtype=float).reshape(*size, 4)[..., :3]


def test_the_picture_follows_while_a_camera_is_turned_and_is_fine_when_it_stands(
    visit, small_setting, tmp_path, drawn_pictures
):
    unit = UNITS[7]

    with visit([unit]) as page:
        fine = page.locator('#seen[data-smooth="1"][aria-busy="false"]')
        fine.wait_for()
        before = page.get_attribute("#seen-image", "src")
        x, y = middle(page.locator("#compass"))
        page.mouse.move(x, y - 30)
        page.mouse.down()
        page.mouse.move(x + 20, y - 20, steps=4)
        page.wait_for_selector('#seen[data-smooth="0"]')  # the button is still pressed
        during = page.get_attribute("#seen-image", "src")

        assert during != before

        page.mouse.move(x + 25, y + 5, steps=4)
        page.mouse.up()
        fine.wait_for()
        shown = pixels_of(page)

        assert shown.shape == (360, 640, 3)

        (turned,) = saved(page, tmp_path).units
        assert turned.pose.yaw_deg != unit.pose.yaw_deg

        small = replace(
            turned, sensor=replace(turned.sensor, width_px=640, height_px=360)
        )
        expected, run, _ = draw_view(small, small_setting, compute=Compute(workers=2))
        assert abs(shown - expected).mean() < 4.0  # JPEG's own loss

        title = small_setting.runs.index(run)
        assert describe_run(small_setting.axis, title) in page.inner_text("#seen-text")


# ---------- poles of one's own


def screen_of(page, scene, place_m):
    """Where a place of the ground is on the screen, by two poles that are drawn
    there.
    """
    one, other = (
        next(s for s in scene.sites if s.id == name)
        for name in ("corner-ne", "lamp-w2")
    )
    at = [
        np.array(middle(page.locator(f'[data-site="{site.id}"]')))
        for site in (one, other)
    ]
    flip = np.array([1.0, -1.0])
    span_m = (other.position_m - one.position_m)[:2] * flip
    px_per_m = float(np.dot(at[1] - at[0], span_m) / np.dot(span_m, span_m))
    away_m = (np.asarray(place_m, dtype=float) - one.position_m[:2]) * flip
    return tuple(at[0] + px_per_m * away_m)


def test_a_pole_of_ones_own_is_put_moved_saved_and_removed(
    visit, small_setting, tmp_path
):
    scene = small_setting.scene
    corner = next(site for site in scene.sites if site.id == "corner-nw").position_m[:2]
    with visit(may_complain=True) as page:
        page.click("#pole")
        notice = page.locator("#notice")
        page.mouse.click(*screen_of(page, scene, scene.outline_m.mean(axis=0)))

        expect(notice).to_contain_text("a place on the carriageway")

        page.mouse.click(*screen_of(page, scene, corner + [-8.0, 10.0]))
        expect(notice).to_contain_text("a place inside building")

        page.mouse.click(*screen_of(page, scene, corner + [-4.0, 0.0]))
        own = page.locator('[data-site="own-1"]')
        own.wait_for()

        has_value(page, "#site", "own-1")

        page.click("#hang")
        has_value(page, "#unit-site", "own-1")

        told(page)
        (before,) = saved(page, tmp_path).units

        assert before.site_id == ""
        assert before.pose.position_m[:2] == pytest.approx(
            corner + [-4.0, 0.0], abs=0.15
        )

        drag(page, middle(own), screen_of(page, scene, corner + [-7.0, 0.0]))
        page.mouse.up()
        east = page.locator("#pole-east")

        expect(east).to_have_value(re.compile(rf"^{corner[0] - 7.0:.0f}"))

        shown = told(page)
        after = saved(page, tmp_path)
        (unit,) = after.units
        moved_m = unit.pose.position_m - before.pose.position_m

        assert moved_m == pytest.approx([-3.0, 0.0, 0.0], abs=0.3)
        assert unit.pose.yaw_deg == before.pose.yaw_deg

        evaluation = evaluate_layout(after, small_setting, compute=Compute(workers=2))
        assert shown == percent(apr(evaluation.rsu_all, evaluation.axis))

        page.keyboard.press("Escape")
        assert page.get_attribute("#pole", "aria-pressed") == "false"

        page.keyboard.press("Escape")  # no sensor is chosen
        page.keyboard.press("Delete")
        expect(notice).to_contain_text("which carries U1 of")

        plan = downloaded(page, "#save-plan", tmp_path / "plan.json")
        page.click('[data-chip="U1"]')
        page.click("#remove")

        has_units(page, 0)

        page.click("#remove-pole")
        own.wait_for(state="detached")
        page.set_input_files("#open-file", plan)  # all is there again
        own.wait_for()
        page.click('[data-chip="U1"]')

        has_value(page, "#unit-site", "own-1")


# ---------- where it is still dangerous


def test_the_heat_layer_has_the_weight_of_lost_runs_around_each_place(
    visit, small_setting
):
    units = UNITS[6:7]
    evaluation = evaluate_layout(
        Layout(name="mine", units=units), small_setting, compute=Compute(workers=2)
    )
    axis = evaluation.axis
    is_lost = [one != "avoided" for one in run_outcomes(evaluation.rsu_all, axis)]
    ends_cm = (
        np.array([run.vru_position_m[-1] for run in small_setting.runs])[is_lost]
        * 100.0
    )
    weight = axis.weight[is_lost] / axis.weight.sum()

    assert 0 < len(weight) < axis.n_runs

    least = np.array([0.1, 0.05, 0.02, 0.01, 0.005, 0.0])
    west, south = np.floor(ends_cm.min(axis=0) / 50.0).astype(int) * 50 - 250
    east, north = ends_cm.max(axis=0).astype(int) + 250
    places = np.stack(
        np.meshgrid(range(west + 25, east, 50), range(south + 25, north, 50)), -1
    )
    away_cm = np.hypot(*np.moveaxis(places[:, :, None] - np.rint(ends_cm), -1, 0))
    expected = (away_cm < 200.0) @ weight
    # On the edge of a disc, or between two bands, either is right.
    is_edge = (np.abs(away_cm - 200.0) < 1e-6).any(axis=-1)
    is_close = (np.abs(expected[..., None] - least) <= 1e-6).any(axis=-1)
    with visit(units) as page:
        told(page)
        assert page.is_hidden("#danger-key")

        page.check("#danger")
        bands = page.locator("#plan [data-band]")
        page.locator("#danger-key").filter(has_text=f"{len(weight)}, with").wait_for()
        drawn = np.full(expected.shape, -1)
        paths = bands.evaluate_all(
            "all => all.map(one => [one.dataset.band, one.getAttribute('d')])"
        )
        for band, d in paths:
            corners = np.array(re.findall(r"M(-?\d+) (-?\d+)h50v50h-50Z", d), dtype=int)
            column, row = (corners - (west, south)).T // 50
            drawn[row, column] = int(band)

        assert (drawn >= 0).any()
        np.testing.assert_array_equal(
            (drawn >= 0)[~is_edge], (expected > 0.0)[~is_edge]
        )

        is_sure = (drawn >= 0) & ~is_edge & ~is_close
        band = (expected[..., None] > least).argmax(axis=-1)
        np.testing.assert_array_equal(drawn[is_sure], band[is_sure])

        fills = page.locator("#danger-key rect").evaluate_all(
            "all => all.map(one => one.getAttribute('fill'))"
        )
        parts = np.array(
            [[int(fill[at : at + 2], 16) for at in (1, 3, 5)] for fill in fills]
        )
        grey = parts @ [0.2126, 0.7152, 0.0722]

        assert (np.diff(grey) > 10.0).all()  # told apart in grey: the darker the more

        page.uncheck("#danger")
        expect(bands).to_have_count(0)


# ---------- another junction


@pytest.fixture(scope="module")
def streets(tmp_path_factory):
    """Three junctions along a street, and one that cars can only leave."""
    path = write_city(tmp_path_factory.mktemp("city"))
    away = OsmText()
    away.n_parts = 1000
    start = away.node(250.0, 400.0)
    for place in (
        (340.0, 400.0),
        (160.0, 400.0),
        (250.0, 490.0),
    ):
        away.road([start, place], name="Far Street", oneway="yes")
    text = path.read_text().replace("</osm>\n", "\n".join([*away.parts, "</osm>\n"]))
    path.write_text(text)
    return path


def test_a_junction_is_chosen_on_a_map_of_streets_by_name_by_keyboard_and_again(
    visit, streets
):
    def view(page):
        box = page.get_attribute("#map-choice .street-map", "viewBox")
        return [float(word) for word in box.split()]

    named = MapFile(path=streets, name="tiny.osm")
    with visit(map_file=named) as page:
        page.click("#another-junction")
        page.wait_for_selector("#map-choice .junction-chooser")
        assert page.inner_text("#map-text") == "tiny.osm has 4 junctions."

        shown = page.locator("#map-choice text:not([display=none])").all_text_contents()
        assert {"Main Street", "A Lane", "B Lane", "C Lane"} <= set(shown)

        grey = page.locator("#map-choice circle.unusable")
        expect(grey).to_have_count(1)

        grey.click()
        status = page.locator("#map-choice .map-count")

        assert status.inner_text().startswith("No car can enter the junction")
        assert page.locator("#map-choice circle.chosen:not(.unusable)").count() == 1

        whole = view(page)
        middle_ = middle(page.locator("#map-choice .street-map"))
        page.mouse.move(*middle_)
        page.mouse.wheel(0, -300)
        page.wait_for_function(
            "width => document.querySelector('.street-map').viewBox.baseVal.width <"
            " width",
            arg=0.9 * whole[2],
        )

        assert view(page)[0] + view(page)[2] / 2 == pytest.approx(whole[2] / 2, abs=1.0)

        page.focus("#map-choice .street-map")
        before = view(page)
        page.keyboard.press("ArrowRight")

        assert view(page)[0] > before[0]

        page.keyboard.press("0")
        assert view(page) == whole

        page.focus(".map-find")  # all by keyboard from here on
        page.keyboard.type("lane main c")
        assert status.inner_text() == "1 / 4"

        page.keyboard.press("Enter")  # to the row, then choose it
        page.keyboard.press("Enter")
        row = page.locator("#map-choice li button[aria-pressed=true]")

        assert row.inner_text().split("\n")[0] == "C Lane / Main Street"
        assert page.locator("#map-choice circle.chosen").count() == 1

        page.press("#map-take", "Enter")
        page.wait_for_selector("#map-dialog", state="hidden")
        assert page.inner_text("#scene-name").startswith("at C Lane / Main Street,")

        page.click("#another-junction")
        page.wait_for_selector("#map-choice .junction-chooser")
        # Nothing is mounted.
        assert "Undo leads back" not in page.inner_text("#map-text")


def test_reading_a_map_tells_how_far_it_is_and_is_stopped(visit, streets, monkeypatch):
    def slow(self, *given, **options):
        for done in range(300):
            self._progress("read buildings", done, 300)
            time.sleep(0.1)

    monkeypatch.setattr(Tasks, "import_junction", slow)
    named = MapFile(path=streets, name="tiny.osm")
    with visit(map_file=named, may_complain=True) as page:  # of a request stopped
        page.click("#another-junction")
        page.click("#map-take:enabled")
        doing = page.locator("#map-doing")
        said = (
            r"read buildings, \d+ of 300: \d+ s so far; this step takes about \d+ s"
            r" more\."
        )

        expect(doing).to_have_text(re.compile(said))
        assert 0 < page.locator("#map-bar").evaluate("bar => bar.position") < 1

        before = page.inner_text("#scene-name")
        page.click("#map-stop")
        page.wait_for_selector("#map-dialog", state="hidden")

        assert page.inner_text("#scene-name") == before

        page.click("#another-junction")  # it is there again, without being read
        page.wait_for_selector("#map-take:enabled")


# ---------- tiles of a server


@pytest.fixture
def tile_server():
    """A server of tiles: each has a colour of its own; what was asked for is
    remembered.
    """
    asked = []

    class Answers(BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
            _, x, y = map(
                int, self.path.removeprefix("/aerial/").removesuffix(".png").split("/")
            )
            if self.server.is_down:
                self.send_error(404)
                return
            file = io.BytesIO()
            Image.new("RGB", (256, 256), colour_of(x, y)).save(file, "PNG")
            self.send_response(200)
            self.send_header("content-type", "image/png")
            self.end_headers()
            self.wfile.write(file.getvalue())

        def log_message(self, *words):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Answers)
    server.is_down = False
    server.asked = asked
    Thread(target=server.serve_forever, daemon=True).start()
    yield server
    server.shutdown()
    server.server_close()


def colour_of(x, y):
    """Colour of a tile: red, green, blue."""
    return 60 + 90 * (x % 2), 60 + 90 * (y % 2), 200


def test_tiles_lie_at_their_places_and_one_that_does_not_come_is_told(
    browser, serve, tile_server, tmp_path
):
    host = f"127.0.0.1:{tile_server.server_port}"
    template = f"http://{host}/aerial/{{z}}/{{x}}/{{y}}.png"
    scene = load_study_scene()
    tiles = read_tile_server(template, "(c) the test's own")
    server = serve(tiles=tiles)
    to_mercator = Transformer.from_crs(scene.crs, "EPSG:3857", always_xy=True)
    span_m = 2.0 * np.pi * 6378137.0

    def corners_m(key):
        z, x, y = map(int, key.split("/"))
        east = span_m * (np.array([x, x + 1, x]) / 2**z - 0.5)
        north = span_m * (0.5 - np.array([y, y, y + 1]) / 2**z)
        return np.column_stack(to_mercator.transform(east, north, direction="INVERSE"))

    with opened(browser, server, foreign=(host,), may_complain=True) as page:
        page.wait_for_function(
            "() => { const all = [...document.querySelectorAll('[data-tile]')];"
            " return all.length && all.every(one => 'loaded' in one.dataset); }"
        )
        assert page.inner_text("#attribution") == "(c) the test's own"

        drawn = page.locator("[data-tile]").evaluate_all(
            "all => all.map(one => [one.dataset.tile, one.getAttribute('transform')])"
        )
        assert len(drawn) >= 4

        for key, transform in drawn:
            words = transform.removeprefix("matrix(").removesuffix(")").split()
            a, b, c, d, e, f = map(float, words)
            places_m = (
                np.array(
                    [
                        [e, f],
                        [e + a, f + b],
                        [e + c, f + d],
                    ]
                )
                / 100.0
            )
            away_m = np.abs(places_m - corners_m(key)).max()
            assert away_m < 0.5
        # What is seen at a place of the plan has the colour of the tile that holds it.
        page.locator("#tiles-opacity").fill("100")
        page.evaluate(
            "document.querySelectorAll('#plan svg > g > g:not(:has([data-tile]))')"
            ".forEach(one => { one.style.display = 'none'; })"
        )
        picture = Image.open(io.BytesIO(page.locator("#plan").screenshot())).convert(
            "RGB"
        )
        window = page.locator("#plan svg > g").first.get_attribute("transform")
        per_cm, _, _, _, east_px, north_px = map(
            float, window.removeprefix("matrix(").removesuffix(")").split()
        )
        n_checked = 0
        for px, py in np.random.default_rng(3).integers(60, 400, (40, 2)).tolist():
            place_m = np.array([px - 1 - east_px, north_px - (py - 1)]) / per_cm / 100.0
            merc = np.array(to_mercator.transform(*place_m))
            z = int(drawn[0][0].split("/")[0])
            column, row = (
                np.array([merc[0] / span_m + 0.5, 0.5 - merc[1] / span_m]) * 2**z
            )
            if min(abs(column - round(column)), abs(row - round(row))) < 0.03:
                continue  # on an edge
            found = np.array(picture.getpixel((px, py)), dtype=int)
            assert np.abs(found - colour_of(int(column), int(row))).max() <= 3

            n_checked += 1

        assert n_checked > 10

        # Tiles that do not come are told once.
        tile_server.is_down = True
        page.click("#farther", click_count=3)
        expect(page.locator("#notice")).to_contain_text(
            f"Some tiles from {host} did not load"
        )

        page.uncheck("#tiles")
        expect(page.locator("[data-tile]")).to_have_count(0)
        assert page.is_hidden("#attribution")

    assert tile_server.asked


# ---------- in another language

SAID = """() => {
    const found = [], walk = document.createTreeWalker(document.documentElement, 4);
    while (walk.nextNode()) {
        const { parentElement, data } = walk.currentNode;
        if (!parentElement.closest("script, style, code, noscript")) found.push(data);
    }
    const names = ["title", "aria-label", "placeholder", "alt", "aria-valuetext"];
    for (const name of names) {
        for (const one of document.querySelectorAll(`[${name}]`)) {
            found.push(one.getAttribute(name));
        }
    }
    return [...new Set(found)]; }"""
KEYS = {*"lnop"}
NAMES = {
    "mine",
    "other",
    "garden",
    "crossing.osm",
    "Mill",
    "Street",
    "Station",
    "Road",
    *KEYS,
}
NAMES |= {*load_case_sets(), *WEIGHT_WORDS}


def test_no_word_of_the_page_is_left_over(
    browser, serve, garden, small_setting, tmp_path
):
    """The page speaks a language made up: all that it says at any of these moments is
    in it.
    """
    scene = small_setting.scene
    units = UNITS[6:8]
    texts = {}

    def look(page, moment):
        for text in page.evaluate(SAID):
            texts.setdefault(text, moment)

    with speaking("de", Bracketed()):
        server = serve(units, asked={"no_look": str(garden)})
        with opened(browser, server, may_complain=True) as page:
            assert page.get_attribute("html", "lang") == "de"
            assert re.fullmatch(r"\d+,\d %", told(page))

            look(page, "first screen")
            page.locator("#lost button").first.click()
            page.wait_for_selector("#played")
            look(page, "lost run")
            page.click("#played-why")
            page.locator("#run-why li").first.wait_for()
            look(page, "its reasons")
            page.click("#picture-show")

            expect(page.locator("#picture")).to_be_visible(timeout=PATIENCE_MS)

            look(page, "its picture")
            page.keyboard.press("Escape")
            page.click("#copy-variant")
            write(page.locator("#variant-name"), "other")
            page.press("#variant-name", "Enter")
            page.select_option("#compare", "mine")
            for name, by in (
                ("yaw", 40),
                ("pitch", 5),
                ("height", -1),
            ):
                write(
                    page.locator(f"#{name}"), f"{round(number(page, f'#{name}') + by)}"
                )
                page.press(f"#{name}", "Enter")
            page.select_option("#site", "corner-sw")
            page.click("#hang")
            for box in ("#coverage", "#danger"):
                page.locator(box).check()
            told(page)
            row = page.locator("#compare-points tbody tr").first
            row.wait_for()
            cells = row.locator("td").all_inner_texts()
            here, there, by = (
                re.sub(r"[^\d,]", "", text).replace(",", ".") for text in cells
            )

            assert float(by) == pytest.approx(
                abs(float(here) - float(there)), abs=0.051
            )

            page.locator("#coverage-key svg").first.wait_for()
            look(page, "variants, density and dangers")
            page.click('[data-ask="next"]')
            page.locator("#proposals p").get_by_text("%").first.wait_for()
            look(page, "a proposal")
            page.click("#pole")
            page.mouse.click(*screen_of(page, scene, scene.outline_m.mean(axis=0)))
            # An earlier notice may still stand there.
            refusal = re.compile("⟦pole⟧.*⟦a place on the carriageway⟧")

            expect(page.locator("#notice")).to_contain_text(refusal)

            look(page, "a refusal")
            page.keyboard.press("Escape")
            page.click("#lock")
            page.keyboard.press("Delete")
            page.click("#lock")
            page.keyboard.press("Control+c")
            look(page, "locks and copies")
            drop(page, "crossing.osm", CROSSING.read_text())
            page.wait_for_selector("#map-choice .junction-chooser")
            look(page, "a map")
            page.keyboard.press("Escape")
            server.stop()
            page.wait_for_selector("#connection:not([hidden])")
            look(page, "no connection")

    assert len(texts) > 300

    words = {text: set(left_over(text)) - NAMES for text in texts}
    assert [(texts[text], text) for text in texts if words[text]] == []
