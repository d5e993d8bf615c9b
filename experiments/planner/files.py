"""Files of a session: where plans are saved, and maps that were named or sent."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from geometry.writing import write_atomically

from ..language import tr
from .plan_files import plan_text
from .workspace import Shown

MAX_MAP_BYTES = 300_000_000
"""Of a file that a browser sends."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MapFile:
    """A map or a scene that was named or sent.

    Attributes
    ----------
    path : Path
        Where it lies.
    name : str
        As its sender calls it.
    options : dict
        Of maps: "sites", "sites_crs" and "keeps_left", as
        :meth:`.tasks.Tasks.import_junction` takes them.
    found : dict
        As :meth:`.tasks.Tasks.survey` tells; empty: nobody has looked yet.
    """

    path: Path
    name: str
    options: dict[str, Any] = field(default_factory=dict)
    found: dict[str, Any] = field(default_factory=dict)


def save_plan(shown: Shown) -> str:
    """Write the plan to its file, if there is one and it is not empty.

    Returns
    -------
    str
        Why it could not be written, as a sentence for the page; empty: nothing went
        wrong.
    """
    path = shown.workspace.save
    if path is None:
        return ""
    is_empty = shown.workspace.background is None and shown.state.is_empty
    if is_empty and not path.exists():
        return ""
    text = plan_bytes(shown)
    try:
        write_atomically(path, text)
    except OSError as error:
        return tr(
            "not saved: {file}: {reason}", file=path, reason=error.strerror or error
        )
    return ""


def plan_bytes(shown: Shown) -> bytes:
    """Contents of the plan's file."""
    text = plan_text(shown.state, shown.setting.scene, shown.workspace.background)
    return text.encode()


def free_path(path: Path) -> Path:
    """A path that does not exist, made of another: with -2, -3 .. before the suffix."""
    number = 2
    while True:
        found = path.with_name(f"{path.stem}-{number}{path.suffix}")
        if not found.exists():
            return found
        number += 1
