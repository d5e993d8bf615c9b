"""A report as browsers show it: ``python -m experiments.report.screenshots REPORT.html``."""

import shutil
from pathlib import Path

import click

from ..parts.section import with_palette

_WIDTHS_PX = {"desktop": (1280, 1600), "phone": (360, 1400)}
_PARTS = (
    "Where to mount",
    "What each unit buys",
    "Time and distance to spare",
    "If a unit or a pole fails",
    "What if an assumption is wrong?",
    "What the cameras see of the road",
    "Who sees the road user when",
    "Watch a run",
    "Bill of materials",
)


@click.command()
@click.argument("report", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("results/report"), show_default=True
)
def main(report: Path, out: Path) -> None:
    """Photograph parts of a report at the widths of a desktop and of a phone."""
    from playwright.sync_api import sync_playwright

    out.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as library:
        browser = library.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        for name, (width_px, height_px) in _WIDTHS_PX.items():
            page = browser.new_page(viewport={"width": width_px, "height": height_px})
            page.goto(report.resolve().as_uri())
            for part in _PARTS:
                heading = page.locator("h1, h2").filter(has_text=part).first
                heading.evaluate("element => element.scrollIntoView({ behavior: 'instant' })")
                page.wait_for_timeout(400)
                path = out / f"{name}-{'-'.join(part.lower().replace('?', '').split())}.png"
                path.write_bytes(with_palette(page.screenshot()))
                click.echo(f"Written to {path}.")
        browser.close()


if __name__ == "__main__":
    main()
