"""The planner's page: how long a drag takes, and pictures of the page.

``python -m experiments.bench.planner`` photographs the page as browsers show it.
"""

import json
import shutil
import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np

from geometry.frames import to_geographic
from geometry.scene import Scene
from geometry.study_scene import load_study_scene
from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.layout import load_carlancap_layout
from placement.live import LiveTable, table_verdict
from placement.question import Question
from placement.setting import Setting, build_setting

from ..parts.section import with_palette
from ..planner.numbers import state_record, table_numbers
from ..planner.plan import ChangeUnit, Plan, Stock, Variant, begin_history, change_state
from ..planner.session import Session
from ..planner.tasks import Work
from .rays import Figures

_TURNS, _LIFTS = 60, 12
_UNITS = 3
_DRAGS, _STEPS, _LIFTED = 25, 6, 10
_STEP_MS, _QUIET_MS, _PATIENCE_MS = 30, 900, 300_000
_SIZES_PX = {"desktop": (1440, 900), "tablet": (820, 1180)}
# Chromium draws in three dimensions without a graphics card.
_BROWSER_ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]
# Within the page: when the pointer or a key moved last, and when numbers of which state were shown.
_WATCH = """() => {
  const apr = document.getElementById("apr");
  window.moved = 0;
  window.shown = [];
  for (const kind of ["pointermove", "keydown"]) {
    document.addEventListener(kind, () => { window.moved = performance.now(); }, true);
  }
  new MutationObserver(() => {
    if (apr.dataset.revision) window.shown.push([Number(apr.dataset.revision), performance.now()]);
  }).observe(apr, { childList: true, attributes: true });
}"""
_LATENCY = """() => {
  const last = Math.max(...window.shown.map(([revision]) => revision));
  return window.shown.find(([revision]) => revision === last)[1] - window.moved;
}"""

# ---------- time of a drag


def measure_dragging(setting: Setting, question: Question) -> Figures:
    """From a move until its numbers are known: processor time of the table, and a page's clock.

    One of three of the study's cameras is turned and tilted, then raised. Measured are the change,
    its drawing on the plan, detections, and verdicts of each unit and of all. Then the same is
    dragged in a browser while the evaluator is at work.
    """
    units = load_carlancap_layout().units[:_UNITS]
    stock = Stock(scene=setting.scene, models={unit.sensor.name: unit.sensor for unit in units})
    history = begin_history([Variant(name="three", units=units)])
    live = LiveTable(setting)

    def seconds(**change: Any) -> float:
        nonlocal history
        began_s = time.process_time()
        state = change_state(history.state, ChangeUnit(unit=units[0].id, **change), stock)
        history = history.went_on(state, gesture="bench")
        drawn = state_record(history, setting.scene)
        json.dumps([drawn, _numbers(live, state.variant.units, setting)])
        return time.process_time() - began_s

    low_m, high_m = next(
        site.height_range_m.tolist() for site in setting.scene.sites if site.id == units[0].site_id
    )
    seconds(yaw_deg=0.0)  # all is loaded, and all mounts are cast from
    turns = [seconds(yaw_deg=6.0 * n, pitch_deg=-5.0 - 0.5 * n) for n in range(1, _TURNS + 1)]
    lifts = [seconds(height_m=low_m + (high_m - low_m) * (n + 0.5) / _LIFTS) for n in range(_LIFTS)]
    return {
        "dragging: runs": str(setting.axis.n_runs),
        "dragging: a turn, ms of processor time, median": 1000.0 * statistics.median(turns),
        "dragging: a turn, ms of processor time, 95 of 100": 1000.0 * _most(turns),
        "dragging: a new mount, ms of processor time, median": 1000.0 * statistics.median(lifts),
        "dragging: a new mount, ms of processor time, the worst": 1000.0 * max(lifts),
        "dragging: a new mount to a turn": statistics.median(lifts) / statistics.median(turns),
        **_in_browser(setting, question),
    }


def _numbers(live: LiveTable, units: tuple[CandidatePose, ...], setting: Setting) -> object:
    detected = live.detected(units)
    alone = {
        unit.id: table_verdict([unit], detected[row : row + 1], setting)
        for row, unit in enumerate(units)
    }
    return table_numbers(units, table_verdict(units, detected, setting), alone, setting)


def _most(seconds: list[float]) -> float:
    """Quantile of 95 of 100."""
    return statistics.quantiles(seconds, n=20)[-1]


def _in_browser(setting: Setting, question: Question) -> Figures:
    """Time by the clock within a real page, from the last move until its numbers are shown."""
    if shutil.which("chromium") is None:
        return {"dragging: in a browser": "not measured: no chromium"}
    three = Variant(name="three", units=load_carlancap_layout().units[:_UNITS])
    with (
        tempfile.TemporaryDirectory() as folder,
        _browser() as browser,
        _serve(setting, question, three, Path(folder)) as address,
    ):
        page = _open(browser, address, (1280, 900))
        page.evaluate(_WATCH)
        drags = [_drag(page, number) for number in range(_DRAGS)]
        mounts = [_lower(page) for _ in range(_LIFTED)]
    name = "to its numbers on the page, ms"
    return {
        f"dragging: last move {name}, median (under 200)": statistics.median(drags),
        f"dragging: last move {name}, 95 of 100": _most(drags),
        f"dragging: a new mount {name}, median (under 1000)": statistics.median(mounts),
        f"dragging: a new mount {name}, the worst": max(mounts),
    }


def _drag(page: Any, number: int) -> float:
    """Move the ring of the chosen camera to and fro; the latency of the last move, ms."""
    box = page.locator("[data-aim]").bounding_box()
    x, y = box["x"] + box["width"] / 2.0, box["y"] + box["height"] / 2.0
    away = 6.0 if number % 2 else -6.0
    page.mouse.move(x, y)
    page.mouse.down()
    for step in range(1, _STEPS + 1):
        page.mouse.move(x + away * step, y + 0.5 * away * step)
        page.wait_for_timeout(_STEP_MS)
    milliseconds = _latency(page)
    page.mouse.up()
    return milliseconds


def _lower(page: Any) -> float:
    """Lower the chosen camera by a step; the latency, ms."""
    page.locator("#units [aria-pressed=true]").focus()
    page.keyboard.press("PageDown")
    return _latency(page)


def _latency(page: Any) -> float:
    page.wait_for_timeout(_QUIET_MS)
    page.wait_for_selector("#main[aria-busy=false]")
    milliseconds = float(page.evaluate(_LATENCY))
    page.evaluate("window.shown = []")
    return milliseconds


# ---------- a page in a browser


@contextmanager
def _browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as library:
        browser = library.chromium.launch(
            executable_path=shutil.which("chromium"), args=_BROWSER_ARGUMENTS
        )
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def _serve(setting: Setting, question: Question, variant: Variant, folder: Path) -> Iterator[str]:
    """Serve the page of a plan from a folder for the session's files; gives its address."""
    from ..planner.server import RunningServer

    work = Work(question=question, scratch=folder, compute=Compute())
    plan = Plan(variants=(variant,))
    server = RunningServer(lambda: Session(work, setting, plan=plan), host="127.0.0.1", port=0)
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


# ---------- pictures


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("results/plan"), show_default=True
)
def main(out: Path) -> None:
    """Photograph the page with two of the study's cameras, its dialogs, and private ground."""
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
        garden = Path(folder) / "garden.geojson"
        garden.write_text(_garden(load_study_scene()), encoding="utf-8")
        question = Question(cases="CPNC-50", along_arms="0", no_look=str(garden))
        with _serve(build_setting(question), question, two, Path(folder)) as address:
            page = _open(browser, address, _SIZES_PX["desktop"])
            page.wait_for_selector("#plan .seen", state="attached")
            _save(page, out / "desktop-private-ground.png")
            page.close()


def _photograph_dialogs(page: Any, stem: Path) -> None:
    """A lost run with the picture of a camera, and the view in three dimensions."""
    page.locator("#lost button").first.click()
    page.wait_for_selector("#run-why li")
    page.locator("#picture-show").click()
    page.wait_for_selector("#picture:not([hidden])")
    page.wait_for_timeout(400)
    _save(page, stem.with_name(f"{stem.name}-lost-run.png"))
    page.keyboard.press("Escape")
    page.locator("#turn").click()
    page.frame_locator("#turn-view").locator("#view-buttons").wait_for()
    _save(page, stem.with_name(f"{stem.name}-three-dimensions.png"))


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
