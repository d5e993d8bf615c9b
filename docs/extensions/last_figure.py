"""The figure that ends a block of an example, for sphinx-gallery: no pyplot is needed."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

_DPI = 110


def scrape(block: tuple[Any, ...], values: Mapping[str, Any], config: Mapping[str, Any]) -> str:
    """Save the figure that is the value of a block's last line; the rst that shows it, or "".

    `block`: kind, text and line. `values`: ``___`` is the value of the last line.
    """
    figure = values["example_globals"].get("___")
    if not isinstance(figure, Figure):
        return ""
    values["example_globals"]["___"] = None  # the next block has its own, or none
    path = Path(next(values["image_path_iterator"]))
    figure.savefig(path, dpi=_DPI)
    return str(figure_rst([str(path)], config["src_dir"], block[1].strip().splitlines()[-1]))
