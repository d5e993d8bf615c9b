"""Names of units on a plan, so that none hides another."""

import math
from collections import Counter

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from placement.candidates import CandidatePose
from placement.layout import Layout

from .figures import literal, unit_labels

MAX_LABELLED_UNITS = 40
"""Of more units, the plan tells how many there are at each place."""

_SAME_PLACE_M, _SAME_WAY_DEG = 1.0, 30.0
HALO = withStroke(linewidth=3.0, foreground="white")


def label_units(axes: Axes, layout: Layout) -> None:
    """Write beside each camera its short name; or, of many units, how many there are at a place.

    Parameters
    ----------
    axes : Axes
        A plan, in metres.
    layout : Layout
        Whose units.
    """
    if len(layout.units) <= MAX_LABELLED_UNITS:
        _draw_labels(axes, layout)
    else:
        _draw_counts(axes, layout)


def _draw_labels(axes: Axes, layout: Layout) -> None:
    """Beside each camera, on the side where it looks: cameras on one pole look apart.

    Those that look the same way from one pole share a label: else one would hide the other.
    """
    labels = unit_labels(layout)
    groups: list[list[CandidatePose]] = []
    for unit in layout.units:
        found = next((group for group in groups if _looks_alike(unit, group[0])), None)
        if found is None:
            groups.append([unit])
        else:
            found.append(unit)
    for group in groups:
        yaw = math.radians(group[0].pose.yaw_deg)
        east, north = math.cos(yaw), math.sin(yaw)
        axes.annotate(
            literal(", ".join(labels[unit.id] for unit in group)),
            xy=(group[0].pose.position_m[0], group[0].pose.position_m[1]),
            xytext=(8.0 * east, 11.0 * north),
            textcoords="offset points",
            ha="center" if abs(east) < 0.3 else "left" if east > 0.0 else "right",
            va="center",
            fontsize=9,
            fontweight="bold",
            path_effects=[HALO],
            zorder=9,
            annotation_clip=True,
        )


def _looks_alike(unit: CandidatePose, other: CandidatePose) -> bool:
    turn_deg = (unit.pose.yaw_deg - other.pose.yaw_deg + 180.0) % 360.0 - 180.0
    apart_m = np.linalg.norm(unit.pose.position_m[:2] - other.pose.position_m[:2])
    return bool(apart_m < _SAME_PLACE_M and abs(turn_deg) < _SAME_WAY_DEG)


def _draw_counts(axes: Axes, layout: Layout) -> None:
    """How many units there are at each place, in the place of labels that would hide all."""
    places = Counter(tuple(np.round(unit.pose.position_m[:2], 1)) for unit in layout.units)
    for (east_m, north_m), n_units in places.items():
        axes.annotate(
            f"{n_units}\N{MULTIPLICATION SIGN}",
            xy=(east_m, north_m),
            xytext=(0.0, 9.0),
            textcoords="offset points",
            ha="center",
            va="bottom",
            fontsize=8,
            fontweight="bold",
            path_effects=[HALO],
            zorder=9,
            annotation_clip=True,
        )
