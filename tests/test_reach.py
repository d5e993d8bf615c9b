"""What the main job can load: modules that imports lead to from
``experiments.cli.place``.

Imports count wherever they stand, inside functions too: what a module could need at
some time is what a reader of it has to know.
"""

import ast
import io
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("geometry", "scenarios", "placement", "experiments")
START = "experiments.cli.place"
MOST_MODULES = 180
MOST_TOKENS = 302_000
"""Of today, so that it grows no further; 150 modules are to be reached. The decision to
brake (positions, tracks, twins) brought seven.
"""
NO_TOKENS = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def file_of(module):
    """The file of a module; None: it is none of this project."""
    place = ROOT / module.replace(".", "/")
    for path in (place.with_suffix(".py"), place / "__init__.py"):
        if path.exists():
            return path
    return None


def imported_names(module):
    """Full names of what a module imports, those of other projects too."""
    path = file_of(module)
    if path.name == "__init__.py":
        package = module
    else:
        package = module.rpartition(".")[0]
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        if isinstance(node, ast.ImportFrom):
            origin = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                origin = ".".join([*above, origin]).rstrip(".")
            names += [f"{origin}.{alias.name}" for alias in node.names]
    return names


def imported_modules(module):
    """Modules of this project that a module imports, and the packages that they are
    in.
    """
    found = set()
    for name in imported_names(module):
        parts = name.split(".")
        if parts[0] not in PACKAGES:
            continue
        heads = [".".join(parts[:n]) for n in range(1, len(parts) + 1)]
        found |= {head for head in heads if file_of(head) is not None}
    return found


def reach(start):
    """All modules that imports lead to, with the module that led to each first."""
    led_by = {start: ""}
    waiting = [start]
    while waiting:
        module = waiting.pop(0)
        for found in sorted(imported_modules(module)):
            if found not in led_by:
                led_by[found] = module
                waiting.append(found)
    return led_by


def n_tokens(module):
    """How much there is to read in a module."""
    text = file_of(module).read_text()
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return sum(token.type not in NO_TOKENS for token in tokens)


@pytest.mark.long
def test_the_main_job_reaches_no_more_modules_than_it_did():
    led_by = reach(START)
    assert len(led_by) > 100
    assert len(led_by) <= MOST_MODULES, led_by
    assert sum(n_tokens(module) for module in led_by) <= MOST_TOKENS
