"""The junction with the share of runs that are avoided at each place."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize

from geometry.arrays import BoolArray, FloatArray, IntArray
from placement.layout import Layout
from placement.setting import Setting
from scenarios.weights import weight_share

from ..language import tr
from .axes import WIDTH_IN, Style, new_axes, root_figure, show_square
from .plan import draw_scene

SHADES = LinearSegmentedColormap.from_list("left over", ["#303030", "#ffffff"])
"""Of shares that are avoided: the more accidents are left, the darker."""
# From there white and black letters stand out alike.
_DARK_BELOW = 0.34
# Across: less than from one lane to the oncoming one.
_SAME_PLACE_M = 6.0
_BORDER_M = 8.0
_MIN_HALF_SIZE_M = 30.0
_RED: Style = {
    "markerfacecolor": "#CC0000",
    "markeredgecolor": "white",
    "markeredgewidth": 0.6,
}
_UNIT_STYLE: Style = _RED | {"markersize": 7.0, "linestyle": "none"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImpactPlace:
    """Where some runs end in an impact if nobody brakes.

    Attributes
    ----------
    position_m : (2,) float
        Middle of the road users then. World frame. [m]
    runs : (n,) int
        Indices of the runs.
    """

    # (2,): middle of the road users then. World frame. [m]
    position_m: FloatArray
    # (n,): indices of the runs.
    runs: IntArray

    def share_avoided(self, is_avoided: BoolArray, weight: FloatArray) -> float:
        """Share of these runs that is avoided, by weight; NaN if none has any."""
        return weight_share(is_avoided[self.runs], weight[self.runs])


def find_places(setting: Setting) -> tuple[ImpactPlace, ...]:
    """Places of all impacts: those at most 6 m from one another are one place.

    Complete linkage: no two impacts of a place are farther apart. Places are in the
    order in which their runs first appear.
    """
    from scipy.cluster.hierarchy import fcluster, linkage

    points = np.array([run.vru_position_m[-1] for run in setting.runs])
    labels: IntArray = np.ones(len(points), dtype=np.int64)
    if len(points) > 1:
        tree = linkage(points, "complete")
        labels = fcluster(tree, _SAME_PLACE_M, criterion="distance").astype(np.int64)
    return tuple(
        ImpactPlace(
            position_m=points[labels == label].mean(axis=0),
            runs=np.flatnonzero(labels == label),
        )
        for label in dict.fromkeys(labels.tolist())
    )


def plot_dangers(
    setting: Setting,
    layout: Layout,
    is_avoided: BoolArray,
    *,
    places: Sequence[ImpactPlace] | None = None,
    width_in: float = WIDTH_IN,
) -> Axes:
    """The junction from above with the share of runs avoided at each place.

    The darker the fewer.

    In metres, north up; the numbers are per cent. Units are triangles that point where
    they look. A place where all runs are avoided is a small white square without a
    number.
    """
    if places is None:
        places = find_places(setting)
    axes = new_axes(width_in, width_in + (0.55 if width_in >= WIDTH_IN else 0.3))
    draw_scene(axes, setting.scene)
    outline = setting.scene.outline_m
    middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
    points = np.array([place.position_m for place in places])
    reach_m = float(np.abs(points - middle).max()) + _BORDER_M
    if width_in >= WIDTH_IN:
        size = 15.0
    else:
        size = 12.0
    for place in places:
        _draw_place(
            axes, place, place.share_avoided(is_avoided, setting.axis.weight), size
        )
    for unit in layout.units:
        pointing = (3, 0, unit.pose.yaw_deg - 90.0)
        axes.plot(
            *unit.pose.position_m[:2],
            marker=pointing,
            zorder=9,
            gid="unit",
            **_UNIT_STYLE,
        )
    show_square(axes, middle, max(reach_m, _MIN_HALF_SIZE_M))
    axes.set_xlabel(tr("east (m)"), fontsize=8)
    axes.set_ylabel(tr("north (m)"), fontsize=8)
    axes.tick_params(labelsize=7)
    shades = ScalarMappable(Normalize(0.0, 100.0), SHADES)
    below: Style = {
        "orientation": "horizontal",
        "fraction": 0.04,
        "pad": 0.02,
        "aspect": 45,
    }
    bar = root_figure(axes).colorbar(shades, ax=axes, **below)
    bar.set_label(tr("runs avoided there (%)"), fontsize=8)
    bar.ax.tick_params(labelsize=7)
    return axes


def _draw_place(axes: Axes, place: ImpactPlace, share: float, size: float) -> None:
    """Draw a mark with its number; `size` in points."""
    # Runs that do not count.
    if not np.isfinite(share):
        return
    mark: Style = {
        "markeredgecolor": "black",
        "markeredgewidth": 0.7,
        "linestyle": "none",
    }
    mark |= {"markerfacecolor": SHADES(share), "gid": "place"}
    # Small circles are sites.
    if share > 1.0 - 1.0e-9:
        axes.plot(
            *place.position_m, marker="s", markersize=0.27 * size, zorder=7.0, **mark
        )
        return
    # The most dangerous.
    on_top = 8.0 - 0.5 * share
    axes.plot(*place.position_m, marker="o", markersize=size, zorder=on_top, **mark)
    # What is not quite none is never shown as it.
    if share < 1.0e-9:
        shown = 0
    else:
        shown = min(max(round(100.0 * share), 1), 99)
    if share < _DARK_BELOW:
        colour = "white"
    else:
        colour = "black"
    letters: Style = {"ha": "center", "va": "center_baseline", "fontsize": 0.5 * size}
    east_m, north_m = place.position_m
    axes.text(
        east_m, north_m, f"{shown}", color=colour, zorder=on_top, gid="share", **letters
    )
