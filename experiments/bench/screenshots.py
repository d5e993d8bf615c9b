"""Pictures of pages as browsers show them.

``python -m experiments.bench.screenshots``.

``plan`` photographs the planner's page, ``junctions MAP`` the map on which its junction
is chosen, ``report REPORT.html`` a report.
"""

import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np

from geometry.frames import to_geographic
from geometry.scene import Scene
from geometry.scene_sources import load_scene
from geometry.study_scene import load_study_scene
from placement.compute import Compute
from placement.layout import load_carlancap_layout
from placement.question import Question
from placement.setting import Setting, build_setting

from ..language import speaking
from ..parts.section import with_palette
from ..planner.files import MapFile
from ..planner.plan import Variant
from ..planner.plan_files import Plan
from ..planner.session import Session
from ..planner.tasks import Work

_PATIENCE_MS = 300_000
_SIZES_PX = {"desktop": (1440, 900), "tablet": (820, 1180)}
_GERMAN_SIZES_PX = {"desktop": (1280, 800), "phone": (390, 844)}
_REPORT_SIZES_PX = {"desktop": (1280, 1600), "phone": (360, 1400)}
_REPORT_PARTS = (
    "Where to mount",
    "If a unit or a pole fails",
    "Watch a run",
    "Bill of materials",
)


@contextmanager
def _browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    chromium = {"executable_path": shutil.which("chromium"), "args": ["--no-sandbox"]}
    with sync_playwright() as library, library.chromium.launch(**chromium) as browser:
        yield browser


@contextmanager
def _serve(
    setting: Setting, question: Question, variant: Variant, folder: Path, **given: Any
) -> Iterator[str]:
    """Serve the page of a plan from a folder for the session's files.

    Gives its address.
    """
    from ..planner.server import RunningServer

    work = Work(question=question, scratch=folder, compute=Compute())
    server = RunningServer(
        lambda: Session(work, setting, begun=Plan(variants=(variant,)), **given),
        host="127.0.0.1",
        port=0,
    )
    server.start()
    try:
        yield server.address
    finally:
        server.stop()


def _open(browser: Any, address: str, size_px: tuple[int, int]) -> Any:
    """The page once the evaluator has answered, with the first camera chosen."""
    width_px, height_px = size_px
    page = browser.new_page(viewport={"width": width_px, "height": height_px})
    page.set_default_timeout(_PATIENCE_MS)
    page.goto(address)
    page.wait_for_selector("#source.evaluator")
    page.locator("[data-chip]").first.click()
    page.wait_for_timeout(400)
    return page


@click.group()
def main() -> None:
    """Photograph the planner's page, or parts of a report."""


@main.command()
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("results/plan"),
    show_default=True,
)
def plan(out: Path) -> None:
    """Photograph the page with two cameras, its dialogs and private ground."""
    out.mkdir(parents=True, exist_ok=True)
    two = Variant(name="two cameras", units=load_carlancap_layout().units[:2])
    with tempfile.TemporaryDirectory() as folder, _browser() as browser:
        question = Question(cases="study")
        with _serve(build_setting(question), question, two, Path(folder)) as address:
            for name, size_px in _SIZES_PX.items():
                page = _open(browser, address, size_px)
                _save(page, out / f"{name}.png")
                if name == "desktop":
                    _photograph_dialogs(page, out / name)
                page.close()
        german = build_setting(question)
        with speaking("de"), _serve(german, question, two, Path(folder)) as address:
            for name, size_px in _GERMAN_SIZES_PX.items():
                page = _open(browser, address, size_px)
                page.locator("#lost button").first.click()
                page.wait_for_selector("#played")
                page.evaluate("() => { scrollTo(0, 0); panel.scrollTo(0, 0); }")
                page.wait_for_timeout(400)
                _save(page, out / f"{name}-de.png")
                page.close()
        garden = Path(folder) / "garden.geojson"
        garden.write_text(_garden(load_study_scene()), encoding="utf-8")
        question = Question(cases="CPNC-50", along_arms="0", no_look=str(garden))
        with _serve(build_setting(question), question, two, Path(folder)) as address:
            page = _open(browser, address, _SIZES_PX["desktop"])
            page.wait_for_selector("#plan .seen", state="attached")
            _save(page, out / "desktop-private-ground.png")
            page.close()


@main.command()
@click.argument("city", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--find", default="", help="Typed into the search.")
def junctions(city: Path, find: str) -> None:
    """Photograph the map of a city on which the planner's junction is chosen."""
    question = Question(cases="CPNC-50", along_arms="0", speeds="50")
    setting = build_setting(question, load_scene(city))
    file = MapFile(path=city, name=city.name)
    with (
        tempfile.TemporaryDirectory() as folder,
        _serve(
            setting, question, Variant(name=""), Path(folder), map_file=file
        ) as address,
        _browser() as browser,
    ):
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.set_default_timeout(_PATIENCE_MS)
        page.goto(address)
        page.click("#another-junction")
        page.fill("#map-choice .map-find", find)
        page.wait_for_timeout(400)
        _save(page, Path("results/plan/junctions.png"))


@main.command()
@click.argument("page", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("results/report"),
    show_default=True,
)
def report(page: Path, out: Path) -> None:
    """Photograph parts of a report at the widths of a desktop and of a phone."""
    out.mkdir(parents=True, exist_ok=True)
    with _browser() as browser:
        for name, (width_px, height_px) in _REPORT_SIZES_PX.items():
            shown = browser.new_page(viewport={"width": width_px, "height": height_px})
            shown.goto(page.resolve().as_uri())
            # Parts have their English names.
            if shown.get_attribute("html", "lang") != "en":
                _save(
                    shown,
                    out
                    / f"{name}-first-screen-{shown.get_attribute('html', 'lang')}.png",
                )
                continue
            for part in _REPORT_PARTS:
                heading = shown.locator("h1, h2").filter(has_text=part).first
                heading.evaluate(
                    """element => {
                    const folded = element.closest("details");
                    if (folded) folded.open = true;
                    element.scrollIntoView({ behavior: "instant" });
                }"""
                )
                shown.wait_for_timeout(400)
                words = "-".join(part.lower().replace("?", "").split())
                _save(shown, out / f"{name}-{words}.png")


def _photograph_dialogs(page: Any, stem: Path) -> None:
    """A ruler and the chosen camera turned on the compass.

    A lost run; a camera's picture of it.
    """
    poles = [
        page.locator(f'[data-site="corner-{name}"]').bounding_box()
        for name in ("ne", "sw")
    ]
    page.keyboard.press("m")
    for pole in poles:
        page.mouse.click(pole["x"] + pole["width"] / 2, pole["y"] + pole["height"] / 2)
    page.locator("#compass").drag_to(
        page.locator("#compass"),
        source_position={"x": 62, "y": 30},
        # Away from the junction: runs are lost.
        target_position={"x": 90, "y": 40},
    )
    page.wait_for_selector("#source.evaluator")
    page.wait_for_selector("p:has(> #apr:not(.old)) + #source.evaluator")
    _save(page, stem.with_name(f"{stem.name}-side-view.png"))
    page.keyboard.press("Escape")
    for opens in ("#danger", "#question summary", "#own-poles summary"):
        page.locator(opens).click()
    _save(page, stem.with_name(f"{stem.name}-question.png"))
    for closes in ("#danger", "#question summary", "#own-poles summary"):
        page.locator(closes).click()
    page.locator("#lost button").first.click()
    page.wait_for_selector("#played")
    _save(page, stem.with_name(f"{stem.name}-run-on-plan.png"))
    page.locator("#played-why").click()
    page.wait_for_selector("#run-why li")
    page.locator("#picture-show").click()
    page.wait_for_selector("#picture:not([hidden])")
    page.wait_for_timeout(400)
    _save(page, stem.with_name(f"{stem.name}-lost-run.png"))


def _garden(scene: Scene) -> str:
    """A garden at the junction's north-western corner, as GeoJSON."""
    x, y = scene.outline_m.mean(axis=0)
    corners_m = np.array([[-22, 8], [-11, 8], [-11, 18], [-22, 18], [-22, 8]]) + [x, y]
    ring = to_geographic(corners_m, scene.crs).tolist()
    shape = {"type": "Polygon", "coordinates": [ring]}
    feature = {"type": "Feature", "properties": {"name": "garden"}, "geometry": shape}
    return json.dumps({"type": "FeatureCollection", "features": [feature]})


def _save(page: Any, path: Path) -> None:
    path.write_bytes(with_palette(page.screenshot()))
    click.echo(f"Written to {path}.")


if __name__ == "__main__":
    main()
