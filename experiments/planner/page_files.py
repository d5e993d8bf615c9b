"""Files of the page that browsers load: HTML, scripts, styles, and what they say."""

import json
import re
from functools import cache
from importlib.resources import files
from pathlib import Path

from ..language import words_of
from ..report.page import page_environment

_KINDS = {".css": "text/css", ".js": "text/javascript"}
# Scripts of the report that the page's own scripts use
_SHARED_SCRIPTS = ("words.js", "run_numbers.js", "plan_drawing.js")
# Files of the report are plain scripts; here they are modules, which export what is
# used.
_EXPORTED = (
    b"export { element, drawGround, drawScale, addPatterns, MARKS, bodyCorners, "
    b"wedgeCorners, points, unpackBits, stretches, seconds, say, inWords };\n"
)
_EXPORTED_OF_MAPS = b"\nexport { openJunctionMap };\n"
_SAID = re.compile(r'\btr(?:n\(("(?:[^"\\]|\\.)*"), |\()("(?:[^"\\]|\\.)*")')


@cache
def page_messages() -> list[tuple[str, str]]:
    """What the page's scripts say by ``tr``, or by ``trn`` for one and for many (else "")."""
    messages = set()
    for name, (content, _) in page_files().items():
        if not name.endswith(".js"):
            continue
        for found in _SAID.finditer(content.decode()):
            one, many = found.groups('""')
            messages.add((json.loads(one), json.loads(many)))
    return sorted(messages)


def page_html() -> str:
    """The page in the language that is spoken.

    The translations of all that its scripts say stand in it.
    """
    path = files("experiments.planner") / "page" / "index.html.j2"
    template = page_environment().from_string(path.read_text(encoding="utf-8"))
    page: str = template.render(own_words=words_of(page_messages()))
    return page


@cache
def page_files() -> dict[str, tuple[bytes, str]]:
    """Files of the page by name: content and media type.

    ``shared.js`` has scripts of the report, ``junction_map.js`` the chooser of
    junctions; both become modules here.
    """
    page = files("experiments.planner") / "page"
    found = {}
    for item in page.iterdir():
        kind = _KINDS.get(Path(item.name).suffix)
        if kind is not None:
            found[item.name] = (item.read_bytes(), kind)
    of_maps = files("experiments.scene")
    script = (of_maps / "junction_map.js").read_bytes()
    style = (of_maps / "junction_map.css").read_bytes()
    found["junction_map.js"] = (script + _EXPORTED_OF_MAPS, _KINDS[".js"])
    found["junction_map.css"] = (style, _KINDS[".css"])
    report = files("experiments.report") / "templates"
    shared = [(report / name).read_bytes() for name in _SHARED_SCRIPTS]
    found["shared.js"] = (b"\n".join([*shared, _EXPORTED]), _KINDS[".js"])
    return found
