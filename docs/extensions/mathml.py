"""Formulas as MathML, which browsers draw by themselves: no script, no font, no network.

Sphinx's own ways are MathJax, which pages fetch from the web, and pictures, which need LaTeX.
docutils brings a translator from LaTeX to MathML; this hands Sphinx's formulas to it.
"""

import re
from html import escape

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.typing import ExtensionMetadata
from sphinx.writers.html5 import HTML5Translator

_BRACE = re.compile(r"<mo>([{}])</mo>")  # browsers stretch them without being asked
_LOGGER = logging.getLogger(__name__)


def visit_inline(translator: HTML5Translator, node: nodes.math) -> None:
    """Write a formula within a line of text."""
    translator.body.append(_as_mathml(node, as_block=False))
    raise nodes.SkipNode


def visit_block(translator: HTML5Translator, node: nodes.math_block) -> None:
    """Write a formula of its own."""
    translator.body.append(f'<div class="formula">{_as_mathml(node, as_block=True)}</div>\n')
    raise nodes.SkipNode


def setup(app: Sphinx) -> ExtensionMetadata:
    """Add it to Sphinx, as ``html_math_renderer = "mathml"``."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}


def _as_mathml(node: nodes.math | nodes.math_block, *, as_block: bool) -> str:
    try:
        mathml = str(tex2mathml(node.astext(), as_block=as_block))
    except MathError as error:
        _LOGGER.warning("formula: got %s; expected LaTeX (%s)", node.astext(), error, location=node)
        return f"<code>{escape(node.astext())}</code>"
    return _BRACE.sub(r'<mo stretchy="false">\1</mo>', mathml)
