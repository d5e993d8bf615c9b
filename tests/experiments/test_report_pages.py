"""Whole reports in a browser: on a phone, by keyboard, to a screen reader, and on
paper.
"""

import shutil
import subprocess
from dataclasses import replace

import pytest
from browser_pages import open_page
from interactive_pages import EVIL, build_evaluation, build_layout, with_evil_names
from partial_pages import blank_pictures, build_result
from small_results import lay_runs_of

from experiments.figures.axes import NARROW_IN
from experiments.jobs.evaluation import run_comparison, run_evaluation
from experiments.progress import StageProgress
from experiments.report.page import write_report
from placement.compute import Compute
from placement.layout import Layout, layout_records, load_carlancap_layout
from placement.question import Question

# In a browser, which takes long. What the page is made of, quickly:
# report/test_page.py
pytestmark = [pytest.mark.system, pytest.mark.long]


KINDS = ("placement", "comparison", "missed", "many")
"""Of an optimised layout, of two, of one that misses runs, and of one of 200 units."""
MAX_BYTES = 8_000_000
LEAST_CONTRAST = 4.5
"""WCAG 2.2, success criterion 1.4.3, of letters of any size."""


@pytest.fixture(scope="module")
def addresses(small_setting, whole_placement, tmp_path_factory):
    """Reports of every kind, by name: files."""
    folder = tmp_path_factory.mktemp("reports")
    common = {
        "compute": Compute(workers=2),
        "command": "place-rsus",
        "progress": StageProgress(),
    }
    units = load_carlancap_layout().units
    few = Layout(name="few", units=units[1:4])
    turned = replace(units[0].pose, yaw_deg=units[0].pose.yaw_deg + 180.0)
    away = Layout(name="away", units=(replace(units[0], pose=turned),))
    with pytest.MonkeyPatch.context() as patch:
        lay_runs_of(patch, small_setting)
        question = Question()
        with blank_pictures():
            run_evaluation(question, layout=away, out=folder / "missed", **common)
            asked = Question(samples=3)
            out = folder / "comparison"
            run_comparison(asked, layouts=[few, away], out=out, **common)
    name = EVIL.replace("\u2028", "")
    setting = with_evil_names(small_setting)
    layout = build_layout(
        200, name=name, ids=[f"{name}{index}" for index in range(200)]
    )
    evaluation = build_evaluation(setting, layout, share=0.05)
    result = build_result(name, layout_records(layout), runs=len(setting.runs))
    (folder / "many").mkdir()
    with blank_pictures():
        write_report(folder / "many", result, setting, {name: evaluation}, command=EVIL)
    placed = {"placement": whole_placement / "results/latest/report.html"}
    return {kind: folder / kind / "report.html" for kind in KINDS} | placed


@pytest.fixture(params=KINDS)
def address(request, addresses):
    return addresses[request.param].as_uri()


def texts(page, selector):
    """Texts of elements, in words."""
    return [
        " ".join(text.split()) for text in page.locator(selector).all_text_contents()
    ]


def test_every_kind_is_small_and_tells_what_it_is_about(browser, addresses):
    headings = {}
    for kind, path in addresses.items():
        assert path.stat().st_size < MAX_BYTES, kind
        with open_page(browser, path.as_uri()) as page:
            headings[kind] = texts(page, "h2")
            assert page.is_visible("#player-plan svg")

    assert {
        "Runs that are not avoided",
    } <= set(headings["placement"])
    assert {"Side by side", "If the world is not as planned"} <= set(
        headings["comparison"]
    )
    for kind in ("missed", "many"):
        assert {"If a unit or a pole fails"} <= set(headings[kind])
        assert "Runs that are not avoided" not in headings[kind]


def test_runs_that_are_missed_are_told_where_there_are_any(browser, addresses):
    for kind, is_told in (
        ("missed", True),
        ("many", False),
    ):
        with open_page(browser, addresses[kind].as_uri()) as page:
            assert ("with an impact" in " ".join(texts(page, "summary"))) == is_told


def test_on_a_phone_letters_are_large_and_nothing_scrolls_sideways(browser, address):
    with open_page(browser, address, width=360, reduced_motion="reduce") as page:
        assert page.get_attribute("#contents", "open") is None

        check_letters_are_no_smaller_than_9_pixels(page)
        check_contents_lead_to_every_section(page)
        check_nothing_scrolls_sideways_even_if_all_is_unfolded(page)


def check_nothing_scrolls_sideways_even_if_all_is_unfolded(page):
    for _ in range(2):
        assert page.evaluate("document.documentElement.scrollWidth") <= 360
        page.evaluate(
            "document.querySelectorAll('details').forEach((d) => { d.open = true; })"
        )
    # What is wider than the screen moves in a box of its own, which the tab key
    # reaches. The page marks the boxes once it has laid them out: a busy machine takes
    # a while.
    boxes = "[...document.querySelectorAll('.scroll')]"
    wide = f"{boxes}.filter((box) => box.scrollWidth > box.clientWidth + 1)"
    assert page.evaluate(f"{wide}.length") > 0
    page.wait_for_function(f"{wide}.every((box) => box.tabIndex === 0)", timeout=10_000)
    assert page.evaluate(
        f"{wide}.every((box) => getComputedStyle(box).overflowX === 'auto' &&"
        " box.ariaLabel)"
    )


def test_rows_are_named_in_sight_when_a_table_is_moved(browser, addresses):
    with open_page(browser, addresses["placement"].as_uri(), width=360) as page:
        lefts = page.evaluate(
            """() => [...document.querySelectorAll('.scroll:has(> table)')]
                .filter((box) => box.scrollWidth > box.clientWidth + 1)
                .map((box) => {
                    box.scrollLeft = box.scrollWidth;
                    const head = box.querySelector('tbody th');
                    return [box.scrollLeft,
                        head.getBoundingClientRect().left
                        - box.getBoundingClientRect().left];
                })"""
        )
    assert len(lefts) > 3
    for scrolled_px, left_px in lefts:
        assert scrolled_px > 0
        assert abs(left_px) < 1.0


def check_letters_are_no_smaller_than_9_pixels(page):
    for width_in, shown_px in page.evaluate(
        """() => [...document.querySelectorAll('figure')].map((figure) => [
            Number(figure.style.getPropertyValue('--phone-width-in')
                || figure.style.getPropertyValue('--width-in')),
            figure.querySelector('img').getBoundingClientRect().width])"""
    ):
        assert 8.0 / 72.0 * shown_px / width_in >= 8.99  # letters of 8 pt


def check_contents_lead_to_every_section(page):
    assert texts(page, "#contents a") == texts(page, "main h2")
    page.click("#contents summary")
    for link in page.locator("#contents a").all():
        link.click()
        target = page.locator(f"{link.get_attribute('href')}")
        top = target.bounding_box()["y"]
        at_end = page.evaluate(
            "innerHeight + scrollY >= document.body.scrollHeight - 2"
        )
        assert -1.0 <= top < 60.0 or (at_end and 0.0 <= top < 900.0)
    assert (
        page.evaluate("getComputedStyle(document.documentElement).scrollBehavior")
        == "auto"
    )


def test_a_link_to_a_folded_section_opens_it(browser, addresses):
    with open_page(browser, addresses["placement"].as_uri() + "#cases") as page:
        assert page.locator("details.part[open]").count() == 1
        assert page.is_visible("details.part[open] #cases")
        assert page.locator("details.part:not([open])").count() > 4


def test_the_first_screen_needs_no_script_and_is_on_the_first_screen(
    browser, addresses
):
    path = addresses["placement"]
    with open_page(browser, path.as_uri(), java_script_enabled=False) as page:
        lowest = page.locator(".overview").bounding_box()
        assert lowest["y"] + lowest["height"] < 1150

        # Letters of the plan's legend, of 8 pt in a figure that is 4 inches wide.
        plan = page.locator(".overview figure img").bounding_box()
        assert 8.0 / 72.0 * plan["width"] / NARROW_IN >= 11.0
        assert page.locator(".cards > div").count() == 5
    text = path.read_text()

    assert text.index("</header>") < 1_500_000


def test_contents_without_scripts_name_no_section_that_is_missing(browser, addresses):
    path = addresses["missed"]
    with open_page(browser, path.as_uri(), java_script_enabled=False) as page:
        links = page.locator("#contents a").all()
        shown = [link.get_attribute("href") for link in links if link.is_visible()]

        assert len(shown) > 8
        assert all(page.is_visible(target) for target in shown)
        assert "#watch" not in shown


FAULTS = """() => {
    const faults = [];
    const all = (selector) => [...document.querySelectorAll(selector)];
    const check = (holds, what, element) => {
        const shown = element ? element.outerHTML.slice(0, 120) : '';
        if (!holds) faults.push(`${what}: ${shown}`);
    };
    const named = (element) => Boolean(
        element.getAttribute('aria-label')
        || element.labels?.length
        || element.textContent.trim()
        || element.getAttribute('aria-labelledby'));
    check(document.documentElement.lang === 'en', 'language');
    check(document.title, 'title');
    for (const one of ['h1', 'header', 'nav', 'main', 'footer'])
        check(all(one).length === 1, `one ${one}`);
    let level = 0;
    for (const heading of all('h1, h2, h3, h4')) {
        const next = Number(heading.tagName[1]);
        check(next <= level + 1, 'heading skips a level', heading);
        level = next;
    }
    all('img').forEach((image) => check(image.alt.length > 20, 'no alt', image));
    all('svg, canvas').forEach((image) => check(
        image.closest('[aria-hidden=true]') || image.getAttribute('aria-label'),
        'no label', image));
    all('button, a, summary').forEach((item) => check(named(item), 'no name', item));
    all('input, select').forEach((item) => check(
        item.getAttribute('aria-label') || item.labels.length, 'no label', item));
    all('[tabindex="0"]').forEach((item) => check(
        item.getAttribute('aria-label') && item.getAttribute('role'),
        'stop without name', item));
    all('table').forEach((table) => {
        check(table.caption?.textContent.trim(), 'no caption', table);
        const heads = table.querySelectorAll('th');
        heads.forEach((head) => check(head.scope, 'no scope', head));
        table.querySelectorAll('tbody tr').forEach((row) => check(
            row.cells[0].matches('th[scope=row]'), 'no head of row', row));
    });
    const ids = all('[id]').map((item) => item.id);
    check(new Set(ids).size === ids.length, 'ids repeat');
    all('[aria-labelledby]').forEach((item) => check(
        document.getElementById(item.getAttribute('aria-labelledby')),
        'label is missing', item));
    return faults;
}"""


def test_a_screen_reader_finds_names_heads_and_landmarks(browser, address):
    with open_page(browser, address) as page:
        page.click("#player-details summary")
        page.wait_for_selector("#player-table tbody tr")
        assert page.evaluate(FAULTS) == []


CONTRASTS = """() => {
    const parse = (colour) => (colour.match(/[0-9.]+/g) ?? []).map(Number);
    const linear = (level) => {
        const share = level / 255;
        return share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4;
    };
    const luminance = ([r, g, b]) =>
        0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
    const behind = (element) => {
        for (let item = element; item; item = item.parentElement) {
            const colour = parse(getComputedStyle(item).backgroundColor);
            if (colour.length === 3 || colour[3] === 1) return colour;
        }
        return [255, 255, 255];
    };
    const found = {};
    const note = (text, back, element) => {
        const [a, b] = [luminance(text), luminance(back)].sort((x, y) => y - x);
        const key = `${text} on ${back}, ${element.tagName} ${element.className}`;
        found[key] = (a + 0.05) / (b + 0.05);
    };
    for (const element of document.querySelectorAll('body *:not(script):not(svg *)')) {
        const hasText = [...element.childNodes].some(
            (node) => node.nodeType === 3 && node.data.trim());
        if (!hasText) continue;
        note(parse(getComputedStyle(element).color), behind(element), element);
        const after = getComputedStyle(element, '::after');
        if (after.content !== 'none') {
            note(parse(after.color), behind(element), element);
        }
    }
    for (const text of document.querySelectorAll('#player-heatmap svg text'))
        note(parse(getComputedStyle(text).fill), [255, 255, 255], text);
    return found;
}"""


def test_all_text_stands_out_from_what_is_behind_it(browser, addresses):
    with open_page(browser, addresses["placement"].as_uri()) as page:
        page.evaluate(
            "document.querySelectorAll('details').forEach((d) => { d.open = true; })"
        )
        contrasts = page.evaluate(CONTRASTS)
    assert any("sort-head" in key for key in contrasts)
    assert {
        key: ratio for key, ratio in contrasts.items() if ratio < LEAST_CONTRAST
    } == {}


def test_the_keyboard_enlarges_a_figure_and_comes_back(browser, addresses):
    with open_page(browser, addresses["missed"].as_uri(), width=360) as page:
        button = page.locator("figcaption button").first
        button.focus()
        style = "getComputedStyle(document.activeElement)"
        page.keyboard.press("Shift+Tab")
        page.keyboard.press("Tab")

        # One sees where one is.
        assert page.evaluate(f"{style}.outlineStyle") == "solid"

        page.keyboard.press("Enter")
        image = page.locator("dialog[open] img")

        assert image.bounding_box()["width"] == int(image.get_attribute("width")) > 1000
        assert page.evaluate("document.documentElement.scrollWidth") <= 360

        page.keyboard.press("Escape")
        assert page.locator("dialog[open]").count() == 0
        assert page.evaluate("document.activeElement.textContent") == "Enlarge"

        page.locator("figure img").first.click()
        page.click("dialog[open] button")
        assert page.locator("dialog[open]").count() == 0


@pytest.mark.parametrize("has_scripts", [True, False])
def test_paper_has_every_section_and_what_was_folded_but_not_what_is_long(
    browser, addresses, tmp_path, has_scripts
):
    reader = shutil.which("pdftotext")
    if reader is None:
        pytest.skip("pdftotext is not installed")
    path = tmp_path / "report.pdf"
    address = addresses["placement"].as_uri()
    with open_page(browser, address, java_script_enabled=has_scripts) as page:
        if has_scripts:
            missing = set()
        else:
            missing = {"Watch a run"}
        headings = set(texts(page, "h2")) - missing
        page.evaluate(
            "document.querySelectorAll('details.part').forEach((d) => { d.open ="
            " true; })"
        )
        page.pdf(path=path, prefer_css_page_size=True)

        if has_scripts:  # the screen is as it was
            assert page.locator("main details[open].paper-length").count() < (
                page.locator("main details.paper-length").count()
            )
    printed = subprocess.run(
        [reader, "-layout", str(path), "-"], check=True, capture_output=True, text=True
    ).stdout
    pages = printed.split("\f")[:-1]

    assert len(pages) > 3

    words = " ".join(printed.split())
    assert all(heading in words for heading in headings)
    assert "How far each assumption is varied, and why" in words
    for unwanted in ("Enlarge", "Contents", "Play", "Scripts are disabled"):
        assert unwanted not in words


def test_a_table_that_runs_over_a_page_has_its_heads_on_each(
    browser, addresses, tmp_path
):
    reader = shutil.which("pdftotext")
    if reader is None:
        pytest.skip("pdftotext is not installed")
    path = tmp_path / "report.pdf"
    with open_page(browser, addresses["many"].as_uri()) as page:
        page.evaluate("document.querySelector('details.screen-length').open = true")
        page.pdf(path=path, prefer_css_page_size=True)
    printed = subprocess.run(
        [reader, "-layout", str(path), "-"], check=True, capture_output=True, text=True
    ).stdout
    heads = [
        line
        for line in printed.splitlines()
        if line.split()[:3] == ["mark", "id", "site"]
    ]

    assert len(heads) >= 3
