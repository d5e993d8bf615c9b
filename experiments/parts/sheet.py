"""``place-rsus sheet``: tolerances of mounting, and a page per unit."""

import io
import math
import textwrap
from collections.abc import Collection, Mapping, Sequence
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch

from geometry.arrays import FloatArray
from geometry.catalogue import Sensor
from geometry.errors import InputError, Unquoted
from geometry.frames import parse_crs, to_geographic, transform
from geometry.junction import COMPASS, compass_bearing_deg, whereabouts
from geometry.notes import assumed_sites
from geometry.raycast import build_caster, is_in_sight
from geometry.scene import Scene, paved_area, thing_footprint
from geometry.scene_sources import load_scene
from geometry.sensors import CameraModel, project_points
from geometry.terrain import ground_height_m
from geometry.writing import check_target, write_atomically
from placement.candidates import CandidatePose, above_ground, is_ring, is_turn_useless
from placement.compute import DEFAULT_COMPUTE, Compute
from placement.explain.tolerances import LIFTS_M, TURNS_DEG, Tolerance, find_tolerances
from placement.layout import Layout, check_layout, find_existing, find_layout
from placement.question import Question
from placement.setting import Setting, build_setting

from ..export.places import placed_records, surveyed_positions_m
from ..figures.axes import (
    BLUE,
    VERMILION,
    Style,
    drawing_any_name,
    literal,
    unit_labels,
)
from ..figures.outlines import blind_footprint, ground_footprint
from ..figures.plan import draw_scene, ring_path
from ..language import localized, mark, tr
from ..progress import WRITING, StageProgress
from ..results.folders import check_folder
from ..results.record import Record
from .camera_views import draw_view

_DEGREE = "\N{DEGREE SIGN}"
_A4_IN = (8.27, 11.69)
_PLAN_HALF_M = 30.0
_VIEW_RANGE_M = 35.0
_N_LANDMARKS = 4
# In figures of the page: its left margin, a line of text, and the foot.
_LEFT = 0.08
_LINE_HEIGHT = 0.0155
_FOOT = 0.105
_LINE_LETTERS = 76
_LANDMARK_WITHIN_M = 40.0
_EYE_HEIGHT_M = 1.6
# Marks on the road are looked at a little above it, so that it does not hide them.
_PAINT_HEIGHT_M = 0.1
# Rays end so far before a landmark's axis or corner.
_BEFORE_LANDMARK_M = 0.3
# What is nearer to who stands at the mount, such as its own pole, hides nothing.
_ARM_LENGTH_M = 0.5
# Farther away nobody finds a point on the road.
_FARTHEST_AIM_M = 40.0
_CORNERS = {
    "building": mark("corner of a building"),
    "wall": mark("corner of a wall"),
}
_CROSSWALK = mark("end of a crosswalk")
_KERB = mark("edge of the carriageway")
_POLES = ("lamp post", "traffic light", "pole", "mast arm")


def mounting_sheet(
    layout: Layout,
    setting: Setting,
    tolerances: Sequence[Tolerance],
    *,
    existing: Collection[str] = (),
    compute: Compute = DEFAULT_COMPUTE,
) -> bytes:
    """A PDF with a page for each unit.

    Where, how high, where it looks, what it will see.

    Parameters
    ----------
    layout : Layout
        The units.
    setting : Setting
        Scene and runs; the picture shows one of these, the unit's first in which the
        road user is near.
    tolerances : sequence of Tolerance
        One for each unit, in their order.
    existing : collection of str
        Ids of units that are mounted already: their pages say so.
    compute : Compute
        Its seed is that of sensor noise.

    Returns
    -------
    pdf : bytes
        A4 pages.
    """
    labels = unit_labels(layout)
    placed = placed_records(layout, setting.scene)
    buffer = io.BytesIO()
    metadata = {"Title": tr("Mounting sheet: {name}", name=layout.name)}
    with drawing_any_name(), PdfPages(buffer, metadata=metadata) as pages:
        for unit, tolerance, place in zip(
            layout.units, tolerances, placed, strict=True
        ):
            rows = _rows(unit, setting.scene, place)
            label = labels[unit.id]
            title = label if label == unit.id else f"{label}: {unit.id}"
            if unit.id in existing:
                title = tr("{unit}: existing, do not touch", unit=title)
            else:
                rows.append((tr("Aim to within"), _tolerance_text(tolerance)))
            what = tr(
                "{scene}, layout {name}; place-rsus {version}, {date}; planned by"
                " {blank}",
                scene=setting.scene.name,
                name=layout.name,
                version=version("place-rsus"),
                date=date.today().isoformat(),
                blank=16 * "_",
            )
            figure = Figure(figsize=_A4_IN)
            # What must not be touched is seen at a glance.
            colour = VERMILION if unit.id in existing else "black"
            bold: Style = {"fontsize": 20, "fontweight": "bold", "color": colour}
            figure.text(_LEFT, 0.955, literal(title), **bold)
            figure.text(_LEFT, 0.937, literal(what), fontsize=9, color="#444444")
            top = _write_rows(figure, rows)
            _draw_pictures(figure, unit, label, setting, compute, top=top)
            _write_as_built(figure)
            pages.savefig(figure)
    return buffer.getvalue()


def _write_rows(figure: Figure, rows: Sequence[tuple[str, str]]) -> float:
    """Write heads and texts from the top of a page; returns where they end."""
    top = 0.915
    for head, text in rows:
        lines = [
            line
            for part in text.split("\n")
            for line in textwrap.wrap(part, _LINE_LETTERS) or [""]
        ]
        figure.text(_LEFT, top, head, fontsize=9, fontweight="bold", va="top")
        shown = literal("\n".join(lines))
        figure.text(0.27, top, shown, fontsize=9, va="top", linespacing=1.23)
        top -= _LINE_HEIGHT * len(lines) + 0.004
    return top


def _draw_pictures(
    figure: Figure,
    unit: CandidatePose,
    label: str,
    setting: Setting,
    compute: Compute,
    *,
    top: float,
) -> None:
    """Draw what the unit sees, and a plan below it, between `top` and the foot."""
    room = top - _FOOT - 0.07
    plan_height = 0.45 * room
    _draw_plan(
        figure.add_axes((_LEFT, _FOOT, 0.84, plan_height)), unit, label, setting.scene
    )
    bottom = _FOOT + plan_height + 0.035
    picture = figure.add_axes((_LEFT, bottom, 0.84, room - plan_height))
    _draw_picture(picture, unit, setting, compute)


def _write_as_built(figure: Figure) -> None:
    """Write what is to be filled in after mounting, at the foot of a page."""
    blank = 12 * "_"
    figure.text(_LEFT, 0.052, tr("As built"), fontsize=9, fontweight="bold")
    position = tr(
        "Height {blank} m   bearing {blank}°   tilt {blank}°   roll {blank}°",
        blank=blank,
    )
    people = tr(
        "Position {blank}{blank}   date {blank}   mounted by {blank}"
        "   checked by {blank}",
        blank=blank[:10],
    )
    for y, text in ((0.035, position), (0.015, people)):
        figure.text(_LEFT, y, text, fontsize=9)


def _rows(
    unit: CandidatePose, scene: Scene, place: Mapping[str, Any]
) -> list[tuple[str, str]]:
    level = above_ground(unit, scene)
    z = float(level.pose.position_m[2])
    where = _coordinates(unit, scene, place)
    roll_deg = 0.0
    if isinstance(unit.sensor, CameraModel):
        roll_deg = unit.sensor.roll_deg or 0.0
    roll = tr("0°: the horizon is level in the picture")
    if roll_deg:
        roll = tr("{angle:.1f}°, clockwise seen from behind", angle=roll_deg)
    rows = [
        (tr("Mount"), _mount(unit, scene)),
        (tr("Sensor"), _sensor(unit.sensor)),
        (tr("Where"), where),
        (tr("Height"), tr("{z:.2f} m above the ground", z=z)),
        (tr("Scans") if is_ring(unit.sensor) else tr("Looks"), _direction(unit)),
        (tr("Tilt"), _tilt(level)),
        (tr("Roll"), roll),
    ]
    if isinstance(unit.sensor, CameraModel):
        rows.append((tr("Aim"), _aim(unit, scene)))
    landmarks = "\n".join(_landmarks(unit, scene)) or tr("none within 40 m")
    return [*rows, (tr("Landmarks"), landmarks)]


def _sensor(sensor: Sensor) -> str:
    """Model of a sensor and its lens."""
    if isinstance(sensor, CameraModel):
        lens = mark("fixed lens")
        if sensor.fov_range_deg:
            lens = mark("varifocal lens, set to this")
        return tr(
            "{model}: {width} x {height} px, {fov:.1f}° wide ({lens})",
            model=sensor.name,
            width=sensor.width_px,
            height=sensor.height_px,
            fov=sensor.horizontal_fov_deg,
            lens=tr(lens),
        )
    return tr(
        "{model}: LiDAR, {fov:.0f}° wide, {range:.0f} m far",
        model=sensor.name,
        fov=sensor.horizontal_fov_deg,
        range=sensor.range_m,
    )


def _coordinates(unit: CandidatePose, scene: Scene, place: Mapping[str, Any]) -> str:
    """Where a unit is: in the map's metres or UTM, on earth, at the junction.

    `place` is its record of :func:`placed_records`.
    """
    surveyed_m = surveyed_positions_m([unit], scene)
    x, y = surveyed_m[0, :2].tolist()
    lines = []
    crs = place.get("map_crs", "")
    if scene.crs:
        lon_deg, lat_deg = to_geographic(surveyed_m, scene.crs)[0].tolist()
        if not crs or parse_crs(crs).is_geographic:
            lines.append(_utm(surveyed_m[:, :2], scene.crs, lon_deg, lat_deg))
        lines.append(
            tr("{lat:.6f}° latitude, {lon:.6f}° longitude", lat=lat_deg, lon=lon_deg)
        )
    if not lines[1:] and "map_x" in place:
        of_map = tr(
            "east {x:.2f} m, north {y:.2f} m", x=place["map_x"], y=place["map_y"]
        )
        if crs:
            of_map = f"{of_map} ({parse_crs(crs).name})"
        lines.insert(0, of_map)
    lines.append(
        tr("{x:.2f} m east, {y:.2f} m north in the junction's coordinates", x=x, y=y)
    )
    return "\n".join(lines)


def _utm(place_m: FloatArray, crs: str, lon_deg: float, lat_deg: float) -> str:
    """A place (1, 2) of a reference system in metres of its zone of UTM."""
    # The zones are 6 degrees wide, and the first one begins at 180 degrees west.
    zone = int((lon_deg + 180.0) // 6.0) % 60 + 1
    is_north = lat_deg >= 0.0
    first_code = 32600 if is_north else 32700
    code = f"EPSG:{first_code + zone}"
    x, y = transform(place_m, crs, code)[0].tolist()
    hemisphere = "N" if is_north else "S"
    return tr(
        "UTM zone {zone}: east {x:.2f} m, north {y:.2f} m ({code})",
        zone=f"{zone}{hemisphere}",
        x=x,
        y=y,
        code=code,
    )


def _aim(unit: CandidatePose, scene: Scene) -> str:
    """The aiming point in words."""
    aim_m = aiming_point_m(unit, scene)
    if aim_m is None:
        return tr("no ground ahead is in view: aim by angles alone")
    away_m = float(np.hypot(*(aim_m - unit.pose.position_m)[:2]))
    return tr(
        "at the point on the ground {away:.1f} m away, marked by the cross in "
        "the picture",
        away=away_m,
    )


def aiming_point_m(unit: CandidatePose, scene: Scene) -> FloatArray | None:
    """Point (3,) of the ground straight ahead that a camera has in sight.

    It is that in the middle of the picture, or else the farthest one below it that is
    in the picture, in no building, and that nothing hides. World frame, metres. None:
    there is none.
    """
    import shapely

    assert isinstance(unit.sensor, CameraModel)
    mount_m = unit.pose.position_m
    height_m = float(above_ground(unit, scene).pose.position_m[2])
    yaw_rad = math.radians(unit.pose.yaw_deg)
    farthest_m = _FARTHEST_AIM_M
    if unit.pose.pitch_deg < 0.0:
        reach_m = height_m / math.tan(math.radians(-unit.pose.pitch_deg))
        farthest_m = min(reach_m, _FARTHEST_AIM_M)
    away_m = np.linspace(farthest_m, 0.0, 100, endpoint=False)
    ways = away_m[:, None] * [math.cos(yaw_rad), math.sin(yaw_rad)]
    places = mount_m[:2] + ways
    points_m = np.column_stack([places, ground_height_m(scene, places)])
    column, row, _ = project_points(points_m, unit.pose, unit.sensor).T
    is_shown = (column >= 0.0) & (column <= unit.sensor.width_px)
    is_shown &= (row >= 0.0) & (row <= unit.sensor.height_px)
    bodies = [
        thing_footprint(scene, index)
        for index, thing in enumerate(scene.instances)
        if thing.class_name in ("building", "wall")
    ]
    is_free = ~shapely.contains_xy(shapely.union_all(bodies), places)
    # Near the origin, where rays of single precision are exact enough.
    caster = build_caster(scene.vertices_m - mount_m, scene.triangles)
    near_m = unit.sensor.near_m
    is_open = is_in_sight(caster, np.zeros(3), points_m - mount_m, near_m=near_m)
    found = np.flatnonzero(is_shown & is_free & is_open)
    if not len(found):
        return None
    return np.asarray(points_m[found[0]])


def _mount(unit: CandidatePose, scene: Scene) -> str:
    """The site, its kind and where it is; and what is assumed of it."""
    if not unit.site_id:
        return tr("on a mount of its own")
    kinds = {site.id: site.kind for site in scene.sites}
    (place,) = whereabouts(scene, unit.pose.position_m[None, :2])
    kind = tr(kinds.get(unit.site_id, ""))
    words = [text for text in (unit.site_id, kind, tr(place)) if text]
    assumed = assumed_sites(scene.notes).get(unit.site_id)
    if assumed:
        doubt = tr("ASSUMED, check on site first: {what}", what=tr(assumed))
    else:
        doubt = ""
    return "\n".join(filter(None, (", ".join(words), doubt)))


def _direction(unit: CandidatePose) -> str:
    values = {
        "point": tr(COMPASS[round(unit.pose.yaw_deg / 45.0) % 8]),
        "bearing": float(compass_bearing_deg(unit.pose.yaw_deg)),
    }
    if not is_ring(unit.sensor):
        return tr(
            "to the {point}: compass bearing {bearing:.1f}° (clockwise from north)",
            **values,
        )
    front = tr(
        "its front to the {point}: compass bearing {bearing:.1f}° (clockwise from"
        " north)",
        **values,
    )
    turned = tr("all round")
    if is_turn_useless(unit.sensor, pitch_deg=unit.pose.pitch_deg):
        turned = tr("all round: turning it changes its axes, not what it sees")
    return f"{turned}\n{front}"


def _tilt(unit: CandidatePose) -> str:
    pitch_deg = unit.pose.pitch_deg
    if is_ring(unit.sensor):
        if pitch_deg == 0.0:
            return tr("none: level, its axis upright")
        down = mark("front {angle:.1f}° down, back equally far up")
        up = mark("front {angle:.1f}° up, back equally far down")
        return tr(down if pitch_deg < 0.0 else up, angle=abs(pitch_deg))
    if pitch_deg >= 0.0:
        return tr("{angle:.1f}° above level", angle=pitch_deg)
    return tr("{angle:.1f}° below level", angle=-pitch_deg)


def _tolerance_text(tolerance: Tolerance) -> str:
    def within(value: float, steps: Sequence[float], unit: str) -> str:
        if value <= 0.0:
            return tr("less than {step}", step=localized(f"{steps[0]:g}{unit}"))
        shown = localized(f"{value:g}{unit}")
        if value >= steps[-1]:
            return tr("{value} or more", value=shown)
        return shown

    right, left, down, up = (
        within(value_deg, TURNS_DEG, _DEGREE)
        for value_deg in (*tolerance.yaw_deg, *tolerance.pitch_deg)
    )
    steps_cm = [100.0 * step_m for step_m in LIFTS_M]
    lower, higher = (
        within(100.0 * value_m, steps_cm, " cm") for value_m in tolerance.height_m
    )
    return tr(
        "{left} to the left, {right} to the right\n{up} up, {down} down\n{higher}"
        " higher, {lower} lower\none change at a time, other units as planned;"
        " beyond, a run is lost",
        left=left,
        right=right,
        up=up,
        down=down,
        higher=higher,
        lower=lower,
    )


def _landmarks(unit: CandidatePose, scene: Scene) -> list[str]:
    """The nearest things that one sees from the mount, with distance and bearing.

    Of each kind the nearest that nothing hides from who stands there. Names of the map
    are on none of them.
    """
    here = unit.pose.position_m[:2]
    eye_m = np.append(here, ground_height_m(scene, here) + _EYE_HEIGHT_M)
    # Near the origin, where rays of single precision are exact enough.
    caster = build_caster(scene.vertices_m - eye_m, scene.triangles)
    found = []
    for what, (places, height_m) in _landmark_points(unit, scene).items():
        ways = places - here
        away_m = np.hypot(*ways.T)
        # Its own pole is nearer than that.
        is_near = (away_m > 0.3) & (away_m <= _LANDMARK_WITHIN_M)
        ways = ways[is_near]
        away_m = away_m[is_near]
        heights_m = ground_height_m(scene, places[is_near]) + height_m - eye_m[2]
        # The thing itself must not hide its own axis or corner.
        before = np.maximum(1.0 - _BEFORE_LANDMARK_M / away_m, 0.0)
        points_m = np.column_stack([ways * before[:, None], heights_m])
        is_seen = is_in_sight(caster, np.zeros(3), points_m, near_m=_ARM_LENGTH_M)
        # One can touch what is so near.
        is_seen |= away_m <= _ARM_LENGTH_M + _BEFORE_LANDMARK_M
        if not is_seen.any():
            continue
        nearest = int(np.where(is_seen, away_m, np.inf).argmin())
        bearing_deg = math.degrees(math.atan2(ways[nearest, 1], ways[nearest, 0]))
        words = tr(
            "{distance:.2f} m to the {point}: {what}",
            distance=float(away_m[nearest]),
            point=tr(COMPASS[round(bearing_deg / 45.0) % 8]),
            what=tr(what),
        )
        found.append((float(away_m[nearest]), words))
    return [words for _, words in sorted(found)[:_N_LANDMARKS]]


def _landmark_points(
    unit: CandidatePose, scene: Scene
) -> dict[str, tuple[FloatArray, float]]:
    """Points (n, 2) in metres of each kind of landmark, and their height to look at.

    Corners of buildings and walls, poles, ends of crosswalks and the carriageway's
    edge. Heights are metres above the ground.
    """
    import shapely
    import shapely.ops

    upright: dict[str, list[FloatArray]] = {}
    for index, thing in enumerate(scene.instances):
        shape = thing_footprint(scene, index)
        if thing.id == unit.site_id or shape.is_empty:
            continue
        if thing.class_name in _CORNERS:
            corners = shapely.get_coordinates(shape)
            upright.setdefault(_CORNERS[thing.class_name], []).append(corners)
        elif thing.class_name in _POLES:
            foot = shapely.get_coordinates(shape.centroid)
            upright.setdefault(thing.class_name, []).append(foot)
    points = {
        what: (np.concatenate(places), _EYE_HEIGHT_M)
        for what, places in upright.items()
    }
    if len(scene.crosswalks_m):
        points[_CROSSWALK] = (scene.crosswalks_m.reshape(-1, 2), _PAINT_HEIGHT_M)
    lanes = [
        shapely.LineString(lane.centreline_m).buffer(
            0.5 * lane.width_m, cap_style="flat"
        )
        for lane in scene.lanes
    ]
    paved = shapely.union_all([*lanes, paved_area(scene.outline_m, scene.islands_m)])
    here = shapely.Point(unit.pose.position_m[:2])
    edge = shapely.ops.nearest_points(paved.boundary, here)[0]
    points[_KERB] = (np.array([[edge.x, edge.y]]), _PAINT_HEIGHT_M)
    return points


def _draw_plan(axes: Axes, unit: CandidatePose, label: str, scene: Scene) -> None:
    draw_scene(axes, scene)
    x, y = unit.pose.position_m[:2]
    level = above_ground(unit, scene)
    corners = ground_footprint(level, max_range_m=_VIEW_RANGE_M)
    if len(corners):
        blind = blind_footprint(level, max_range_m=_VIEW_RANGE_M)
        style = {
            "facecolor": BLUE,
            "alpha": 0.25,
            "edgecolor": BLUE,
            "linewidth": 1.5,
            "zorder": 5,
        }
        axes.add_patch(PathPatch(ring_path(corners, blind), **style))
    if not is_turn_useless(unit.sensor, pitch_deg=unit.pose.pitch_deg):
        yaw = math.radians(unit.pose.yaw_deg)
        tip = (x + 9.0 * math.cos(yaw), y + 9.0 * math.sin(yaw))
        arrow = {"arrowstyle": "-|>", "color": VERMILION, "linewidth": 2.0}
        axes.annotate("", xy=tip, xytext=(x, y), arrowprops=arrow, zorder=9)
    axes.plot([x], [y], marker="o", markersize=8, color=VERMILION, zorder=10)
    text: Style = {"fontsize": 10, "fontweight": "bold", "textcoords": "offset points"}
    axes.annotate(literal(label), (x, y), xytext=(6, 6), zorder=10, **text)
    junction_m = 0.5 * (scene.outline_m.min(axis=0) + scene.outline_m.max(axis=0))
    middle = 0.5 * (junction_m + unit.pose.position_m[:2])
    half = _PLAN_HALF_M
    axes.set_xlim(middle[0] - 2.0 * half, middle[0] + 2.0 * half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_aspect("equal")
    axes.set_xlabel(tr("east (m); north is up"), fontsize=8)
    axes.tick_params(labelsize=7)


def _draw_picture(
    axes: Axes, unit: CandidatePose, setting: Setting, compute: Compute
) -> None:
    axes.set_axis_off()
    if not isinstance(unit.sensor, CameraModel):
        axes.text(
            0.5,
            0.5,
            tr("A LiDAR takes no picture."),
            ha="center",
            va="center",
            fontsize=11,
        )
        return
    rgb, run, time_s = draw_view(unit, setting, compute=compute)
    axes.imshow(rgb)
    aim_m = aiming_point_m(unit, setting.scene)
    if aim_m is not None:
        ((column, row, _),) = project_points(aim_m[None], unit.pose, unit.sensor)
        # Black on white is seen on every ground.
        for width, colour in ((4.0, "white"), (1.5, "black")):
            cross: Style = {"marker": "+", "markersize": 22, "color": colour}
            axes.plot([column], [row], markeredgewidth=width, **cross)
    title = tr(
        "Rendered view: {run}, {time:.1f} s before the impact",
        run=run.id,
        time=abs(time_s),
    )
    axes.set_title(literal(title), fontsize=9, loc="left")


def _mounted_already(
    question: Question, layout: Layout, scene: Scene
) -> frozenset[str]:
    """Ids of the units of a layout that are among those that the question keeps."""
    if not question.keep:
        return frozenset()
    kept = find_layout(question.keep, "keep", scene=scene, sensors=question.sensors)
    return find_existing(layout.units, kept.units)


class SheetResult(Record, frozen=True, kw_only=True):
    """A mounting sheet that was written, and what each unit may be off."""

    layout: str
    written: str
    units: tuple[Tolerance, ...]
    seconds: dict[str, float]


def run_sheet(
    question: Question,
    *,
    layout: Layout,
    out: Path,
    compute: Compute,
    progress: StageProgress,
) -> SheetResult:
    """Write the mounting sheet.

    InputError if a unit is inside something, or `out` not writable.
    """
    if out.is_dir():
        raise InputError("--out", Unquoted(f"{out}, a folder"), "a PDF file to write")
    check_target(out)
    check_folder(out.parent)
    progress.kept = f"nothing was written to {out}"
    progress(mark("setting"), 0, 0)
    scene = load_scene(question.scene)
    existing = _mounted_already(question, layout, scene)
    setting = build_setting(question, scene, compute=compute)
    check_layout(layout, setting.scene)
    progress(mark("tolerances"), 0, 0)
    tolerances = find_tolerances(setting, layout.units, compute=compute)
    progress(WRITING, 0, 0)
    pdf = mounting_sheet(
        layout, setting, tolerances, existing=existing, compute=compute
    )
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(out, pdf)
    except OSError as error:
        got = Unquoted(f"{out}: {error.strerror or error}")
        raise InputError("--out", got, "a file that can be written") from None
    progress.kept = f"the sheet is in {out}"
    units = tuple(tolerances)
    seconds = progress.finish()
    return SheetResult(
        layout=layout.name, written=str(out), units=units, seconds=seconds
    )
