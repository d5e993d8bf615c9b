"""Figures of layouts in sampled worlds: staircases, intervals of means and of differences."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from geometry.errors import InputError, Unquoted
from placement.sampling import SampledApr

from .figures import BLUE, GREEN, PINK, VERMILION, WIDTH_IN, literal, new_axes
from .tables import percent

_STRIP = 0.08  # height of a mark's row
_STYLES = (  # told apart by their lines and marks where colours are not
    (BLUE, "-", "o"),
    (VERMILION, "--", "s"),
    (GREEN, "-.", "^"),
    (PINK, ":", "D"),
)
MAX_STAIRCASES = len(_STYLES)
"""Of more layouts, intervals are drawn in place of staircases."""
_ROW_IN, _PAIR_ROW_IN = 0.27, 0.4
_MAX_NAME_LENGTH = 32
_LEAST_SPAN_POINTS = 1.0


def plot_sampled_apr(judged: Sequence[SampledApr], *, axes: Axes | None = None) -> Axes:
    """What layouts avoid in sampled worlds, any number of them.

    Parameters
    ----------
    judged : sequence of SampledApr
        At least one. Up to ``MAX_STAIRCASES`` have a staircase each: in what share of the worlds
        the layout avoids at most how much; line styles and marks tell them apart without colour,
        and below the staircases a mark stands at each mean, with its 95 % confidence interval. Of
        more: see :func:`plot_intervals`.
    axes : Axes, optional
        Where to draw; by default in a figure of their own.

    Raises
    ------
    InputError
        There is none.
    """
    if not judged:
        raise InputError("layouts", Unquoted("none"), "at least one")
    if len(judged) > MAX_STAIRCASES:
        return plot_intervals(judged, axes=axes)
    if axes is None:
        axes = new_axes(WIDTH_IN, 3.2)
    for row, (item, (colour, line, mark)) in enumerate(zip(judged, _STYLES, strict=False)):
        estimate = item.estimate
        axes.ecdf(item.apr_by_sample, color=colour, linestyle=line, linewidth=1.8)
        axes.errorbar(
            [estimate.mean],
            [-_STRIP * (row + 1)],
            xerr=[[estimate.mean - estimate.low], [estimate.high - estimate.mean]],
            color=colour,
            marker=mark,
            markersize=6.0,
            markerfacecolor="white",
            linestyle=line,  # of the legend: one point draws no line
            elinewidth=1.2,
            capsize=3.0,
            clip_on=False,
            label=literal(f"{item.layout.name}: mean {percent(estimate.mean)}"),
            zorder=3,
        )
    axes.axhline(0.0, color="#999999", linewidth=0.8)
    axes.set_ylim(-_STRIP * (len(judged) + 1), 1.02)
    axes.set_yticks(np.linspace(0.0, 1.0, 6))
    axes.set_xlabel("share of the accidents avoided (APR)", fontsize=9)
    axes.set_ylabel("share of the sampled worlds\nwith at most this APR", fontsize=9)
    axes.xaxis.set_major_formatter(lambda value, _: f"{100.0 * value:.4g} %")
    axes.yaxis.set_major_formatter(lambda value, _: f"{100.0 * value:.0f} %")
    _tidy(axes)
    axes.grid(color="#dddddd", linewidth=0.6)
    axes.legend(fontsize=8, loc="upper left")
    return axes


def plot_intervals(judged: Sequence[SampledApr], *, axes: Axes | None = None) -> Axes:
    """A row per layout: its mean, the interval of the mean, and its worst and best world.

    Parameters
    ----------
    judged : sequence of SampledApr
        The first one on top.
    axes : Axes, optional
        Where to draw; by default in a figure of their own.

    Returns
    -------
    axes : Axes
        Dot: mean; whisker with caps: its 95 % confidence interval; thin line: from the worst to
        the best world.
    """
    if axes is None:
        axes = new_axes(WIDTH_IN, 1.0 + _ROW_IN * len(judged))
    for row, item in enumerate(judged):
        estimate, worlds = item.estimate, item.apr_by_sample
        axes.hlines(
            row, 100.0 * worlds.min(), 100.0 * worlds.max(), color="#999999", linewidth=1.0,
            linestyle=(0, (1.0, 1.5)), zorder=2,
        )  # fmt: skip
        _whisker(axes, row, estimate.mean, estimate.low, estimate.high)
        axes.annotate(
            percent(estimate.mean), (1.0, row), xycoords=("axes fraction", "data"),
            xytext=(4.0, 0.0), textcoords="offset points", va="center", fontsize=8,
        )  # fmt: skip
    axes.set_yticks(range(len(judged)), [_name(item.layout.name) for item in judged], fontsize=8)
    axes.set_ylim(len(judged) - 0.5, -0.5)
    axes.set_xlabel(
        "share of the accidents avoided, APR (%)\nmean and its 95 % interval; dotted: "
        "from the worst to the best world",
        fontsize=8,
    )
    _tidy(axes)
    axes.grid(axis="x", color="#dddddd", linewidth=0.6)
    return axes


def plot_differences(pairs: Sequence[Mapping[str, Any]], *, axes: Axes | None = None) -> Axes:
    """A row per pair of layouts: the mean difference in the same worlds, with its interval.

    Parameters
    ----------
    pairs : sequence of mapping
        "pairs" of :func:`experiments.uncertainty_summary.summarise_uncertainty`.
    axes : Axes, optional
        Where to draw; by default in a figure of their own.

    Returns
    -------
    axes : Axes
        Filled dot: the interval leaves out zero; open: it does not, there is no sure difference.
    """
    if axes is None:
        axes = new_axes(WIDTH_IN, 1.0 + _PAIR_ROW_IN * max(len(pairs), 1))
    for row, pair in enumerate(pairs):
        _whisker(
            axes, row, pair["mean"], pair["low"], pair["high"],
            is_open=pair["low"] <= 0.0 <= pair["high"],
        )  # fmt: skip
    axes.axvline(0.0, color="black", linewidth=1.2, zorder=1)
    names = [f"{_name(pair['first'])}\nminus {_name(pair['second'])}" for pair in pairs]
    axes.set_yticks(range(len(pairs)), names, fontsize=8)
    axes.set_ylim(len(pairs) - 0.5, -0.5)
    low, high = axes.get_xlim()
    middle, half = 0.5 * (low + high), 0.5 * max(high - low, _LEAST_SPAN_POINTS)
    axes.set_xlim(middle - half, middle + half)
    axes.set_xlabel(
        "difference of the APR in the same worlds (points)\n"
        "with its 95 % interval; open: may be zero",
        fontsize=8,
    )
    _tidy(axes)
    axes.grid(axis="x", color="#dddddd", linewidth=0.6)
    return axes


def _whisker(
    axes: Axes, row: int, mean: float, low: float, high: float, *, is_open: bool = False
) -> None:
    axes.errorbar(
        [100.0 * mean],
        [row],
        xerr=[[100.0 * (mean - low)], [100.0 * (high - mean)]],
        color=BLUE,
        marker="o",
        markersize=6.0,
        markerfacecolor="white" if is_open else BLUE,
        markeredgecolor=BLUE,
        linestyle="none",
        elinewidth=1.6,
        capsize=4.0,
        zorder=3,
    )


def _name(name: str) -> str:
    short = name
    if len(name) > _MAX_NAME_LENGTH:
        short = name[: _MAX_NAME_LENGTH - 1] + "\N{HORIZONTAL ELLIPSIS}"
    return literal(short)


def _tidy(axes: Axes) -> None:
    axes.tick_params(labelsize=8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
