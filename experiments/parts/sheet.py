"""``place-rsus sheet``: tolerances of mounting, and a page per unit."""

import io
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch

from geometry.errors import InputError, Unquoted
from geometry.frames import to_geographic
from geometry.junction import COMPASS, compass_bearing_deg, whereabouts
from geometry.notes import assumed_sites
from geometry.scene import Scene, thing_footprint
from geometry.scene_sources import load_scene
from geometry.sensors import CameraModel
from geometry.writing import check_target, write_atomically
from placement.candidates import CandidatePose, above_ground, is_ring, is_turn_useless
from placement.compute import DEFAULT_COMPUTE, Compute
from placement.explain.tolerances import LIFTS_M, TURNS_DEG, Tolerance, find_tolerances
from placement.layout import Layout, check_layout
from placement.question import Question
from placement.setting import Setting, build_setting

from ..export.places import surveyed_positions_m
from ..figures.axes import (
    BLUE,
    VERMILION,
    Style,
    drawing_any_name,
    literal,
    unit_labels,
)
from ..figures.plan import blind_footprint, draw_scene, ground_footprint, ring_path
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
_LINE_LETTERS = 72
_LANDMARK_WITHIN_M = 40.0


def mounting_sheet(
    layout: Layout,
    setting: Setting,
    tolerances: Sequence[Tolerance],
    *,
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
    compute : Compute
        Its seed is that of sensor noise.

    Returns
    -------
    pdf : bytes
        A4 pages.
    """
    labels = unit_labels(layout)
    buffer = io.BytesIO()
    metadata = {"Title": tr("Mounting sheet: {name}", name=layout.name)}
    with drawing_any_name(), PdfPages(buffer, metadata=metadata) as pages:
        for unit, tolerance in zip(layout.units, tolerances, strict=True):
            figure = _page(layout, unit, labels[unit.id], setting, tolerance, compute)
            pages.savefig(figure)
    return buffer.getvalue()


def _page(
    layout: Layout,
    unit: CandidatePose,
    label: str,
    setting: Setting,
    tolerance: Tolerance,
    compute: Compute,
) -> Figure:
    scene = setting.scene
    figure = Figure(figsize=_A4_IN)
    name = literal(label if label == unit.id else f"{label}: {unit.id}")
    figure.text(0.08, 0.955, name, fontsize=20, fontweight="bold")
    what = tr(
        "{scene}, layout {name}; {sensor}",
        scene=scene.name,
        name=layout.name,
        sensor=unit.sensor.name,
    )
    figure.text(0.08, 0.935, literal(what), fontsize=10, color="#444444")
    top = 0.905
    bottom = 0.05
    for head, text in _rows(unit, scene, tolerance):
        figure.text(0.08, top, head, fontsize=10, fontweight="bold", va="top")
        figure.text(0.30, top, literal(text), fontsize=10, va="top", linespacing=1.35)
        top -= 0.019 * len(text.split("\n")) + 0.006
    plan_height = min(0.36, top - 0.34)
    _draw_plan(figure.add_axes((0.08, bottom, 0.84, plan_height)), unit, label, scene)
    above = (
        0.08,
        bottom + plan_height + 0.035,
        0.84,
        top - bottom - plan_height - 0.06,
    )
    _draw_picture(figure.add_axes(above), unit, setting, compute)
    return figure


def _rows(
    unit: CandidatePose, scene: Scene, tolerance: Tolerance
) -> list[tuple[str, str]]:
    level = above_ground(unit, scene)
    z = float(level.pose.position_m[2])
    surveyed_m = surveyed_positions_m([unit], scene)
    x, y = surveyed_m[0, :2].tolist()
    where = tr(
        "{x:.2f} m east, {y:.2f} m north in the junction's coordinates", x=x, y=y
    )
    if scene.crs:
        lon_deg, lat_deg = to_geographic(surveyed_m, scene.crs)[0]
        where += "\n" + tr(
            "{lat:.6f}° latitude, {lon:.6f}° longitude",
            lat=float(lat_deg),
            lon=float(lon_deg),
        )
    return [
        (tr("Mount"), _mount(unit, scene)),
        (tr("Where"), where),
        (tr("Height"), tr("{z:.2f} m above the road", z=z)),
        (tr("Scans") if is_ring(unit.sensor) else tr("Looks"), _direction(unit)),
        (tr("Tilt"), _tilt(level)),
        (tr("May be off"), _tolerance_text(tolerance)),
        (tr("Landmarks"), "\n".join(_landmarks(unit, scene)) or tr("none within 40 m")),
    ]


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
        doubt = tr("ASSUMED, look on site first: {what}", what=tr(assumed))
    else:
        doubt = ""
    texts = (", ".join(words), doubt)
    return "\n".join(
        line for text in texts for line in textwrap.wrap(text, _LINE_LETTERS)
    )


def _direction(unit: CandidatePose) -> str:
    yaw_deg = unit.pose.yaw_deg
    point = COMPASS[round(yaw_deg / 45.0) % 8]
    values = {
        "point": tr(point),
        "bearing": float(compass_bearing_deg(yaw_deg)),
        "yaw": float(yaw_deg),
    }
    if not is_ring(unit.sensor):
        return tr(
            "to the {point}: compass bearing {bearing:.1f}° (clockwise from "
            "north),\nyaw {yaw:.1f}° (counter-clockwise from east)",
            **values,
        )
    front = tr(
        "its front to the {point}: compass bearing {bearing:.1f}° "
        "(clockwise from north),\nyaw {yaw:.1f}° (counter-clockwise from "
        "east)",
        **values,
    )
    turned = tr("all round")
    if is_turn_useless(unit.sensor, pitch_deg=unit.pose.pitch_deg):
        turned = tr("all round: turned it sees the same, only its axes turn with it")
    return f"{turned}\n{front}"


def _tilt(unit: CandidatePose) -> str:
    pitch_deg = unit.pose.pitch_deg
    height_m = float(unit.pose.position_m[2])
    if is_ring(unit.sensor):
        if pitch_deg == 0.0:
            return tr("none: level, its axis upright")
        down = mark("its front {angle:.1f}° down, its back as much the other way")
        up = mark("its front {angle:.1f}° up, its back as much the other way")
        return tr(down if pitch_deg < 0.0 else up, angle=abs(pitch_deg))
    if pitch_deg >= 0.0:
        return tr("{angle:.1f}° above level", angle=pitch_deg)
    return tr(
        "{angle:.1f}° below level: the middle of the picture lies on the road"
        " {reach:.1f} m away",
        angle=-pitch_deg,
        reach=height_m / math.tan(math.radians(-pitch_deg)),
    )


def _tolerance_text(tolerance: Tolerance) -> str:
    def at_least(value: float, most: float, unit: str) -> str:
        if value <= 0.0:
            return tr("less than the smallest step tried (0{unit})", unit=unit)
        shown = localized(f"{value:g}{unit}")
        if value >= most:
            return tr("{value} or more", value=shown)
        return shown

    right, left, down, up = (
        at_least(value_deg, TURNS_DEG[-1], _DEGREE)
        for value_deg in (*tolerance.yaw_deg, *tolerance.pitch_deg)
    )
    lower, higher = (
        at_least(100.0 * value_m, 100.0 * LIFTS_M[-1], " cm")
        for value_m in tolerance.height_m
    )
    return tr(
        "{left} to the left, {right} to the right\n{up} up, {down} "
        "down\n{higher} higher, {lower} lower\none thing at a time, the "
        "other units as planned; beyond, a run is lost",
        left=left,
        right=right,
        up=up,
        down=down,
        higher=higher,
        lower=lower,
    )


def _landmarks(unit: CandidatePose, scene: Scene) -> list[str]:
    """The nearest things seen from the mount, with distance and bearing."""
    import shapely
    import shapely.ops

    here = shapely.Point(*unit.pose.position_m[:2])
    found = []
    for index, thing in enumerate(scene.instances):
        shape = thing_footprint(scene, index)
        if thing.class_name == "ground" or thing.id == unit.site_id or shape.is_empty:
            continue
        nearest = shapely.ops.nearest_points(here, shape)[1]
        distance_m = float(here.distance(nearest))
        if 0.3 < distance_m <= _LANDMARK_WITHIN_M:
            bearing = math.degrees(math.atan2(nearest.y - here.y, nearest.x - here.x))
            point = COMPASS[round(bearing / 45.0) % 8]
            words = tr(
                "{distance:.2f} m to the {point}: {kind} {name}",
                distance=distance_m,
                point=tr(point),
                kind=tr(thing.class_name),
                name=thing.id,
            )
            found.append((distance_m, words))
    found.sort(key=lambda entry: entry[0])
    return [words for _, words in found[:_N_LANDMARKS]]


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
    title = tr(
        "What it will see, rendered: {run}, {time:.1f} s before the impact",
        run=run.id,
        time=abs(time_s),
    )
    axes.set_title(literal(title), fontsize=9, loc="left")


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
    setting = build_setting(question, load_scene(question.scene), compute=compute)
    check_layout(layout, setting.scene)
    progress(mark("tolerances"), 0, 0)
    tolerances = find_tolerances(setting, layout.units, compute=compute)
    progress(WRITING, 0, 0)
    pdf = mounting_sheet(layout, setting, tolerances, compute=compute)
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
