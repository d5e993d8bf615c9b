"""A page as PDF, printed by a browser without a window."""

import os
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

from geometry.errors import InputError, Unquoted
from geometry.writing import write_atomically

_BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
)
_LIMIT_S = 120.0


def find_browser() -> Path:
    """A browser that prints. Raises InputError if none is on the path."""
    for name in _BROWSERS:
        found = shutil.which(name)
        if found is not None:
            return Path(found)
    raise InputError(
        "--pdf", Unquoted("no browser that prints"), "chromium or google-chrome"
    )


def print_page(browser: Path, page: Path, out: Path) -> None:
    """Print a page to a file. Raises InputError if the browser does not."""
    with TemporaryDirectory() as name:
        pdf = Path(name) / "page.pdf"
        command = [
            str(browser),
            "--headless",
            "--disable-gpu",
            "--no-pdf-header-footer",
        ]
        command += [f"--user-data-dir={name}/profile", f"--print-to-pdf={pdf}"]
        if hasattr(os, "geteuid") and os.geteuid() == 0:  # its sandbox refuses root
            command.append("--no-sandbox")
        command.append(page.resolve().as_uri())
        try:
            subprocess.run(command, capture_output=True, check=False, timeout=_LIMIT_S)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise InputError(
                str(browser), Unquoted(error), "a browser that prints"
            ) from None
        if not pdf.exists():
            raise InputError(
                str(browser), Unquoted("no page printed"), "a browser that prints"
            )
        write_atomically(out, pdf.read_bytes())
