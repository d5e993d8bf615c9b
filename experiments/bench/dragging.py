"""How long a drag on the planner's page takes until its numbers are known, beside a new mount."""

import json
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from placement.candidates import CandidatePose
from placement.layout import load_carlancap_layout
from placement.live import LiveTable, table_verdict
from placement.question import Question
from placement.setting import Setting

from ..plan.numbers import state_record, table_numbers
from ..plan.session import ChangeUnit, Stock, Variant, begin_history, change_state
from .rays import Figures

_TURNS, _LIFTS = 60, 12
_UNITS = 3
_DRAGS, _STEPS, _LIFTED = 25, 6, 10
_STEP_MS, _QUIET_MS, _PATIENCE_MS = 30, 900, 60_000
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


def measure_dragging(setting: Setting, question: Question) -> Figures:
    """From a move until its numbers are known: processor time of the table, and a page's clock.

    Three of the study's cameras hang; one of them is turned and tilted, then raised. Until the
    numbers come: the change, what the plan draws, detections, verdicts of each unit and of all.
    Then the same is dragged in a browser, with the evaluator at work beside it.
    """
    units = load_carlancap_layout().units[:_UNITS]
    stock = Stock(scene=setting.scene, models={unit.sensor.name: unit.sensor for unit in units})
    history = begin_history([Variant(name="three", units=units)])
    live = LiveTable(setting)

    def answer(change: ChangeUnit) -> str:
        nonlocal history
        state = change_state(history.state, change, stock)
        history = history.went_on(state, gesture="bench")
        drawn = state_record(history, setting.scene)
        return json.dumps([drawn, _numbers(live, state.variant.units, setting)])

    unit = units[0]
    low_m, high_m = next(
        site.height_range_m.tolist() for site in setting.scene.sites if site.id == unit.site_id
    )
    answer(ChangeUnit(unit=unit.id, yaw_deg=0.0))  # all is loaded, and all mounts are cast from
    turns = [
        _seconds(answer, ChangeUnit(unit=unit.id, yaw_deg=6.0 * n, pitch_deg=-5.0 - 0.5 * n))
        for n in range(1, _TURNS + 1)
    ]
    lifts = [
        _seconds(
            answer,
            ChangeUnit(unit=unit.id, height_m=low_m + (high_m - low_m) * (n + 0.5) / _LIFTS),
        )
        for n in range(_LIFTS)
    ]
    return {
        "dragging: runs": str(setting.axis.n_runs),
        "dragging: a turn, ms of processor time, median": 1000.0 * statistics.median(turns),
        "dragging: a turn, ms of processor time, 95 of 100": 1000.0 * _most(turns),
        "dragging: a new mount, ms of processor time, median": 1000.0 * statistics.median(lifts),
        "dragging: a new mount, ms of processor time, the worst": 1000.0 * max(lifts),
        "dragging: a new mount to a turn": statistics.median(lifts) / statistics.median(turns),
        **_in_browser(setting, question),
    }


def _in_browser(setting: Setting, question: Question) -> Figures:
    """Time by the clock within a real page, from the last move until its numbers are shown."""
    name = shutil.which("chromium")
    try:
        from playwright.sync_api import sync_playwright

        from ..plan.screenshots import BROWSER_ARGUMENTS, open_page, serve_page
    except ModuleNotFoundError as error:
        return {"dragging: in a browser": f"not measured: no package {error.name}"}
    if name is None:
        return {"dragging: in a browser": "not measured: no chromium"}
    three = Variant(name="three", units=load_carlancap_layout().units[:_UNITS])
    with (
        tempfile.TemporaryDirectory() as folder,
        sync_playwright() as library,
        serve_page(setting, question, three, Path(folder)) as address,
    ):
        browser = library.chromium.launch(executable_path=name, args=BROWSER_ARGUMENTS)
        try:
            page = open_page(browser, address, (1280, 900), patience_ms=_PATIENCE_MS)
            page.evaluate(_WATCH)
            drags = [_drag(page, number) for number in range(_DRAGS)]
            mounts = [_lower(page) for _ in range(_LIFTED)]
        finally:
            browser.close()
    return {
        "dragging: last move to its numbers on the page, ms, median (under 200)": statistics.median(
            drags
        ),
        "dragging: last move to its numbers on the page, ms, 95 of 100": _most(drags),
        "dragging: a new mount to its numbers on the page, ms, median (under 1000)": (
            statistics.median(mounts)
        ),
        "dragging: a new mount to its numbers on the page, ms, the worst": max(mounts),
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


def _numbers(live: LiveTable, units: tuple[CandidatePose, ...], setting: Setting) -> object:
    detected = live.detected(units)
    alone = {
        unit.id: table_verdict([unit], detected[row : row + 1], setting)
        for row, unit in enumerate(units)
    }
    return table_numbers(units, table_verdict(units, detected, setting), alone, setting)


def _seconds(answer: Callable[[ChangeUnit], str], change: ChangeUnit) -> float:
    began_s = time.process_time()
    answer(change)
    return time.process_time() - began_s


def _most(seconds: list[float]) -> float:
    """What 95 of 100 do not exceed."""
    return statistics.quantiles(seconds, n=20)[-1]
