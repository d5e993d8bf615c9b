"""``place-rsus doctor``: what is installed, and what is missing."""

import os
import platform
import sys
from pathlib import Path
from typing import Any

import click

from geometry.text_formats import load_data

from ..progress import tell
from . import options
from .running import cache_folder
from .terminal import WIDTH, sentences

_EXIT_FAILED = 1


def examine(cache_folder: Path) -> dict[str, Any]:
    """The installation, and the folder of detection tables.

    Content of ``--json``.

    Well: everything that is not an extra is there, and the cache can be written.
    """
    from geometry.raycast import caster_name, open3d_problem

    known = load_data("experiments", "installed.toml")
    libraries = {name: _version(name) for name in known["libraries"]}
    cache = _examine_cache(cache_folder)
    return {
        "version": _version("place-rsus"),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processors": os.cpu_count(),
        "rays": {"by": caster_name(), "problem": open3d_problem()},
        "libraries": libraries,
        "extras": [
            {**extra, "version": _version(extra["package"])}
            for extra in known["extras"]
        ],
        "milp_solvers": ["HIGHS"] if libraries["highspy"] else [],
        "cache": cache,
        "is_well": all(libraries.values()) and cache["is_writable"],
    }


def doctor_text(found: dict[str, Any]) -> str:
    """Report in words, at most 80 columns wide."""
    lines = [
        (
            f"place-rsus {found['version'] or '(not installed)'}, Python"
            f" {found['python']}, {found['processors']} processors"
        ),
        f"  {found['platform']}"[:WIDTH],
        "",
        f"rays are cast by {found['rays']['by']}",
    ]
    if found["rays"]["problem"]:
        nothing_lost = "embreex casts the same rays: nothing is lost"
        lines += sentences(found["rays"]["problem"], nothing_lost, indent=2)
    lines += ["", "libraries:"]
    lines += [
        f"  {name:<22} {version or 'MISSING: place-rsus does not work without it'}"
        for name, version in found["libraries"].items()
    ]
    lines += ["", "extras:"]
    for entry in found["extras"]:
        missing = f"not installed (place-rsus[{entry['extra']}])"
        lines.append(f"  {entry['package']:<22} {entry['version'] or missing}")
        if not entry["version"]:
            lines += sentences(f"without it: no {entry['without']}", indent=4)
    lines += ["", "mixed-integer solvers: " + ", ".join(found["milp_solvers"])]
    cache = found["cache"]
    if cache["is_writable"]:
        state = ""
    else:
        state = "; it cannot be written to: tables are made anew"
    size = f"{cache['bytes'] / 2**20:,.0f} MiB"
    lines += sentences(
        f"detection tables: {cache['files']} in {cache['folder']}, {size}{state}"
    )
    return "\n".join(lines)


def _version(package: str) -> str | None:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _examine_cache(folder: Path) -> dict[str, Any]:
    tables = list(folder.glob("table-*.npz"))
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    return {
        "folder": str(folder),
        "files": len(tables),
        "bytes": sum(path.stat().st_size for path in tables),
        "is_writable": existing.is_dir() and os.access(existing, os.W_OK),
    }


_EXAMPLES = """\b
Examples:
  place-rsus doctor
  place-rsus doctor --json | jq .extras

Exit codes: 0 all is well (extras may be missing), 1 something is not."""


@click.command(epilog=_EXAMPLES)
@options.json_option
def doctor(*, as_json: bool) -> None:
    """Say what is installed here, what is missing, and what that costs."""
    from ..export.json import to_json_text

    summary = examine(cache_folder())
    tell(to_json_text(summary).rstrip() if as_json else doctor_text(summary))
    if not summary["is_well"]:
        sys.exit(_EXIT_FAILED)
