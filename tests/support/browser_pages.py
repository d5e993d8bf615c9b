"""Pages in a browser, where there is one: they must neither complain nor ask for
anything.
"""

import shlex
import shutil
import stat
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

# A software renderer: these machines need no graphics card.
ARGUMENTS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]


# The same tests again: pytest -m system has them.
ENGINES = ["chromium", pytest.param("firefox", marks=pytest.mark.long)]


@contextmanager
def start_browser(engine="chromium", *, folder=None):
    """A browser that playwright drives; the test is skipped where there is none.

    Firefox is Debian's; `folder` gets the program that starts it.
    """
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed"
    )
    with playwright.sync_playwright() as library:
        try:
            if engine == "firefox":
                program = _firefox(folder)
                opened = library.firefox.launch(
                    channel="moz-firefox",
                    executable_path=program,
                    # Takes keys.
                    firefox_user_prefs={"browser.download.alwaysOpenPanel": False},
                )
            else:
                found = shutil.which("chromium")
                opened = library.chromium.launch(executable_path=found, args=ARGUMENTS)
        except playwright.Error as error:
            pytest.skip(f"no browser can be started: {str(error).splitlines()[0]}")
        yield opened
        opened.close()


def _firefox(folder):
    """A program that starts Firefox behind its relay."""
    found = shutil.which("firefox-esr") or shutil.which("firefox")
    if found is None:
        pytest.skip("no Firefox: apt-get install firefox-esr")
    pytest.importorskip("websockets", reason="websockets is not installed")
    relay = Path(__file__).with_name("firefox_relay.py")
    program = folder / "firefox"
    words = shlex.join([sys.executable, str(relay), found])
    program.write_text(f'#!/bin/sh\nexec {words} "$@"\n')
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return program


@contextmanager
def open_page(
    browser,
    address,
    *,
    width=1280,
    height=900,
    before=None,
    own=("file:", "data:", "blob:"),
    may_complain=False,
    may_ask_people=False,
    **options,
):
    """A page that must neither complain nor ask for anything but what begins as `own`.

    Something may be done `before` it goes to the address; what it complains of is of no
    account if it may, and so are its dialogs.
    """
    viewport = {"width": width, "height": height}
    context = browser.new_context(viewport=viewport, **options)
    page = context.new_page()
    complaints = []
    asked = []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    if not may_ask_people:
        page.on("dialog", lambda dialog: complaints.append(dialog.message))
    if before is not None:
        before(page)
    page.goto(address)
    yield page
    context.close()

    assert [url for url in asked if not url.startswith(own)] == []
    assert may_complain or complaints == []
