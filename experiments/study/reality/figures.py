"""Figures of what recordings measured; they can be read without colours."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...figures.axes import BLUE, GREY, WIDTH_IN, finish_axes, new_figure
from .projection import Heights
from .response import HeldOut, Recall

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BAND_M = 2.0  # of the distance
_LEAST = 30  # boxes in a band
_MAX_FRAMES = 30
_SMALL = 7.5
_STYLES = {
    "PETS, camera": ("o", BLUE),
    "KITTI, camera": ("^", "black"),
    "KITTI, LiDAR": ("v", "#777777"),
}


def plot_heights(heights: Heights) -> "Figure":
    """Drawn over predicted heights by distance: medians, and the middle 80 %."""
    figure = new_figure(WIDTH_IN, 2.8)
    axes = figure.add_subplot()
    bands = np.floor(heights.distance_m / _BAND_M)
    places, rows = [], []
    for band in np.unique(bands).tolist():
        mask = bands == band
        if mask.sum() >= _LEAST:
            places.append((band + 0.5) * _BAND_M)
            spread = np.quantile(heights.ratio[mask], [0.1, 0.5, 0.9])
            rows.append([*spread, np.median(heights.pinhole_ratio[mask])])
    low, middle, high, pinhole = np.array(rows).T
    axes.axhline(1.0, color=GREY, linewidth=1.0)
    axes.fill_between(places, low, high, color="#dddddd", label="10 to 90 %")
    axes.plot(places, middle, "o-", color=BLUE, markersize=4, label="median, calibrated lens")
    axes.plot(places, pinhole, "s--", color="black", mfc="none", ms=5, label="median, pinhole")
    axes.set_ylim(0.8, 1.2)
    axes.legend(fontsize=_SMALL, frameon=False, ncol=3, loc="upper right")
    finish_axes(axes, x="distance on the ground, m", y="drawn / predicted height", grid="y")
    return figure


def plot_recall(panels: Mapping[str, Mapping[str, Sequence[Recall]]]) -> "Figure":
    """Recall with 95 % intervals, and what the table "response" predicts, panel by panel.

    A panel has groups by what was watched.
    """
    figure = new_figure(WIDTH_IN, 3.3)
    handles: dict[str, Any] = {}
    for axes, (title, watched) in zip(figure.subplots(1, len(panels)), panels.items(), strict=True):
        names = [one.words for one in max(watched.values(), key=len)]  # in order
        names += [one.words for groups in watched.values() for one in groups]
        names = list(dict.fromkeys(names))
        for number, (name, groups) in enumerate(watched.items()):
            shift = 0.24 * (number - 0.5 * (len(watched) - 1))
            places = np.array([names.index(one.words) + shift for one in groups])
            value = np.array([one.measured.value for one in groups])
            low = value - [one.measured.low for one in groups]
            high = [one.measured.high for one in groups] - value
            marker, colour = _STYLES[name]
            handles[name] = axes.errorbar(
                places,
                value,
                yerr=np.maximum([low, high], 0.0),
                fmt=marker,
                color=colour,
                ms=4,
                capsize=2,
                linewidth=1.0,
            )
            predicted = [one.predicted for one in groups]
            (handles["table `response`"],) = axes.plot(places, predicted, "_k", ms=7, mew=2.0)
        axes.set_xticks(range(len(names)), [_short(name) for name in names], rotation=40)
        axes.set_title(title, fontsize=8)
        axes.set_ylim(0.0, 1.04)
        finish_axes(axes, y="share found" if axes is figure.axes[0] else None, grid="y")
    figure.legend(
        handles.values(),
        handles.keys(),
        loc="outside lower center",
        ncol=4,
        fontsize=_SMALL,
        frameon=False,
    )
    return figure


def _short(words: str) -> str:
    for long, short in (
        (" to ", "-"),
        (" and more", "+"),
        (" hidden", ""),
        (" px", ""),
        (" %", ""),
    ):
        words = words.replace(long, short)
    return words


def plot_confirmations(held: Mapping[str, HeldOut]) -> "Figure":
    """Share of starts confirmed within so many frames: real, by the fit, by "response"."""
    figure = new_figure(WIDTH_IN, 2.8)
    for axes, (title, one) in zip(figure.subplots(1, len(held)), held.items(), strict=True):
        frames = np.arange(1, _MAX_FRAMES + 1)
        for values, style, width, words in (
            (one.real, "-", 2.0, "real"),
            (one.predicted, "--", 1.5, "fitted to the other half"),
            (one.by_response, ":", 1.5, "response"),
        ):
            colour = BLUE if words == "real" else "black"
            axes.step(
                frames,
                values[:_MAX_FRAMES],
                style,
                where="post",
                color=colour,
                linewidth=width,
                label=words,
            )
        axes.set_ylim(0.4, 1.0)
        axes.set_xlim(2, _MAX_FRAMES)
        axes.set_title(title, fontsize=8)
        axes.legend(fontsize=_SMALL, frameon=False, loc="lower right")
        finish_axes(axes, x="frames", y="share of starts confirmed", grid="both")
    return figure
