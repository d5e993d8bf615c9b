"""Figures in one style.

Sizes, colours, axes, labels, PNG files; without pyplot's global state.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from typing import TYPE_CHECKING, Any

from geometry.arrays import FloatArray
from placement.layout import Layout
from scenarios.positions import AT_ZERO
from scenarios.runs import FrameAxis

from ..language import language, localized, tr

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# M. Okabe, K. Ito, "Color Universal Design" (2008): distinct with any colour vision.
BLUE = "#0072B2"
SKY = "#56B4E9"
GREEN = "#009E73"
ORANGE = "#E69F00"
VERMILION = "#D55E00"
PINK = "#CC79A7"
GREY = "#999999"

UNIT_COLOURS = (BLUE, VERMILION, GREEN, PINK, ORANGE, SKY)
WIDTH_IN = 6.8
NARROW_IN = 4.0
"""Width of figures whose letters can be read on a phone without moving the figure."""

Style = dict[str, Any]
"""Properties of a matplotlib artist by name, as its method takes them."""

CLASS_STYLES: dict[str, Style] = {
    "building": {"facecolor": "#c9c4bb", "edgecolor": "#8d887f", "linewidth": 0.8},
    "wall": {"facecolor": "#5b5b5b", "edgecolor": "#5b5b5b", "linewidth": 1.2},
    "vegetation": {"facecolor": "#b7d3ae", "edgecolor": "#7d9c73", "linewidth": 0.6},
    "parked vehicle": {
        "facecolor": "#a9a9a9",
        "edgecolor": "#6e6e6e",
        "linewidth": 0.6,
    },
    "traffic light": {"facecolor": "#7a7a7a", "edgecolor": "#7a7a7a", "linewidth": 0.8},
}
"""Of things by their class."""

_DPI = 160
_MAX_LABEL_LENGTH = 8


def new_figure(
    width_in: float, height_in: float, *, dpi: float | None = None
) -> "Figure":
    """An empty figure, drawn by Agg, in inches.

    A narrow one has as many pixels as a usual one. It looks the same whatever a user's
    own matplotlibrc says.
    """
    # Takes longer to load than to draw: cached pictures do without.
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    mpl.rcdefaults()
    if dpi is None:
        if width_in == NARROW_IN:
            dpi = WIDTH_IN * _DPI / width_in
        else:
            dpi = _DPI
    figure = Figure(figsize=(width_in, height_in), dpi=dpi, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def new_axes(width_in: float, height_in: float) -> "Axes":
    """One pair of axes in a figure of its own; sizes in inches."""
    return new_figure(width_in, height_in).add_subplot()


def finish_axes(
    axes: "Axes",
    *,
    x: str | None = None,
    y: str | None = None,
    size: float = 8,
    grid: str | None = None,
    hidden: tuple[str, ...] = ("top", "right"),
) -> None:
    """Set labels, ticks and a light grid of axes, without a frame.

    `grid` is ``x``, ``y`` or ``both``.
    """
    if x is not None:
        axes.set_xlabel(x, fontsize=size)
    if y is not None:
        axes.set_ylabel(y, fontsize=size)
    axes.tick_params(labelsize=8)
    if grid is not None:
        axes.grid(axis=grid, color="#dddddd", linewidth=0.6)  # type: ignore[arg-type]
        axes.set_axisbelow(True)
    for side in hidden:
        axes.spines[side].set_visible(False)


def write_beside(
    axes: "Axes",
    text: str,
    at: tuple[float, float],
    *,
    away_pt: tuple[float, float],
    **style: Any,
) -> None:
    """Write a text so many points away from a point of the axes."""
    drawn: Style = {"va": "center", "fontsize": 8} | style
    axes.annotate(text, xy=at, xytext=away_pt, textcoords="offset points", **drawn)


def show_square(axes: "Axes", middle_m: FloatArray, half_size_m: float) -> None:
    """Show a square of the ground, as long in east as in north."""
    axes.set_aspect("equal")
    axes.set_xlim(middle_m[0] - half_size_m, middle_m[0] + half_size_m)
    axes.set_ylim(middle_m[1] - half_size_m, middle_m[1] + half_size_m)


def root_figure(drawn: "Axes | Figure") -> "Figure":
    """The figure that some axes are in."""
    figure = drawn.get_figure(root=True)
    if figure is None:
        raise ValueError("axes that are in no figure")
    return figure


@contextmanager
def drawing_any_name() -> Iterator[None]:
    """Draw letters that the font lacks as boxes, without a warning."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        yield


def to_png(drawn: "Axes | Figure") -> bytes:
    """A figure, or the one that some axes are in, as a PNG file.

    Equal ones give equal bytes.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = root_figure(drawn)
    if language() != "en":
        _localize_ticks(figure)
    engine = figure.get_layout_engine()
    buffer = BytesIO()
    with drawing_any_name():
        # savefig would draw everything twice, and before that twice more to lay it out.
        if engine is not None:
            engine.execute(figure)
            figure.set_layout_engine("none")
        # print_png has no types.
        canvas: Any = FigureCanvasAgg(figure)
        canvas.print_png(buffer, metadata={"Software": None})
    return buffer.getvalue()


def _localize_ticks(figure: "Figure") -> None:
    """Write numbers at the axes as the language that is spoken does."""
    from matplotlib.ticker import ScalarFormatter

    class _Localized(ScalarFormatter):
        def __call__(self, x: float, pos: int | None = None) -> str:
            return localized(super().__call__(x, pos))

    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        if type(axis.get_major_formatter()) is ScalarFormatter:
            axis.set_major_formatter(_Localized())


def literal(name: str) -> str:
    """A name for matplotlib to draw letter by letter.

    No mathematics, and never left out.
    """
    escaped = name.replace("$", r"\$")
    if escaped.startswith("_"):
        return f" {escaped}"
    return escaped


def unit_labels(layout: Layout) -> dict[str, str]:
    """Short labels of a layout's units by id.

    The ids if all are short, else "#1", "#2" ..
    """
    ids = [unit.id for unit in layout.units]
    if all(len(unit_id) <= _MAX_LABEL_LENGTH for unit_id in ids):
        return {unit_id: unit_id for unit_id in ids}
    return {unit_id: f"#{number}" for number, unit_id in enumerate(ids, start=1)}


def describe_run(axis: FrameAxis, run_index: int) -> str:
    """A run in words: case, approach and speed.

    Also the position unless it is 0, and the weather unless it is day.
    """
    weather = axis.weathers[run_index]
    position = axis.positions[run_index]
    where = tr(axis.approaches[run_index])
    if position != AT_ZERO.name:
        where = f"{where} ({position} m)"
    words = tr(
        "{case} from the {approach} at {speed_kmh:g} km/h",
        case=axis.cases[run_index],
        approach=where,
        speed_kmh=float(axis.vut_speed_kmh[run_index]),
    )
    if weather == "day":
        return words
    return f"{words}, {tr(weather)}"
