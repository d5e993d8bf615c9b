"""Sphinx extension of the pages: formulas, references, figures.

*Formulas* are MathML, which browsers draw by themselves: no script, no font, no
network. Sphinx's own ways are MathJax, which pages fetch from the web, and pictures,
which need LaTeX. docutils brings a translator from LaTeX to MathML; this hands Sphinx's
formulas to it.

*References to names by their home module*, where the pages show them under their
package: a docstring says ``scenarios.aeb.AebRule``, and the page has it as
``scenarios.AebRule``: the link leads there. What exists but is not public stays without
a link; what does not exist is a warning.

*The figure that ends a block of an example*, for sphinx-gallery: no pyplot is needed.
"""

import re
from collections.abc import Mapping
from html import escape
from importlib import import_module
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from matplotlib.figure import Figure
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util import logging
from sphinx.util.typing import ExtensionMetadata
from sphinx.writers.html5 import HTML5Translator
from sphinx_gallery.scrapers import figure_rst

# Where a name of two packages is shown: the first that has it.
PACKAGES = ("geometry", "scenarios", "placement")
_BRACE = re.compile(r"<mo>([{}])</mo>")  # browsers stretch them without being asked
_LOGGER = logging.getLogger(__name__)
_DPI = 110


def setup(app: Sphinx) -> ExtensionMetadata:
    """Add it to Sphinx, formulas as ``html_math_renderer = "mathml"``."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    app.connect("missing-reference", find_public)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


def visit_inline(translator: HTML5Translator, node: nodes.math) -> None:
    """Write a formula within a line of text."""
    translator.body.append(_as_mathml(node, as_block=False))
    raise nodes.SkipNode


def visit_block(translator: HTML5Translator, node: nodes.math_block) -> None:
    """Write a formula of its own."""
    translator.body.append(
        f'<div class="formula">{_as_mathml(node, as_block=True)}</div>\n'
    )
    raise nodes.SkipNode


def _as_mathml(node: nodes.math | nodes.math_block, *, as_block: bool) -> str:
    try:
        mathml = str(tex2mathml(node.astext(), as_block=as_block))
    except MathError as error:
        _LOGGER.warning(
            "formula: got %s; expected LaTeX (%s)", node.astext(), error, location=node
        )
        return f"<code>{escape(node.astext())}</code>"
    return _BRACE.sub(r'<mo stretchy="false">\1</mo>', mathml)


def find_public(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.Element
) -> nodes.Element | None:
    """The link of a name that pages have under another one, or its text alone."""
    if node.get("refdomain") != "py":
        return None
    name = str(node["reftarget"])
    for prefix in ("", *_homes(node), str(node.get("py:module"))):
        if prefix:
            path = f"{prefix}.{name}"
        else:
            path = name
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


def scrape(
    block: tuple[Any, ...], values: Mapping[str, Any], config: Mapping[str, Any]
) -> str:
    """Save the figure that is the value of a block's last line.

    Returns the rst that shows it, or "".

    `block`: kind, text and line. `values`: ``___`` is the value of the last line.
    """
    figure = values["example_globals"].get("___")
    if not isinstance(figure, Figure):
        return ""
    values["example_globals"]["___"] = None  # the next block has its own, or none
    path = Path(next(values["image_path_iterator"]))
    figure.savefig(path, dpi=_DPI)
    return str(
        figure_rst([str(path)], config["src_dir"], block[1].strip().splitlines()[-1])
    )
