"""Heatmaps of who detects when."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from geometry.arrays import BoolArray
from placement.evaluation import Evaluation, Verdict, run_outcome

from ..language import localized, mark, tr
from .axes import (
    BLUE,
    WIDTH_IN,
    Style,
    describe_run,
    literal,
    new_figure,
    unit_labels,
    write_beside,
)

_TIME_LABEL = mark("time before the impact without braking (s)")
_RED = "#CC0000"
_LAST_MOMENT: Style = {"color": _RED, "linestyle": (0, (3.0, 1.5)), "linewidth": 1.8}
_DIAMOND: Style = {"marker": "D", "markersize": 5.0, "linestyle": "none"}
_CONFIRMATION: Style = _DIAMOND | {
    "markerfacecolor": "white",
    "markeredgecolor": "black",
}
_DETECTED = BLUE
_MISSED = "#e6e6e6"


def plot_heatmaps(evaluation: Evaluation, run_indices: Sequence[int]) -> list[Axes]:
    """Who detects the VRU when, one pair of axes per run, in a new figure.

    Rows: the VUT, each RSU, all RSUs together. Columns: frames, by their time before
    the impact. The dashed red line is the last brake time; a diamond is a confirmation.
    """
    labels = unit_labels(evaluation.layout)
    units = evaluation.units
    rows = {
        "VUT": evaluation.vut,
        **{labels[name]: unit for name, unit in units.items()},
    }
    rows[tr("all RSUs")] = evaluation.rsu_all
    figure = new_figure(WIDTH_IN, 0.75 + len(run_indices) * (0.85 + 0.21 * len(rows)))
    panels = figure.subplots(len(run_indices), 1, squeeze=False)[:, 0]
    for axes, run_index in zip(panels, run_indices, strict=True):
        _draw_heatmap(axes, evaluation, rows, run_index)
    panels[-1].set_xlabel(tr(_TIME_LABEL), fontsize=9)
    below: Style = {"loc": "outside lower center", "ncols": 4, "frameon": False}
    figure.legend(handles=_legend(), fontsize=8, **below)
    return list(panels)


def _draw_heatmap(
    axes: Axes, evaluation: Evaluation, rows: Mapping[str, Verdict], run_index: int
) -> None:
    axis = evaluation.axis
    frames = axis.frames_of(run_index)
    times = axis.time_s[frames]
    half = 0.5 * (float(times[1] - times[0]) if len(times) > 1 else 0.1)
    detected: BoolArray = np.array(
        [verdict.detected[frames] for verdict in rows.values()]
    )
    axes.imshow(
        detected.astype(np.uint8),
        cmap=ListedColormap([_MISSED, _DETECTED]),
        vmin=0,
        vmax=1,
        aspect="auto",
        interpolation="nearest",
        extent=(times[0] - half, times[-1] + half, len(rows) - 0.5, -0.5),
    )
    between = np.arange(len(rows) - 1) + 0.5
    axes.hlines(between, *axes.get_xlim(), colors="white", linewidth=2.0, zorder=2)
    axes.set_yticks(range(len(rows)), [literal(row) for row in rows], fontsize=8)
    axes.tick_params(axis="both", length=0, labelsize=8)
    axes.spines[:].set_visible(False)
    confirmed = [verdict.confirmation_time_s[run_index] for verdict in rows.values()]
    axes.plot(confirmed, range(len(rows)), zorder=5, clip_on=False, **_CONFIRMATION)
    ends = [tr(run_outcome(verdict, axis, run_index)) for verdict in rows.values()]
    outcomes = axes.secondary_yaxis("right")
    outcomes.set_yticks(range(len(rows)), ends, fontsize=8)
    outcomes.tick_params(axis="y", length=0)
    outcomes.spines[:].set_visible(False)
    _draw_last_moment(axes, float(axis.last_brake_time_s[run_index]))
    title = mark("{run}: not avoided by all RSUs together")
    if evaluation.rsu_all.is_avoided[run_index]:
        title = mark("{run}: avoided by all RSUs together")
    title = literal(tr(title, run=describe_run(axis, run_index)))
    axes.set_title(title, fontsize=9, fontweight="bold", loc="left", pad=18.0)


def _draw_last_moment(axes: Axes, last_brake_s: float) -> None:
    first_s, last_s = axes.get_xlim()
    if last_brake_s < first_s:
        words = tr("in this run, any braking is too late")
        style: Style = {"xycoords": "axes fraction", "va": "baseline", "color": _RED}
        write_beside(axes, words, (0.0, 1.0), away_pt=(0.0, 3.0), **style)
        return
    # White below the gaps between the dashes: it stands out from dark cells without
    # colour, too.
    axes.axvline(last_brake_s, color="white", linewidth=3.2, zorder=4)
    axes.axvline(last_brake_s, zorder=4, gid="last brake time", **_LAST_MOMENT)
    is_right = last_brake_s > 0.5 * (first_s + last_s)
    time = localized(f"{last_brake_s:.2f}".replace("-", "\N{MINUS SIGN}"))
    words = tr("last moment to brake: {time} s", time=time)
    if is_right:
        away, ha = (-4.0, "right")
    else:
        away, ha = (4.0, "left")
    style = {"away_pt": (away, 3.0), "ha": ha, "va": "bottom", "color": _RED}
    write_beside(axes, words, (last_brake_s, -0.5), **style)


def _legend() -> list[Any]:
    return [
        Patch(facecolor=_DETECTED, label=tr("detected")),
        Patch(facecolor=_MISSED, label=tr("not detected")),
        Line2D([], [], label=tr("confirmed"), **_CONFIRMATION),
        Line2D([], [], label=tr("last moment"), **_LAST_MOMENT),
    ]
