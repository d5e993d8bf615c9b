"""Labels that do not lie on one another.

Each is put on a free side of its point.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from geometry.arrays import FloatArray
from geometry.errors import InputError
from geometry.junction import arm_mouth, build_junction, street_names
from geometry.notes import assumed_sites
from geometry.registry import load_entry
from geometry.scene import Scene
from placement.candidates import CandidatePose
from placement.layout import Layout
from scenarios.positions import AT_ZERO
from scenarios.runs import Run

from ..language import tr
from .axes import Style, literal, root_figure, unit_labels, write_beside

HALO = withStroke(linewidth=3.0, foreground="white")
_POINTS_PER_INCH = 72.0
_LETTER = 0.64
# Width and height of a letter, in font sizes.
_LINE = 1.3
# Points around a label.
_APART = 1.5
_TURNS_DEG = (0.0, 45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0)
_MORE_POINTS = (0.0, 7.0, 15.0, 26.0)
MAX_LABELLED_UNITS = 40
"""Of more units, the plan tells how many there are at each place."""
# Of the way to the frame.
_NAMES_AT = 0.8
# Cosine of the angle to the mouth, seen from the middle.
_NEAR_ITS_MOUTH = 0.77
ARROW_POINTS = 13.0
"""From a pole to the tip of its unit's arrow."""
_SAME_PLACE_M = 1.0
_SAME_WAY_DEG = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TextLabel:
    """A text of one line next to a point."""

    text: str
    # In the axes' data. [m]
    point_m: tuple[float, float]
    # side that it is put on if free, counter-clockwise from east
    toward_deg: float = 45.0
    # From the point to the text. [points]
    gap: float = 4.0
    # Of the letters. [points]
    size: float = 8.0
    # Drawn where no side is free, too.
    is_kept: bool = True
    style: Style | None = None


def draw_labels(
    axes: Axes,
    labels: Sequence[TextLabel],
    *,
    marks_m: FloatArray | None = None,
    mark: float = 6.0,
) -> None:
    """Write labels where they hide neither one another nor a mark.

    The first ones choose first.

    The axes have their final limits and are as long in east as in north; labels beyond
    are left out. `marks_m` are the middles of marks, (n, 2) [m], half of whose size is
    `mark` [points].
    """
    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    box = axes.get_position()
    width_in, height_in = root_figure(axes).get_size_inches()
    # Before the figure is laid out axes are a little smaller: what is apart then stays
    # apart.
    scale = _POINTS_PER_INCH * min(
        box.width * width_in / (east - west), box.height * height_in / (north - south)
    )
    corner = np.array([west, south])
    frame = np.array([east - west, north - south]) * scale
    if marks_m is None:
        marks = np.empty((0, 2))
    else:
        marks = (marks_m - corner) * scale
    taken = [np.concatenate([place - mark, place + mark]) for place in marks]
    for label in labels:
        point = (np.array(label.point_m) - corner) * scale
        if not ((point >= 0.0) & (point <= frame)).all():
            continue
        # Half the sides of the text, by mean letters.
        half = 0.5 * label.size * np.array([_LETTER * len(label.text), _LINE]) + _APART
        most = np.maximum(frame - half, half)
        shifts = [
            _shift(label, half, more, way)
            for more in _MORE_POINTS
            for way in _TURNS_DEG
        ]
        # Moved into the frame.
        middles = np.clip(point + shifts, half, most)
        boxes = np.hstack([middles - half, middles + half])
        # The first place that hides nothing, or else the one that hides least.
        hidden = _overlaps(np.reshape(taken, (-1, 4)), boxes).sum(axis=0)
        best = int(np.argmin(hidden))
        if hidden[best] > 0.0 and not label.is_kept:
            continue
        taken.append(boxes[best])
        away = middles[best] - point
        style: Style = {"path_effects": [HALO], "zorder": 9, "annotation_clip": True}
        style |= {"ha": "center", "fontsize": label.size} | (label.style or {})
        at_pt = (float(away[0]), float(away[1]))
        write_beside(axes, literal(label.text), label.point_m, away_pt=at_pt, **style)


def _shift(
    label: TextLabel, half: FloatArray, more: float, turn_deg: float
) -> FloatArray:
    """From the point to the middle of the text, in points."""
    angle = math.radians(label.toward_deg + turn_deg)
    way = np.array([math.cos(angle), math.sin(angle)])
    shift: FloatArray = way * (label.gap + more) + np.sign(
        np.round(way, 6)
    ) * half * np.abs(way)
    return shift


def _overlaps(ones: FloatArray, others: FloatArray) -> FloatArray:
    """Areas (n, m) that rectangles (n, 4) and (m, 4) have in common.

    A rectangle is its lower and its upper corner.
    """
    ones = ones[:, None]
    sides = np.minimum(ones[..., 2:], others[:, 2:]) - np.maximum(
        ones[..., :2], others[:, :2]
    )
    areas: FloatArray = np.prod(np.clip(sides, 0.0, None), axis=2)
    return areas


def unit_names(layout: Layout, scene: Scene) -> list[TextLabel]:
    """Short names of units that look one way from one pole.

    Of many, how many are at a place.
    """
    if len(layout.units) > MAX_LABELLED_UNITS:
        places = Counter(
            tuple(np.round(unit.pose.position_m[:2], 1)) for unit in layout.units
        )
        return [
            TextLabel(
                text=f"{n_units}\N{MULTIPLICATION SIGN}",
                point_m=(east_m, north_m),
                toward_deg=90.0,
                style={"fontweight": "bold"},
            )
            for (east_m, north_m), n_units in places.items()
        ]
    # Units that look alike share a label: theirs would lie on one another.
    labels = unit_labels(layout)
    doubts = assumed_sites(scene.notes)
    groups: list[tuple[CandidatePose, list[str]]] = []
    for unit in layout.units:
        found = next(
            (names for first, names in groups if looks_alike(unit, first)), None
        )
        if found is None:
            groups.append((unit, found := []))
        found.append(labels[unit.id])
    return [
        TextLabel(
            text=(
                tr("{units} (assumed)", units=", ".join(names))
                if first.site_id in doubts
                else ", ".join(names)
            ),
            point_m=(float(first.pose.position_m[0]), float(first.pose.position_m[1])),
            toward_deg=first.pose.yaw_deg,
            gap=ARROW_POINTS * len(names),
            size=9.0,
            style={"fontweight": "bold"},
        )
        for first, names in groups
    ]


def looks_alike(unit: CandidatePose, other: CandidatePose) -> bool:
    """True if two units look the same way from one pole, but for 30 degrees."""
    # Turned into -180 .. 180 degrees.
    turn_deg = (unit.pose.yaw_deg - other.pose.yaw_deg + 180.0) % 360.0 - 180.0
    apart_m = np.linalg.norm(unit.pose.position_m[:2] - other.pose.position_m[:2])
    return bool(apart_m < _SAME_PLACE_M and abs(turn_deg) < _SAME_WAY_DEG)


def arm_names(
    scene: Scene, middle_m: FloatArray, half_size_m: float
) -> list[TextLabel]:
    """Names of the junction's arms and streets, next to their lanes.

    They stand towards the frame.
    """
    try:
        streets = street_names(scene)
        arms = build_junction(scene).arms
    except InputError:
        # No lane ends at the junction.
        return []
    labels = []
    for name, arm in arms.items():
        lanes = [lane.centreline_m for lane in (*arm.lanes_in, *arm.lanes_out)]
        points = shapely.get_coordinates(shapely.MultiLineString(lanes).segmentize(2.0))
        ways = points - middle_m
        ahead = arm_mouth(arm) - middle_m
        along = ways @ ahead / np.maximum(np.hypot(*ways.T) * np.hypot(*ahead), 1e-9)
        # Of an arm that bends.
        ways = ways[along >= min(_NEAR_ITS_MOUTH, along.max())]
        away_m = np.abs(ways).max(axis=1)
        way = ways[np.argmin(np.abs(away_m - _NAMES_AT * half_size_m))]
        at = middle_m + way
        text = tr("{approach} arm", approach=tr(name))
        style: Style = {"color": "#333333", "style": "italic"}
        # A street whose letters no font here has is named by its arm.
        street = streets.get(name, "")
        families: tuple[str, ...] | None = ()
        # Looking at fonts takes long: nearly all names need no other one.
        if not street.isascii():
            families = load_entry("experiments.figures.fonts:families_for")(street)
        if name in streets and families is not None:
            text = f"{streets[name]} ({tr(name)})"
        if families:
            style["family"] = list(families)
        toward_deg = 90.0
        if abs(way[1]) > abs(way[0]):
            toward_deg = 0.0
        labels.append(
            TextLabel(
                text=text,
                point_m=(float(at[0]), float(at[1])),
                toward_deg=toward_deg,
                gap=14.0,
                style=style,
            )
        )
    return labels


def position_names(runs: Sequence[Run]) -> list[TextLabel]:
    """Which the places along the arms are, each once."""
    firsts = {(run.approach, run.position): run for run in reversed(runs)}
    return [
        TextLabel(
            text=position.replace("-", "\N{MINUS SIGN}"),
            point_m=(
                float(run.vru_position_m[-1][0]),
                float(run.vru_position_m[-1][1]),
            ),
            toward_deg=float(run.vut_yaw_deg[-1]) + 90.0,
            size=6.5,
            is_kept=False,
            style={"zorder": 7},
        )
        for (_, position), run in firsts.items()
        if position != AT_ZERO.name
    ]
