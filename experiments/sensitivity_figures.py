"""Tornado: how far each assumption moves a layout's worth, the widest bar on top."""

from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes

from geometry.errors import InputError

from .figures import BLUE, VERMILION, WIDTH_IN, new_axes
from .sensitivity_words import TITLES, value_text

# By name: in words, and how many of the axis' units one of ours is.
QUANTITIES = {
    "apr": ("share of the runs avoided (APR)", 100.0),
    "smallest_margin_s": ("smallest time to spare", 1.0),
}
_AXIS_LABELS = {
    "apr": "share of the runs avoided, APR (%)",
    "smallest_margin_s": "smallest time to spare in the runs that are avoided (s)",
}
_NOTHING_MOVES = 1.0e-9
_LEAST_SPAN = {"apr": 2.0, "smallest_margin_s": 0.2}  # so that nothing tiny fills the figure
_ROOM = 0.22  # for the values beside the bars, of the span


def plot_sensitivity(
    summary: Mapping[str, Any], *, quantity: str = "apr", axes: Axes | None = None
) -> Axes:
    """A bar for each assumption, from the worst to the best that its values lead to.

    Parameters
    ----------
    summary : mapping
        By :func:`experiments.sensitivity_tables.summarise_sensitivity`.
    quantity : {"apr", "smallest_margin_s"}
        What is drawn.
    axes : Axes, optional
        Where to; by default in a figure of their own.

    Returns
    -------
    axes : Axes
        Worse than planned: to the left of the line, hatched; better: to the right, plain. The
        values stand at the ends of the bars. What moves nothing has no bar.

    Raises
    ------
    InputError
        There is no such quantity.
    """
    if quantity not in QUANTITIES:
        raise InputError("quantity", quantity, "one of " + ", ".join(QUANTITIES))
    scale = QUANTITIES[quantity][1]
    planned = scale * (summary["planned"][quantity] or 0.0)
    rows = [one for one in summary["assumptions"] if one["varied"]]
    ends = {one["name"]: _ends(one, quantity, scale) for one in rows}
    # The widest on top; where nothing is known, at the bottom.
    rows.sort(key=lambda one: _span(ends[one["name"]], planned))
    if axes is None:
        axes = new_axes(WIDTH_IN, 0.9 + 0.3 * max(len(rows), 1))
    for row, one in enumerate(rows):
        _draw_row(axes, row, one["name"], ends[one["name"]], planned)
    axes.axvline(planned, color="black", linewidth=1.2, zorder=4, gid="planned")
    axes.set_yticks(range(len(rows)), [TITLES[one["name"]] for one in rows], fontsize=8)
    axes.set_ylim(-0.6, len(rows) - 0.4)
    reached = [planned, *(end[0] for pair in ends.values() for end in pair)]
    span = max(max(reached) - min(reached), _LEAST_SPAN[quantity])
    axes.set_xlim(min(reached) - _ROOM * span, max(reached) + _ROOM * span)
    axes.set_xlabel(_AXIS_LABELS[quantity] + "; line: as planned", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    return axes


def _ends(one: Mapping[str, Any], quantity: str, scale: float) -> list[tuple[float, str]]:
    """The worst and the best of an assumption's values, with what they are; none if unknown."""
    known = [value for value in one["varied"] if value[quantity] is not None]
    if not known:
        return []
    worst = min(known, key=lambda value: float(value[quantity]))
    best = max(known, key=lambda value: float(value[quantity]))
    found = []
    for value in (worst, best):
        star = "*" if quantity != "apr" and value["lost_runs"] else ""
        found.append((scale * value[quantity], value_text(one["name"], value["value"]) + star))
    return found


def _span(ends: list[tuple[float, str]], planned: float) -> float:
    if not ends:
        return -1.0
    return max(ends[1][0], planned) - min(ends[0][0], planned)


def _draw_row(
    axes: Axes, row: int, name: str, ends: list[tuple[float, str]], planned: float
) -> None:
    if not ends:
        _note(axes, planned, row, "left to chance" if name == "packet_loss" else "nothing avoided")
        return
    (worst, worst_text), (best, best_text) = ends
    if best - planned <= _NOTHING_MOVES and planned - worst <= _NOTHING_MOVES:
        _note(axes, planned, row, "no change")
        return
    if worst < planned - _NOTHING_MOVES:
        axes.barh(
            row, planned - worst, left=worst, height=0.62, facecolor=VERMILION, edgecolor="black",
            linewidth=0.6, hatch="////", gid=f"{name} worse",
        )  # fmt: skip
        _label(axes, worst, row, worst_text, side="left")
    if best > planned + _NOTHING_MOVES:
        axes.barh(
            row, best - planned, left=planned, height=0.62, facecolor=BLUE, edgecolor="black",
            linewidth=0.6, gid=f"{name} better",
        )  # fmt: skip
        _label(axes, best, row, best_text, side="right")


def _label(axes: Axes, x: float, row: int, text: str, *, side: str) -> None:
    is_left = side == "left"
    axes.annotate(
        text,
        (x, row),
        xytext=(-4.0 if is_left else 4.0, 0.0),
        textcoords="offset points",
        ha="right" if is_left else "left",
        va="center",
        fontsize=8,
    )


def _note(axes: Axes, planned: float, row: int, text: str) -> None:
    axes.annotate(
        text,
        (planned, row),
        xytext=(5.0, 0.0),
        textcoords="offset points",
        va="center",
        fontsize=7,
        color="#555555",
    )
