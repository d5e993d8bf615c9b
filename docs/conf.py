"""How the documentation site is made: python -m sphinx -W -n -b html docs SITE."""

import logging
import os
import re
import sys
import tomllib
from pathlib import Path

import click
from sphinx.application import Sphinx

_DOCS = Path(__file__).parent
_ROOT = _DOCS.parent
sys.path[:0] = [str(_ROOT), str(_DOCS / "extensions")]
os.environ.setdefault("MPLBACKEND", "agg")
logging.getLogger("placement").setLevel(
    logging.WARNING
)  # a style of the theme turns all logs on

project = "place-rsus"
version = release = tomllib.loads((_ROOT / "pyproject.toml").read_text("utf-8"))[
    "project"
]["version"]
copyright = "the authors of place-rsus; Apache-2.0"  # noqa: A001 - Sphinx's own name
language = "en"
smartquotes = False  # --budget is no dash

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_parser",
    "sphinx_click",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "pages",
]
exclude_patterns = [
    "examples",
    "extensions",
    "maps",
    "gallery/*.ipynb",
    "gallery/*.py",
    "gallery/*.json",
]
nitpicky = True
nitpick_ignore_regex = [
    (r"py:.*", r"(numpy|pandas|matplotlib|shapely)\..*")
]  # no pages of others

# One docstring, one place: the packages' public names. Types stand in the docstrings,
# with shapes.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autosummary_generate = False
numpydoc_show_class_members = False

myst_enable_extensions = ["deflist", "dollarmath", "colon_fence"]
myst_heading_anchors = 3
copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True

sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "gallery",
    "image_scrapers": ("pages.scrape",),
    "capture_repr": ("_repr_html_",),
    "write_computation_times": False,
    "filename_pattern": r"plot_",
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 0,
    "remove_config_comments": True,
    "abort_on_example_error": True,
    "within_subsection_order": "FileNameSortKey",
}

html_theme = "furo"
html_title = "place-rsus"
html_math_renderer = "mathml"
html_static_path = ["static"]
html_css_files = ["place_rsus.css"]
html_theme_options = {"navigation_with_keys": True}
html_show_sphinx = False


def setup(app: Sphinx) -> None:
    """Defaults of options that are paths are shown as a user writes them."""
    app.connect("sphinx-click-process-options", _show_paths)


def _show_paths(app: Sphinx, context: click.Context, lines: list[str]) -> None:
    lines[:] = [re.sub(r"PosixPath\('(.*?)'\)", r"\1", line) for line in lines]
