"""The report's interactive part in a browser, where there is one."""

import json
import re

import numpy as np
import pytest
from browser_pages import open_page
from interactive_pages import (
    EVIL,
    build_evaluation,
    build_layout,
    page_around,
    with_evil_names,
)
from packed_bits import unpack_bits

from experiments.language import speaking
from experiments.parts.player import interactive_part
from experiments.report.page import page_environment

# In a browser, which takes long. What the page is made of, quickly:
# test_player.py
pytestmark = [pytest.mark.system, pytest.mark.long]


FRAME = "document.getElementById('player-frame')"


@pytest.fixture(scope="module")
def part(small_setting):
    """The interactive part for two layouts."""
    evaluation = build_evaluation(
        small_setting, build_layout(5), share=0.3, with_vam=True
    )
    other = build_evaluation(small_setting, build_layout(2, name="other"), seed=3)
    return interactive_part(small_setting, {"ours": evaluation, "other": other})


@pytest.fixture(scope="module")
def address(part, tmp_path_factory):
    return write_page(part, tmp_path_factory.mktemp("page"))


def write_page(part, folder):
    """Address of a page around an interactive part."""
    path = folder / "page.html"
    path.write_text(page_around(part))
    return path.as_uri()


def seconds(milliseconds):
    """A time as the player writes it."""
    if milliseconds < 0:
        sign = "\N{MINUS SIGN}"
    else:
        sign = ""
    return f"{sign}{abs(milliseconds) / 1000.0:.2f}"


def go_to(page, frame):
    """Move the player's slider to a frame."""
    page.evaluate(f"{FRAME}.value = {frame}; {FRAME}.dispatchEvent(new Event('input'))")


def test_the_player_shows_what_the_records_say(browser, address, part):
    data = json.loads(part["player_json"])
    fused = [party["kind"] for party in data["parties"]].index("rsu_all")
    with open_page(browser, address) as page:
        assert page.locator("#player-run option").count() == len(data["runs"])
        for index, run in enumerate(data["runs"]):
            page.select_option("#player-run", str(index))
            last = max(
                frame for frame, ms in enumerate(run["time"]) if ms <= run["last"]
            )

            assert page.evaluate(f"Number({FRAME}.value)") == last
            assert (
                page.locator("#player-timeline .mark.last")
                .inner_text()
                .endswith(f"{seconds(run['last'])} s")
            )

            n_marks = page.locator("#player-timeline .mark").count()
            assert n_marks == 1 + (run["confirmed"][fused] is not None) + (
                run["onset"][fused] is not None
            )

            for frame in (0, last, len(run["time"]) - 1):
                go_to(page, frame)
                ms = run["time"][frame]
                assert (
                    page.get_attribute("#player-frame", "aria-valuetext")
                    == f"{seconds(ms)} s"
                )

                words = page.inner_text("#player-status")
                left = run["last"] - ms
                if left >= 0:
                    expected = f"{seconds(left)} s left until"
                else:
                    expected = f"{seconds(-left)} s ago"

                assert expected in words
                assert words.startswith("Impact." if ms == 0 else f"{seconds(ms)} s.")


def test_car_road_user_and_collision_are_in_sight_in_every_run(browser, address, part):
    data = json.loads(part["player_json"])
    with open_page(browser, address) as page:
        assert page.evaluate("document.getElementById('player-run').value") == str(
            data["first"]
        )
        for index in range(len(data["runs"])):
            page.select_option("#player-run", str(index))
            for jump in ("", f"{FRAME}.value = {FRAME}.max;"):
                outside = page.evaluate(
                    f"""() => {{
                    {jump} {FRAME}.dispatchEvent(new Event('input'));
                    const svg = document.querySelector('#player-plan svg');
                    const frame = svg.getBoundingClientRect();
                    return [...svg.querySelectorAll('polygon')]
                        .filter((body) => !body.querySelector('title'))
                        .map((body) => body.getBoundingClientRect())
                        .filter((box) => box.left < frame.left || box.top < frame.top
                            || box.right > frame.right || box.bottom > frame.bottom)
                        .length;
                    }}"""
                )
                assert outside == 0, data["runs"][index]["id"]


def test_units_light_up_in_just_the_frames_in_which_they_detect(browser, address, part):
    data = json.loads(part["player_json"])
    n_units = len(data["units"])
    with open_page(browser, address) as page:
        run = data["runs"][1]
        page.select_option("#player-run", "1")
        bits = unpack_bits(run["bits"], n_rows=len(data["parties"]), n=len(run["time"]))
        shown = page.evaluate(
            f"""() => [...Array({len(run["time"])}).keys()].map((frame) => {{
                {FRAME}.value = frame; {FRAME}.dispatchEvent(new Event('input'));
                return [...document.querySelectorAll('.unit')].map((unit) =>
                    ['detects', 'confirmed'].map(
                        (name) => unit.classList.contains(name)));
            }})"""
        )
        lit = np.array(shown).transpose(2, 1, 0)

        assert (lit[0] == bits[1 : n_units + 1]).all()
        assert lit[0].any()
        assert not lit[0].all()

        times = np.array(run["time"])
        for unit, confirmed in zip(lit[1], run["confirmed"][1:], strict=False):
            if confirmed is not None:
                expected = times >= confirmed
            else:
                expected = np.zeros(len(times), bool)
            assert (unit == expected).all()
        # The heatmap's rows, too: what they cover is as long as the detections.
        page.click("#player-details summary")
        page.wait_for_selector("#player-table tbody tr")

        assert page.locator("#player-table tbody tr").count() == len(data["parties"])

        for index, row in enumerate(page.locator("#player-table tbody tr").all()):
            never = "never" in row.locator("td").first.inner_text()
            assert never == (not bits[index].any())


def test_the_player_runs_and_stops_by_the_keyboard_alone(browser, address):
    with open_page(browser, address) as page:
        go_to(page, 0)
        page.focus("#player-play")
        page.keyboard.press("Enter")

        assert page.inner_text("#player-play") == "Pause"

        page.wait_for_function(f"Number({FRAME}.value) >= 3")
        page.keyboard.press("Enter")
        assert page.inner_text("#player-play") == "Play"

        page.focus("#player-frame")
        before = page.evaluate(f"Number({FRAME}.value)")
        page.keyboard.press("ArrowRight")

        assert page.evaluate(f"Number({FRAME}.value)") == before + 1

        go_to(page, page.evaluate(f"Number({FRAME}.max) - 1"))
        page.select_option("#player-speed", "2")
        page.click("#player-play")
        page.wait_for_function(
            "document.getElementById('player-play').textContent === 'Play'"
        )

        assert page.inner_text("#player-status").startswith("Impact.")


def test_nothing_moves_by_itself_where_motion_is_not_wanted(browser, address):
    with open_page(browser, address, reduced_motion="reduce") as page:
        go_to(page, 0)
        assert page.inner_text("#player-play") == "Next frame"

        page.click("#player-play")
        page.wait_for_timeout(300)
        assert page.evaluate(f"Number({FRAME}.value)") == 1


@pytest.mark.parametrize("width", [360, 1280])
def test_the_page_is_no_wider_than_the_screen(browser, address, width):
    with open_page(browser, address, width=width) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        for name in ("#player-plan svg", "#player-heatmap svg"):
            assert page.locator(name).bounding_box()["width"] > 0.25 * width


def test_tables_sort_by_numbers_with_units_and_back(browser, address):
    def order(page):
        return page.locator("#sorted tbody th").all_inner_texts()

    with open_page(browser, address) as page:
        original = order(page)
        name, price, spare = page.locator("#sorted thead button").all()
        price.click()

        assert order(page) == ["unit 9", "a unit", "unit 10", "unit 1"]
        assert (
            page.locator("#sorted th[aria-sort=ascending]")
            .inner_text()
            .startswith("price")
        )

        price.click()
        assert order(page) == ["unit 10", "a unit", "unit 9", "unit 1"]

        price.click()
        assert order(page) == original
        assert page.locator("#sorted [aria-sort]").count() == 0

        name.focus()
        page.keyboard.press("Enter")
        assert order(page) == ["a unit", "unit 1", "unit 9", "unit 10"]

        spare.click()
        assert order(page) == ["unit 9", "unit 1", "unit 10", "a unit"]
        assert page.locator("#sorted [aria-sort]").count() == 1


GERMAN = """<table id="sorted"><thead><tr><th scope="col">Name</th>
<th scope="col">Preis</th>
<th scope="col">Reserve</th></tr></thead><tbody>
<tr><th scope="row">Ä</th><td>1.200,5 EUR</td><td>vermieden, 0,30 s</td></tr>
<tr><th scope="row">B</th><td>\N{MINUS SIGN}5,5 EUR</td>
<td>AUFPRALL, wieder verloren</td></tr>
<tr><th scope="row">Z</th><td>nie</td><td>AUFPRALL, 0,20 s zu spät</td></tr>
<tr><th scope="row">C</th><td>90 EUR</td><td>vermieden, 1,10 s</td></tr>
</tbody></table>"""


def test_tables_and_the_player_speak_german(browser, part, tmp_path):
    with speaking("de"):
        page = page_around(part).replace('<html lang="en">', '<html lang="de">')
        words = page_environment().get_template("words.html.j2").render()
    page = re.sub(r'<table id="sorted">.*</table>', GERMAN, page, flags=re.S)
    path = tmp_path / "page.html"
    path.write_text(page.replace("<main>", f"{words}<main>"))
    with open_page(browser, path.as_uri()) as opened:
        for head, wanted in (
            ("Name", "ÄBCZ"),
            ("Preis", "BCÄZ"),
            ("Reserve", "BZÄC"),
        ):
            opened.locator("#sorted thead button", has_text=head).click()
            assert (
                "".join(opened.locator("#sorted tbody th").all_inner_texts()) == wanted
            )
        status = opened.inner_text("#player-status")

        assert re.match(r"(\W?\d+,\d\d s|Aufprall)\. ", status)
        assert "Sensor" in status
        assert opened.inner_text("#player-play") == "Abspielen"


def test_without_scripts_a_line_says_what_is_missing(browser, address):
    with open_page(browser, address, java_script_enabled=False) as page:
        assert "Scripts are disabled" in page.inner_text("main")
        assert not page.is_visible("#watch")
        assert page.is_visible("#sorted")


def test_print_shows_the_last_moment_and_no_controls(browser, address, part):
    data = json.loads(part["player_json"])
    run = data["runs"][data["first"]]
    last = max(frame for frame, ms in enumerate(run["time"]) if ms <= run["last"])
    with open_page(browser, address) as page:
        go_to(page, 0)
        page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
        page.emulate_media(media="print")

        assert page.evaluate(f"Number({FRAME}.value)") == last
        assert not page.is_visible("#player-play")
        assert page.is_visible("#player-plan svg")

        page.evaluate("window.dispatchEvent(new Event('afterprint'))")
        assert page.evaluate(f"Number({FRAME}.value)") == 0


def test_names_are_shown_and_never_run(browser, small_setting, tmp_path):
    setting = with_evil_names(small_setting)
    name = EVIL.replace("\u2028", "")
    layout = build_layout(2, name=name, ids=[f"{name}{index}" for index in range(2)])
    evaluation = build_evaluation(setting, layout)
    page_address = write_page(
        interactive_part(setting, {name: evaluation, f"{name} 2": evaluation}), tmp_path
    )
    with open_page(browser, page_address) as page:
        page.click("#player-details summary")
        page.wait_for_selector("#player-table tbody tr")
        assert name in page.inner_text("#player-table")


def test_many_units_are_drawn(browser, part_of_many, tmp_path):
    page_address = write_page(part_of_many, tmp_path)
    with open_page(browser, page_address, width=360) as page:
        assert page.locator(".unit").count() == 200
        assert " of 200 units detect" in page.inner_text("#player-status")
        assert page.evaluate("document.documentElement.scrollWidth") <= 360
