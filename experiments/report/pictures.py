"""Figures as the templates show them: an embedded PNG, its title, caption, alternative text."""

import base64
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from geometry.arrays import FloatArray

from ..figures.axes import root_figure, to_png

MAX_TRUE_COLOUR_BYTES = 300_000
"""PNG files above are drawn with a palette: looking for one takes longer than it spares bytes."""

_N_COLOURS = 256
_LARGEST_ERROR, _LARGEST_MEAN_ERROR = 32.0, 1.5  # of 255, of any one channel: not seen by eye


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """What the macro ``figure_of`` of ``templates/macros.html.j2`` shows.

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
    width_in : float
        The width for which its letters are drawn: those of 8 pt are that high at this width.
    narrow : Picture, optional
        The same for a phone.
    """

    title: str
    caption: str
    alt: str
    png: str
    width_px: int
    height_px: int
    width_in: float
    narrow: "Picture | None" = None


def build_picture(
    drawn: Figure | Axes,
    *,
    title: str,
    caption: str,
    alt: str,
    narrow: Figure | Axes | None = None,
) -> Picture:
    """A figure, or all of the one that some axes are in, with its words.

    Equal figures give equal pictures. `narrow` is the same, drawn for a phone.
    """
    figure = root_figure(drawn)
    png = with_palette(to_png(figure))
    width_px, height_px = Image.open(BytesIO(png)).size
    return Picture(
        title=title,
        caption=caption,
        alt=alt,
        png=base64.b64encode(png).decode(),
        width_px=width_px,
        height_px=height_px,
        width_in=round(float(figure.get_figwidth()), 2),
        narrow=None
        if narrow is None
        else build_picture(narrow, title=title, caption=caption, alt=alt),
    )


def with_palette(png: bytes) -> bytes:
    """A picture with at most 256 colours where that spares much and is not seen.

    Parameters
    ----------
    png : bytes
        PNG file.

    Returns
    -------
    png : bytes
        The same file where it is small, would not become smaller, or would look different.
    """
    if len(png) <= MAX_TRUE_COLOUR_BYTES:
        return png
    image = Image.open(BytesIO(png)).convert("RGB")
    # Colours of small marks count like those of wide areas, which a median cut would let win.
    reduced = image.quantize(
        _N_COLOURS, method=Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE
    )
    error = np.abs(_levels(reduced.convert("RGB")) - _levels(image))
    buffer = BytesIO()
    reduced.save(buffer, format="png", optimize=True)
    is_alike = error.max() <= _LARGEST_ERROR and error.mean() <= _LARGEST_MEAN_ERROR
    return buffer.getvalue() if is_alike and buffer.tell() < len(png) else png


def _levels(image: Image.Image) -> FloatArray:
    return np.asarray(image, dtype=np.float64)
