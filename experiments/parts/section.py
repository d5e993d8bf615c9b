"""Sections of the report.

A heading, and below it text, tables and figures.
"""

import base64
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar

import numpy as np

from ..figures.axes import root_figure, to_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_T = TypeVar("_T")
MAX_TRUE_COLOUR_BYTES = 300_000
"""PNG files of up to so many bytes keep all colours: a palette would save little."""
_N_COLOURS = 256
_LARGEST_ERROR = 32.0
# Of 255, of any one channel: not seen by eye.
_LARGEST_MEAN_ERROR = 1.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table; with `summary` one to unfold, below these words.

    Attributes
    ----------
    numeric : collection of int
        Columns that are numbers.
    is_open : bool
        Whether a table to unfold is unfolded from the start.
    """

    kind: ClassVar[str] = "table"
    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]
    # Columns that are numbers.
    numeric: Collection[int] = ()
    summary: str = ""
    # Unfolded from the start.
    is_open: bool = False


def tabulate(
    caption: str,
    items: Iterable[_T],
    columns: Mapping[str, Callable[[_T], object]],
    **more: Any,
) -> Table:
    """A table with a row per item.

    Each column has a head, and what it says of an item.

    `more` are further fields of the table by name.
    """
    rows = [[cell(item) for cell in columns.values()] for item in items]
    return Table(caption=caption, columns=[*columns], rows=rows, **more)


@dataclass(frozen=True, slots=True)
class Bullets:
    """Sentences as a list."""

    kind: ClassVar[str] = "bullets"
    sentences: Sequence[str]


@dataclass(frozen=True, slots=True)
class Subheading:
    """A heading within a section."""

    kind: ClassVar[str] = "subheading"
    text: str


@dataclass(frozen=True, slots=True)
class Filled:
    """A template of the report, with the values that it shows."""

    kind: ClassVar[str] = "filled"
    template: str
    values: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Code:
    """A command line."""

    kind: ClassVar[str] = "code"
    text: str


@dataclass(frozen=True, slots=True)
class Box:
    """Blocks in a box of a style of ``report.css``, such as "beside".

    Side by side.
    """

    kind: ClassVar[str] = "box"
    style: str
    blocks: "Sequence[Block]"


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A figure as the page shows it, with title and caption below."""

    kind: ClassVar[str] = "picture"
    title: str
    caption: str
    # For those who do not see it.
    alt: str
    # Base64.
    image: str
    width_px: int
    height_px: int
    # At which letters of 8 pt are that high.
    width_in: float
    format: Literal["png", "jpeg"] = "png"
    # The same for a phone.
    narrow: "Picture | None" = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Sketch:
    """A drawing of a few lines, with what it shows below."""

    kind: ClassVar[str] = "sketch"
    title: str
    code: str
    # Half the side of the square that is drawn.
    half: int
    # Class of ``report.css``, and data of an SVG path.
    paths: Sequence[tuple[str, str]]


Pictures = tuple[Picture, ...]
Block = str | Table | Bullets | Subheading | Filled | Code | Box | Picture | Sketch
"""A text is a paragraph; `Markup`, what a template has made, is shown as it is."""


@dataclass(frozen=True, slots=True)
class Section:
    """A section of the report.

    Its id is what links and the list of contents refer to.
    """

    id: str
    title: str
    blocks: Sequence[Block]
    # Its title alone is in sight.
    is_folded: bool = False


def build_picture(
    drawn: "Figure | Axes",
    *,
    title: str,
    caption: str,
    alt: str,
    narrow: "Figure | Axes | None" = None,
) -> Picture:
    """A figure with its words.

    Equal ones give equal pictures. `narrow` is drawn for a phone.
    """
    from PIL import Image

    figure = root_figure(drawn)
    png = with_palette(to_png(figure))
    width_px, height_px = Image.open(BytesIO(png)).size
    words: dict[str, Any] = {"title": title, "caption": caption, "alt": alt}
    return Picture(
        **words,
        image=base64.b64encode(png).decode(),
        width_px=width_px,
        height_px=height_px,
        width_in=round(float(figure.get_figwidth()), 2),
        narrow=None if narrow is None else build_picture(narrow, **words),
    )


def with_palette(png: bytes) -> bytes:
    """A PNG file, with at most 256 colours where that is not seen.

    Only where it spares much.

    It is the same file where that is small, would not become smaller, or would look
    different.
    """
    from PIL import Image

    if len(png) <= MAX_TRUE_COLOUR_BYTES:
        return png
    image = Image.open(BytesIO(png)).convert("RGB")
    # Colours of small marks count like those of wide areas, which a median cut would
    # let win.
    reduced = image.quantize(
        _N_COLOURS,
        method=Image.Quantize.MAXCOVERAGE,
        kmeans=1,
        dither=Image.Dither.NONE,
    )
    levels, before = (
        np.asarray(one, dtype=float) for one in (reduced.convert("RGB"), image)
    )
    error = np.abs(levels - before)
    buffer = BytesIO()
    reduced.save(buffer, format="png", optimize=True)
    is_alike = error.max() <= _LARGEST_ERROR and error.mean() <= _LARGEST_MEAN_ERROR
    if is_alike and buffer.tell() < len(png):
        return buffer.getvalue()
    return png
