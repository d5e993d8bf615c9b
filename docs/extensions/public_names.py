"""References to names by their home module, where the pages show them under their package.

A docstring says ``scenarios.aeb.AebRule``, and the page has it as ``scenarios.AebRule``: the link
leads there. What exists but is not public stays without a link; what does not exist is a warning.
"""

from importlib import import_module
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.typing import ExtensionMetadata

# Where a name of two packages is shown: the first that has it.
PACKAGES = ("geometry", "scenarios", "placement")


def setup(app: Sphinx) -> ExtensionMetadata:
    """Add it to Sphinx."""
    app.connect("missing-reference", find_public)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


def find_public(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.Element
) -> nodes.Element | None:
    """The link of a name that pages have under another one, or its text alone."""
    if node.get("refdomain") != "py":
        return None
    name = str(node["reftarget"])
    for prefix in ("", *_homes(node), str(node.get("py:module"))):
        path = f"{prefix}.{name}" if prefix else name
        found = _load(path)
        if found is None:
            continue
        public = _public_name(found)
        if public is None:
            return content  # it exists, and is nobody's business
        return env.domains["py"].resolve_xref(
            env, node["refdoc"], app.builder, "obj", public, node, content
        )
    return None


def _public_name(found: Any) -> str | None:
    for package in PACKAGES:
        module = import_module(package)
        for name in module.__all__:
            if getattr(module, name) is found:
                return f"{package}.{name}"
    return None


def _homes(node: nodes.Node) -> list[str]:
    """The module, and the class, in whose docstring a reference stands."""
    at: nodes.Node | None = node
    while at is not None and "docstring of " not in (at.source or ""):
        at = at.parent
    if at is None:
        return []
    parts = str(at.source).split("docstring of ")[1].split(".")
    return [".".join(parts[:n]) for n in range(len(parts), 0, -1)]


def _load(path: str) -> Any:
    parts = path.split(".")
    if parts[0] not in ("geometry", "scenarios", "placement", "experiments"):
        return None
    for n in range(len(parts), 0, -1):
        try:
            found: Any = import_module(".".join(parts[:n]))
        except ImportError:
            continue
        for part in parts[n:]:
            found = getattr(found, part, None)
        return found
    return None
