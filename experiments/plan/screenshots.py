"""The planner's page as browsers show it: ``python -m experiments.plan.screenshots``."""

import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np

from geometry.frames import to_geographic
from geometry.scene import Scene
from geometry.study_scene import load_study_scene
from placement.compute import Compute
from placement.question import Question
from placement.setting import Setting, build_setting
from placement.study_layout import load_carlancap_layout

from ..parts.section import with_palette
from .desk import Desk
from .server import RunningServer
from .session import Plan, Variant
from .tasks import Work

_SIZES_PX = {"desktop": (1440, 900), "tablet": (820, 1180)}
_PATIENCE_MS = 300_000
BROWSER_ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
"""Of Chromium: it draws in three dimensions without a graphics card."""


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("results/plan"), show_default=True
)
def main(out: Path) -> None:
    """Photograph the page with two of the study's cameras, its dialogs, and private ground."""
    from playwright.sync_api import sync_playwright

    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as library:
        browser = library.chromium.launch(
            executable_path=shutil.which("chromium"), args=BROWSER_ARGUMENTS
        )
        try:
            with _with_cameras(Question(cases="study"), Path(folder)) as address:
                for name, size_px in _SIZES_PX.items():
                    page = open_page(browser, address, size_px)
                    _save(page, out / f"{name}.png")
                    if name == "desktop":
                        _photograph_run(page, out / f"{name}-lost-run.png")
                        page.keyboard.press("Escape")
                        page.locator("#turn").click()
                        page.frame_locator("#turn-view").locator("#view-buttons").wait_for()
                        _save(page, out / f"{name}-three-dimensions.png")
                    page.close()
            garden = Path(folder) / "garden.geojson"
            garden.write_text(_garden(load_study_scene()), encoding="utf-8")
            question = Question(cases="CPNC-50", along_arms="0", no_look=str(garden))
            with _with_cameras(question, Path(folder)) as address:
                page = open_page(browser, address, _SIZES_PX["desktop"])
                page.wait_for_selector("#plan .seen", state="attached")
                _save(page, out / "desktop-private-ground.png")
                page.close()
        finally:
            browser.close()


def _with_cameras(question: Question, folder: Path) -> AbstractContextManager[str]:
    variant = Variant(name="two cameras", units=load_carlancap_layout().units[:2])
    return serve_page(build_setting(question), question, variant, folder)


@contextmanager
def serve_page(
    setting: Setting, question: Question, variant: Variant, folder: Path
) -> Iterator[str]:
    """Serve the page of a plan from a folder for the session's files; gives its address."""
    work = Work(
        question=question,
        scratch=folder,
        cache=None,
        seed=0,
        workers=Compute().workers,
        rays="auto",
    )
    plan = Plan(variants=(variant,))
    server = RunningServer(lambda: Desk(work, setting, plan=plan), host="127.0.0.1", port=0)
    server.start()
    try:
        yield server.address
    finally:
        server.stop()


def open_page(
    browser: Any, address: str, size_px: tuple[int, int], *, patience_ms: int = _PATIENCE_MS
) -> Any:
    """The page once the evaluator has answered, with the first camera chosen."""
    width_px, height_px = size_px
    page = browser.new_page(viewport={"width": width_px, "height": height_px})
    page.set_default_timeout(patience_ms)
    page.goto(address)
    page.wait_for_selector("#source.evaluator")
    page.locator("[data-chip]").first.click()
    page.wait_for_timeout(400)
    return page


def _garden(scene: Scene) -> str:
    """A garden at the junction's north-western corner, as GeoJSON."""
    x, y = scene.outline_m.mean(axis=0)
    corners_m = np.array([[-22, 8], [-11, 8], [-11, 18], [-22, 18], [-22, 8]]) + [x, y]
    ring = to_geographic(corners_m, scene.crs).tolist()
    shape = {"type": "Polygon", "coordinates": [ring]}
    feature = {"type": "Feature", "properties": {"name": "garden"}, "geometry": shape}
    return json.dumps({"type": "FeatureCollection", "features": [feature]})


def _photograph_run(page: Any, path: Path) -> None:
    page.locator("#lost button").first.click()
    page.wait_for_selector("#run-why li")
    page.locator("#picture-show").click()
    page.wait_for_selector("#picture:not([hidden])")
    page.wait_for_timeout(400)
    _save(page, path)


def _save(page: Any, path: Path) -> None:
    path.write_bytes(with_palette(page.screenshot()))
    click.echo(f"Written to {path}.")


if __name__ == "__main__":
    main()
