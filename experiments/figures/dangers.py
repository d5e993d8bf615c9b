"""Dangerous places: the junction from above, each place where runs end in an impact."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from geometry.arrays import BoolArray, FloatArray, IntArray
from placement.layout import Layout
from placement.setting import Setting
from scenarios.weights import weight_share

from .axes import WIDTH_IN, new_axes, root_figure, show_square
from .evaluation import DARK_BELOW, SHADES
from .plan import draw_scene

_SAME_PLACE_M = 6.0  # across: less than from one lane to the oncoming one
_BORDER_M = 8.0
_MIN_HALF_SIZE_M = 30.0
_UNIT_COLOUR = "#CC0000"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Place:
    """Place where some runs end in an impact if nobody brakes.

    Attributes
    ----------
    position_m : (2,) float
        Middle of the road users then. World frame. [m]
    runs : (n,) int
        Indices of the runs.
    """

    position_m: FloatArray
    runs: IntArray

    def share_avoided(self, is_avoided: BoolArray, weight: FloatArray) -> float:
        """Share of these runs that is avoided, by weight; NaN if none has any."""
        return weight_share(is_avoided[self.runs], weight[self.runs])


def find_places(setting: Setting) -> tuple[Place, ...]:
    """Places of all impacts: those at most 6 m from one another are one place.

    Complete linkage: no two impacts of a place are farther apart. Places are in the order in which
    their runs first appear.
    """
    from scipy.cluster.hierarchy import fcluster, linkage

    points = np.array([run.vru_position_m[-1] for run in setting.runs])
    labels: IntArray = np.ones(len(points), dtype=np.int64)
    if len(points) > 1:
        tree = linkage(points, "complete")
        labels = fcluster(tree, _SAME_PLACE_M, criterion="distance").astype(np.int64)
    return tuple(
        Place(position_m=points[labels == label].mean(axis=0), runs=np.flatnonzero(labels == label))
        for label in dict.fromkeys(labels.tolist())
    )


def plot_dangers(
    setting: Setting,
    layout: Layout,
    is_avoided: BoolArray,
    *,
    places: Sequence[Place] | None = None,
    width_in: float = WIDTH_IN,
) -> Axes:
    """The junction from above with the share of runs avoided at each place: the darker the fewer.

    In metres, north up; the numbers are per cent. Units are triangles that point where they look. A
    place where all runs are avoided is a small white square without a number.
    """
    places = find_places(setting) if places is None else places
    axes = new_axes(width_in, width_in + (0.55 if width_in >= WIDTH_IN else 0.3))
    draw_scene(axes, setting.scene)
    outline = setting.scene.outline_m
    middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
    points = np.array([place.position_m for place in places])
    reach_m = float(np.abs(points - middle).max()) + _BORDER_M
    size = 15.0 if width_in >= WIDTH_IN else 12.0
    for place in places:
        _draw_place(axes, place, place.share_avoided(is_avoided, setting.axis.weight), size)
    for unit in layout.units:
        axes.plot(
            *unit.pose.position_m[:2],
            marker=(3, 0, unit.pose.yaw_deg - 90.0),
            markersize=7.0,
            markerfacecolor=_UNIT_COLOUR,
            markeredgecolor="white",
            markeredgewidth=0.6,
            linestyle="none",
            zorder=9,
            gid="unit",
        )
    show_square(axes, middle, max(reach_m, _MIN_HALF_SIZE_M))
    axes.set_xlabel("east (m)", fontsize=8)
    axes.set_ylabel("north (m)", fontsize=8)
    axes.tick_params(labelsize=7)
    bar = root_figure(axes).colorbar(
        ScalarMappable(Normalize(0.0, 100.0), SHADES),
        ax=axes,
        orientation="horizontal",
        fraction=0.04,
        pad=0.02,
        aspect=45,
    )
    bar.set_label("runs avoided there (%)", fontsize=8)
    bar.ax.tick_params(labelsize=7)
    return axes


def _draw_place(axes: Axes, place: Place, share: float, size: float) -> None:
    """Draw a mark with its number; `size` in points."""
    if not np.isfinite(share):  # runs that do not count
        return
    is_safe = share > 1.0 - 1.0e-9
    axes.plot(
        *place.position_m,
        marker="s" if is_safe else "o",  # small circles are sites
        markersize=(0.27 if is_safe else 1.0) * size,
        markerfacecolor=SHADES(share),
        markeredgecolor="black",
        markeredgewidth=0.7,
        linestyle="none",
        zorder=7.0 if is_safe else 8.0 - 0.5 * share,  # the most dangerous on top
        gid="place",
    )
    if is_safe:
        return
    east_m, north_m = place.position_m
    axes.text(
        east_m,
        north_m,
        f"{_whole_percent(share)}",
        fontsize=0.5 * size,
        ha="center",
        va="center_baseline",
        color="white" if share < DARK_BELOW else "black",
        zorder=8.0 - 0.5 * share,
        gid="share",
    )


def _whole_percent(share: float) -> int:
    """Per cent without digits, of what is not all: what is not quite none is never shown as it."""
    return 0 if share < 1.0e-9 else min(max(round(100.0 * share), 1), 99)
