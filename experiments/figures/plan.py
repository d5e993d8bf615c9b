"""Plan of the junction: where the units are, and what ground they look at."""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch, Polygon
from matplotlib.path import Path
from matplotlib.patheffects import withStroke
from shapely.ops import unary_union

from geometry.actors import PlacedActor
from geometry.arrays import FloatArray
from geometry.footprints import footprint_corners
from geometry.junction import COMPASS
from geometry.lidar import LidarModel
from geometry.notes import assumed_sites
from geometry.poses import camera_rotation
from geometry.scene import Lane, Scene, thing_footprint
from placement.candidates import CandidatePose, above_ground, is_in_view, is_ring
from placement.layout import Layout
from placement.setting import Setting
from scenarios.runs import Run

from ..results.numbers import shortened
from .axes import (
    BLUE,
    GREEN,
    ORANGE,
    PINK,
    SKY,
    VERMILION,
    WIDTH_IN,
    Style,
    literal,
    new_axes,
    show_square,
    unit_labels,
)
from .labels import (
    ARROW_POINTS,
    HALO,
    MAX_LABELLED_UNITS,
    arm_names,
    draw_labels,
    looks_alike,
    position_names,
    unit_names,
)

CLASS_STYLES: dict[str, Style] = {
    "building": {"facecolor": "#c9c4bb", "edgecolor": "#8d887f", "linewidth": 0.8},
    "wall": {"facecolor": "#5b5b5b", "edgecolor": "#5b5b5b", "linewidth": 1.2},
    "vegetation": {"facecolor": "#b7d3ae", "edgecolor": "#7d9c73", "linewidth": 0.6},
    "parked vehicle": {"facecolor": "#a9a9a9", "edgecolor": "#6e6e6e", "linewidth": 0.6},
    "traffic light": {"facecolor": "#7a7a7a", "edgecolor": "#7a7a7a", "linewidth": 0.8},
}
PARKED_STYLE: Style = {
    "facecolor": "#f2f2f2",
    "edgecolor": "#8a8a8a",
    "linewidth": 0.7,
    "hatch": "....",
}
SITE_STYLE: Style = {
    "marker": "o",
    "markersize": 4.0,
    "markerfacecolor": "white",
    "markeredgecolor": "#444444",
    "markeredgewidth": 0.9,
}
ASSUMED_STYLE: Style = SITE_STYLE | {"marker": "D", "markeredgecolor": VERMILION}
"""Of sites that the map does not have, or not there."""
UNIT_COLOURS = (BLUE, VERMILION, GREEN, PINK, ORANGE, SKY)
_LINE_STYLES = ("-", "--", "-.", ":")
_LEGEND_ROW_IN = 0.17
_MAX_NAME = 18  # letters that the legend has room for
_PATH_STYLES: dict[str, tuple[str, Style]] = {
    "vut": ("car under test (VUT)", {"color": "black", "linestyle": "-", "linewidth": 1.3}),
    "pedestrian": (
        "pedestrian, to the collision point",
        {"color": "black", "linestyle": (0, (1.2, 1.2)), "linewidth": 1.8},
    ),
    "cyclist": (
        "cyclist, to the collision point",
        {"color": "black", "linestyle": (0, (5.0, 2.0)), "linewidth": 1.2},
    ),
    "motorcyclist": (
        "motorcyclist, to the collision point",
        {"color": "black", "linestyle": (0, (5.0, 2.0, 1.2, 2.0)), "linewidth": 1.2},
    ),
    "car": (
        "other car, to the collision point",
        {"color": "black", "linestyle": (0, (9.0, 3.0)), "linewidth": 1.2},
    ),
}
_IMPACT_STYLE: Style = {
    "marker": "X",
    "markersize": 4.5,
    "markerfacecolor": "black",
    "markeredgecolor": "white",
    "linestyle": "none",
}
_ROUND_MARKER: Style = {"marker": "o", "linestyle": "none"}
# Looking east; the last point closes the outline.
_DART = np.array([[1.0, 0.0], [-0.8, 0.6], [-0.45, 0.0], [-0.8, -0.6], [1.0, 0.0]])
_DART_POINTS = 5.5  # half its length
_N_BEARINGS = 180
_STEP_M = 0.1
ALL_ROUND = "all round"
_HALF_SIZE_M, _MARGIN_M = 45.0, 5.0


def draw_scene(axes: Axes, scene: Scene) -> None:
    """Draw lanes, crosswalks, sites and things; what comes later goes on top up to zorder 6.5."""
    axes.set_facecolor("#f4f2ee")
    for lane in scene.lanes:
        is_parking = lane.kind == "parking"
        axes.add_patch(
            Polygon(
                _lane_polygon(lane),
                facecolor="#ececec" if is_parking else "#dedede",
                edgecolor="white",
                linewidth=0.8,
                zorder=1,
            )
        )
    axes.add_patch(Polygon(scene.outline_m, facecolor="#dedede", edgecolor="none", zorder=1))
    for ends in scene.crosswalks_m:
        # Grey below the white bars: next to the road they would not be seen on a white ground.
        axes.plot(*ends.T, color="#8c8c8c", linewidth=6.0, solid_capstyle="butt", zorder=1.8)
        axes.plot(*ends.T, color="white", linewidth=5.0, linestyle=(0, (0.6, 0.6)), zorder=1.9)
    for index, instance in enumerate(scene.instances):
        if instance.class_name in CLASS_STYLES:
            path = _outline(thing_footprint(scene, index))
            axes.add_patch(PathPatch(path, zorder=6.5, **CLASS_STYLES[instance.class_name]))
    doubts = assumed_sites(scene.notes)
    for is_assumed, style in ((False, SITE_STYLE), (True, ASSUMED_STYLE)):
        sites = [s.position_m[:2] for s in scene.sites if (s.id in doubts) is is_assumed]
        axes.plot(*np.array(sites).reshape(-1, 2).T, linestyle="none", zorder=5, **style)


def draw_parked(axes: Axes, bodies: Iterable[PlacedActor]) -> None:
    """Draw bodies that belong to single cases: what they cover, and each once its outline."""
    corners = [
        footprint_corners(
            body.pose.position_m[:2],
            body.pose.yaw_deg,
            length_m=body.actor.length_m,
            width_m=body.actor.width_m,
        )
        for body in {body.key: body for body in bodies}.values()
    ]
    if not corners:
        return
    # All in one: a hatch takes as long as a hundred outlines.
    covered = _outline(unary_union([shapely.Polygon(ring) for ring in corners]))
    axes.add_patch(PathPatch(covered, zorder=2.2, **PARKED_STYLE))
    outlines = Path.make_compound_path(*(_ring(ring) for ring in corners))
    axes.add_patch(PathPatch(outlines, zorder=2.2, **PARKED_STYLE | {"fill": False, "hatch": ""}))


def _outline(shape: shapely.Geometry) -> Path:
    """Polygons as a path, courtyards left out."""
    return Path.make_compound_path(
        *(
            _ring(np.asarray(ring.coords)[:-1])
            for part in getattr(shape, "geoms", [shape])
            if part.geom_type == "Polygon"
            for ring in (part.exterior, *part.interiors)
            if len(ring.coords)
        )
    )


def _ring(corners: FloatArray) -> Path:
    return Path(np.concatenate([corners, corners[:1]]), closed=True)


def _lane_polygon(lane: Lane) -> FloatArray:
    direction = np.gradient(lane.centreline_m, axis=0)
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
    left = 0.5 * lane.width_m * np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    polygon: FloatArray = np.concatenate(
        [lane.centreline_m + left, (lane.centreline_m - left)[::-1]]
    )
    return polygon


def ground_footprint(
    unit: CandidatePose, *, max_range_m: float, max_depth_m: float = math.inf
) -> FloatArray:
    """Footprint of a unit's image on the road plane, if nothing stood on it.

    A convex polygon, (n, 2), counter-clockwise, up to `max_range_m` from the foot of the camera and
    up to `max_depth_m` along its axis; empty if it sees no ground there. Of a LiDAR that opens half
    a turn or more it is the outer one of :func:`.sensors.ground_rings`. World frame. [m]
    """
    if is_wide(unit):
        return ground_rings(unit, max_range_m=max_range_m)[0]
    position = unit.pose.position_m
    angles = np.linspace(0.0, 2.0 * np.pi, 180, endpoint=False)
    corners = position[:2] + max_range_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    half_width, half_height = np.tan(
        np.radians([0.5 * unit.sensor.horizontal_fov_deg, 0.5 * unit.sensor.vertical_fov_deg])
    )
    # Inward normals of the planes through the lens and the image's four sides. Camera frame.
    normals_camera = np.array(
        [
            [1.0, 0.0, half_width],
            [-1.0, 0.0, half_width],
            [0.0, 1.0, half_height],
            [0.0, -1.0, half_height],
        ]
    )
    R_world_camera = camera_rotation(unit.pose.yaw_deg, unit.pose.pitch_deg)
    if np.isfinite(max_depth_m):
        axis = R_world_camera[:, 2]
        depth_m = (corners - position[:2]) @ axis[:2] - position[2] * axis[2]
        corners = _clip(corners, max_depth_m - depth_m)
    for normal in normals_camera @ R_world_camera.T:
        inside = (corners - position[:2]) @ normal[:2] - position[2] * normal[2]
        corners = _clip(corners, inside)
    return corners


def plot_plan(
    setting: Setting,
    layout: Layout,
    *,
    others: Sequence[Layout] = (),
    half_size_m: float | None = None,
    max_range_m: float = 35.0,
    width_in: float = WIDTH_IN,
    axes: Axes | None = None,
) -> Axes:
    """Plan of the junction with a layout: where its units are and what ground they look at.

    `others` are drawn lighter, without fields of view. The square that is shown lies around the
    middle of the junction; half its side is by default 45 m, or what shows all units and places
    along the arms. Fields of view end at `max_range_m`; the camera itself sees farther. The axes
    are in metres, north up; by default in a new figure of so many inches.
    """
    entries = _plan_legend(setting, layout, others)
    n_columns = 1 if width_in < WIDTH_IN else 2
    if axes is None:
        n_rows = -(-len(entries) // n_columns)
        axes = new_axes(width_in, width_in + 0.05 + _LEGEND_ROW_IN * n_rows)
        axes.set_anchor("N")  # what is left over is below the legend
    scene = setting.scene
    outline = scene.outline_m
    middle = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
    if half_size_m is None:
        ends_m = [run.vru_position_m[-1] for run in setting.runs]
        places = np.array([*ends_m, *(unit.pose.position_m[:2] for unit in layout.units)])
        half_size_m = max(_HALF_SIZE_M, float(np.abs(places - middle).max(initial=0.0)) + _MARGIN_M)
    draw_scene(axes, scene)
    draw_parked(axes, [body for run in setting.runs for body in run.obstruction])
    _draw_paths(axes, setting.runs)
    for other in others:
        _draw_other(axes, other)
    _draw_units(axes, layout, setting.scene, max_range_m)
    show_square(axes, middle, half_size_m)
    places = np.array([unit.pose.position_m[:2] for unit in layout.units])
    draw_labels(
        axes,
        [
            *unit_names(layout, scene),
            *arm_names(scene, middle, half_size_m),
            *position_names(setting.runs),
        ],
        marks_m=np.concatenate([places, _tips_m(layout, half_size_m, width_in)]),
    )
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    _draw_compass(axes, middle, half_size_m)
    axes.legend(
        handles=entries,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.54 / width_in),
        ncols=n_columns,
        fontsize=8,
        frameon=False,
    )
    return axes


def _clip(corners: FloatArray, inside: FloatArray) -> FloatArray:
    """Part of a convex polygon where `inside`, a linear function at its corners, is positive."""
    kept: list[FloatArray] = []
    for index in range(len(corners)):
        here, there = inside[index - 1], inside[index]
        if (here > 0.0) != (there > 0.0):
            share = here / (here - there)
            kept.append(corners[index - 1] + share * (corners[index] - corners[index - 1]))
        if there > 0.0:
            kept.append(corners[index])
    return np.array(kept).reshape(-1, 2)


def _draw_paths(axes: Axes, runs: Sequence[Run]) -> None:
    firsts = {(run.case.name, run.approach, run.position): run for run in reversed(runs)}
    ways: dict[str, list[FloatArray]] = {name: [] for name in _PATH_STYLES}
    for run in firsts.values():
        vru = run.case.vru.class_name
        ways["vut"].append(run.vut_position_m)
        ways[vru if vru in ways else "pedestrian"].append(run.vru_position_m)
    for name, (_, style) in _PATH_STYLES.items():
        axes.plot(*_end_to_end(ways[name]).T, zorder=3, **style)
    impacts = np.array([run.vru_position_m[-1] for run in firsts.values()]).reshape(-1, 2)
    axes.plot(*impacts.T, zorder=4, **_IMPACT_STYLE)


def _end_to_end(ways: Sequence[FloatArray]) -> FloatArray:
    """Points of several lines as those of one with gaps, which is drawn in one go."""
    gap = np.full((1, 2), np.nan)
    return np.concatenate([gap, *(part for way in ways for part in (way, gap))])


def _draw_units(axes: Axes, layout: Layout, scene: Scene, max_range_m: float) -> None:
    labels = unit_labels(layout)
    is_labelled = len(labels) <= MAX_LABELLED_UNITS
    for index, unit in enumerate(layout.units):
        colour = UNIT_COLOURS[index % len(UNIT_COLOURS)]
        position = unit.pose.position_m[:2]
        level = above_ground(unit, scene)
        corners = ground_footprint(level, max_range_m=max_range_m)
        if len(corners):
            shape = ring_path(corners, blind_footprint(level, max_range_m=max_range_m))
            axes.add_patch(
                PathPatch(shape, facecolor=colour, alpha=0.6 / (len(labels) + 3.0), zorder=2.5)
            )
            style = _LINE_STYLES[index % len(_LINE_STYLES)]
            axes.add_patch(
                PathPatch(
                    shape,
                    facecolor="none",
                    edgecolor=colour,
                    linestyle=style,
                    linewidth=1.2 if is_labelled else 0.4,
                    zorder=6,
                )
            )
        axes.plot(
            *position,
            **_camera_marker(unit, _rank(layout, index)),
            markerfacecolor=colour,
            markeredgecolor="black",
            zorder=8,
            gid=f"unit:{unit.id}",
        )


def _rank(layout: Layout, index: int) -> int:
    """Number of the units before that look the same way from the same pole."""
    return sum(looks_alike(layout.units[index], other) for other in layout.units[:index])


def _tips_m(layout: Layout, half_size_m: float, width_in: float) -> FloatArray:
    """Approximate ends of the units' arrows, (n, 2)."""
    yaw = np.radians([unit.pose.yaw_deg for unit in layout.units])
    length_m = 0.6 * ARROW_POINTS * 2.0 * half_size_m / (60.0 * width_in)
    places = np.array([unit.pose.position_m[:2] for unit in layout.units])
    tips: FloatArray = places + length_m * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    return tips


def _draw_other(axes: Axes, layout: Layout) -> None:
    for unit in layout.units:
        axes.plot(
            *unit.pose.position_m[:2],
            **_camera_marker(unit),
            markerfacecolor="white",
            markeredgecolor="#555555",
            zorder=7,
        )


def _camera_marker(unit: CandidatePose, rank: int = 0) -> Style:
    """A dart that points from the pole to where the camera looks; a disc where that is all round.

    Darts of further cameras that look there from the same pole stand one before the other.
    """
    if is_ring(unit.sensor):
        return {**_ROUND_MARKER, "markersize": 10.0}
    yaw = math.radians(unit.pose.yaw_deg)
    turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    ahead = _DART + [1.0 + 2.0 * rank, 0.0]
    # matplotlib scales a marker by its largest coordinate.
    size = 2.0 * _DART_POINTS * float(np.abs(ahead @ turn).max())
    return {"marker": Path(ahead @ turn, closed=True), "linestyle": "none", "markersize": size}


def _draw_compass(axes: Axes, middle_m: FloatArray, half_size_m: float) -> None:
    east, north = middle_m + half_size_m * np.array([0.91, 0.76])
    axes.annotate(
        "N",
        xy=(east, north + 0.18 * half_size_m),
        xytext=(east, north),
        ha="center",
        va="center",
        fontsize=11,
        fontweight="bold",
        arrowprops={"arrowstyle": "-|>", "facecolor": "black", "linewidth": 1.4},
        path_effects=[HALO],
        zorder=10,
    )
    length_m = 10.0
    start = middle_m - 0.95 * half_size_m
    axes.plot(
        [start[0], start[0] + length_m],
        [start[1]] * 2,
        color="black",
        linewidth=4.0,
        solid_capstyle="butt",
        path_effects=[withStroke(linewidth=6.0, foreground="white")],
        zorder=11,
    )
    axes.text(
        start[0] + 0.5 * length_m,
        start[1] + 1.2,
        f"{length_m:g} m",
        ha="center",
        va="bottom",
        fontsize=9,
        path_effects=[HALO],
        zorder=11,
    )


def _plan_legend(setting: Setting, layout: Layout, others: Sequence[Layout]) -> list[Any]:
    bodies = ["vut", *dict.fromkeys(run.case.vru.class_name for run in setting.runs)]
    paths = [
        Line2D([], [], label=label, **style)
        for body, (label, style) in _PATH_STYLES.items()
        if body in bodies
    ]
    camera: Style = {"marker": Path(_DART, closed=True), "linestyle": "none", "markersize": 8.0}
    what = (
        "camera, and the ground it looks at"
        if len(layout.units) <= MAX_LABELLED_UNITS
        else "cameras at a place, and what they look at"
    )
    units = [
        Line2D(
            [],
            [],
            label=literal(f"{shortened(layout.name, _MAX_NAME)}: {what}"),
            markerfacecolor=BLUE,
            markeredgecolor="black",
            **camera,
        ),
        *(
            Line2D(
                [],
                [],
                label=literal(f"{shortened(name, _MAX_NAME)}: camera"),
                markerfacecolor="white",
                markeredgecolor="#555555",
                **camera,
            )
            for name in dict.fromkeys(other.name for other in others)
        ),
    ]
    if any(is_ring(unit.sensor) for unit in layout.units):
        style: Style = {"markerfacecolor": BLUE, "markeredgecolor": "black"}
        label = literal(f"{shortened(layout.name, _MAX_NAME)}: LiDAR that scans all round")
        units.insert(1, Line2D([], [], label=label, markersize=8.0, **style, **_ROUND_MARKER))
    if all(is_ring(unit.sensor) for unit in layout.units):
        del units[0]
    present = {instance.class_name for instance in setting.scene.instances}
    things = [
        Patch(label=name, **style)
        for name, style in CLASS_STYLES.items()
        if name in present and name != "traffic light"
    ]
    if any(run.obstruction for run in setting.runs):
        things.append(Patch(label="parked body or wall of single cases", **PARKED_STYLE))
    site = Line2D([], [], label="pole or mast: possible site", linestyle="none", **SITE_STYLE)
    doubts = assumed_sites(setting.scene.notes)
    sites = [site]
    if doubts:
        label = "assumed site: not in the map there"
        assumed = Line2D([], [], label=label, linestyle="none", **ASSUMED_STYLE)
        is_all = all(one.id in doubts for one in setting.scene.sites)
        sites = [assumed] if is_all else [site, assumed]
    label = "collision point"
    if len({run.position for run in setting.runs}) > 1:
        label += "; metres before (\N{MINUS SIGN}), behind (+)"
    impact = Line2D([], [], label=label, **_IMPACT_STYLE)
    return [*units, *paths, impact, *sites, *things]


def compass_word(unit: CandidatePose) -> str:
    """Point of the compass to which a unit looks; "all round" of one that looks to none."""
    return ALL_ROUND if is_ring(unit.sensor) else COMPASS[round(unit.pose.yaw_deg / 45.0) % 8]


def looking_words(unit: CandidatePose) -> str:
    """Direction of a unit's view, for a sentence: "looking to the east" or "scanning all round"."""
    word = compass_word(unit)
    return f"scanning {word}" if word == ALL_ROUND else f"looking to the {word}"


def is_wide(unit: CandidatePose) -> bool:
    """True for a LiDAR that opens half a turn or more: no picture plane holds its view."""
    return isinstance(unit.sensor, LidarModel) and unit.sensor.horizontal_fov_deg >= 180.0


def ground_rings(unit: CandidatePose, *, max_range_m: float) -> tuple[FloatArray, FloatArray]:
    """Outlines of the road plane that a wide LiDAR's beams meet, if nothing stood on it.

    Where the ground ends that it meets, and where that begins, each (n, 2): below lies what the
    lowest beams pass over. Both counter-clockwise around the foot, to a tenth of a metre; empty
    where there is none, and the inner one is the foot itself to the sides where no ground is met.
    World frame. [m]
    """
    foot = unit.pose.position_m[:2]
    angles = np.linspace(0.0, 2.0 * np.pi, _N_BEARINGS, endpoint=False)
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    radii = np.linspace(0.0, max_range_m, round(max_range_m / _STEP_M) + 1)
    points = np.zeros((_N_BEARINGS, len(radii), 3))
    points[..., :2] = foot + radii[:, None] * ways[:, None, :]
    is_met = is_in_view(unit, points.reshape(-1, 3)).reshape(_N_BEARINGS, len(radii))
    has_any = is_met.any(axis=1)
    far = np.where(has_any, radii[len(radii) - 1 - is_met[:, ::-1].argmax(axis=1)], 0.0)
    near = np.where(has_any, radii[is_met.argmax(axis=1)], 0.0)
    empty = np.empty((0, 2))
    return (
        foot + far[:, None] * ways if has_any.any() else empty,
        foot + near[:, None] * ways if near.any() else empty,
    )


def blind_footprint(unit: CandidatePose, *, max_range_m: float) -> FloatArray:
    """Ground around the foot of a wide LiDAR that its lowest beams pass over.

    Shape (n, 2). Empty if there is none, and of every other sensor: its outline says where it sees.
    [m]
    """
    if not is_wide(unit):
        return np.empty((0, 2))
    return ground_rings(unit, max_range_m=max_range_m)[1]


def ring_path(*outlines_m: FloatArray) -> Path:
    """Outlines as one shape to draw: what is inside the second one is a hole in the first.

    Outlines are (n, 2), counter-clockwise, not closed. [m]
    """
    rings = [
        Path(np.vstack([corners, corners[:1]])[:: -1 if index else 1], closed=True)
        for index, corners in enumerate(outlines_m)
        if len(corners)
    ]
    return Path.make_compound_path(*rings)
