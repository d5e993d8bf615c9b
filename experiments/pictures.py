"""Figures as the templates show them: an embedded PNG, its title, caption, alternative text."""

import base64
import struct
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .figures import to_png


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """What the macro ``figure_of`` of ``templates/report.html.j2`` shows.

    Attributes
    ----------
    title, caption : str
        Below the picture.
    alt : str
        In its place, for those who do not see it.
    png : str
        PNG file, base64.
    width_px, height_px : int
        Its size.
    """

    title: str
    caption: str
    alt: str
    png: str
    width_px: int
    height_px: int


def build_picture(drawn: Figure | Axes, *, title: str, caption: str, alt: str) -> Picture:
    """A figure, or all of the one that some axes are in, with its words.

    Equal figures give equal pictures.
    """
    figure = drawn.get_figure(root=True)
    if figure is None:
        raise ValueError("axes that are in no figure")
    png = to_png(figure)
    width_px, height_px = struct.unpack(">II", png[16:24])  # of the header chunk
    return Picture(
        title=title,
        caption=caption,
        alt=alt,
        png=base64.b64encode(png).decode(),
        width_px=width_px,
        height_px=height_px,
    )
