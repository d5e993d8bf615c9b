"""The planner's page as browsers show it: ``python -m experiments.plan.screenshots``."""

import shutil
import tempfile
from pathlib import Path
from typing import Any

import click

from placement.compute import Compute
from placement.question import Question
from placement.setting import build_setting

from ..report.section import with_palette
from ..study.layout import load_carlancap_layout
from .desk import Desk
from .server import RunningServer
from .session import Plan, Variant
from .tasks import Work

_SIZES_PX = {"desktop": (1440, 900), "tablet": (820, 1180)}
_UNITS = 2
_PATIENCE_MS = 300_000
_ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader"]


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("results/plan"), show_default=True
)
def main(out: Path) -> None:
    """Photograph the page with two of the study's cameras, and the dialog of a lost run."""
    from playwright.sync_api import sync_playwright

    out.mkdir(parents=True, exist_ok=True)
    question = Question(cases="study")
    setting = build_setting(question)
    units = load_carlancap_layout().units[:_UNITS]
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as library:
        work = Work(
            question=question,
            scratch=Path(folder),
            cache=None,
            seed=0,
            workers=Compute().workers,
            rays="auto",
        )
        plan = Plan(variants=(Variant(name="two cameras", units=units),))
        server = RunningServer(lambda: Desk(work, setting, plan=plan), host="127.0.0.1", port=0)
        server.start()
        browser = library.chromium.launch(executable_path=shutil.which("chromium"), args=_ARGUMENTS)
        try:
            for name, (width_px, height_px) in _SIZES_PX.items():
                page = browser.new_page(viewport={"width": width_px, "height": height_px})
                page.set_default_timeout(_PATIENCE_MS)
                page.goto(server.address)
                page.wait_for_selector("#source.evaluator")
                page.locator(f'[data-chip="{units[0].id}"]').click()
                page.wait_for_timeout(400)
                _save(page, out / f"{name}.png")
                if name == "desktop":
                    _photograph_run(page, out / f"{name}-lost-run.png")
                page.close()
        finally:
            browser.close()
            server.stop()


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
