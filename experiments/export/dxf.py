"""Layouts as layers of a drawing: DXF."""

import io
import re
from typing import Any

import numpy as np
import shapely

from geometry.arrays import FloatArray
from geometry.errors import InputError
from geometry.frames import check_crs, parse_crs, to_geographic, transform
from geometry.scene import Scene, road_area, thing_footprint
from placement.layout import Layout

from ..language import mark, tr
from . import ExportFormat, load_extra
from .places import require_crs
from .views import find_views

_LAYERS = {
    "JUNCTION": (7, mark("area of the junction")),
    "KERBS": (30, mark("road edges, from the lane widths")),
    "LANES": (8, mark("lane centrelines")),
    "CROSSWALKS": (9, mark("crossing paths, from kerb to kerb")),
    "BUILDING": (42, mark("buildings, closed")),
    "WALL": (44, mark("walls, closed")),
    "VEGETATION": (92, mark("trees and hedges, closed")),
    "PARKED VEHICLE": (251, mark("parked vehicles, closed")),
    "POLES": (3, mark("poles that may carry a unit, with their ids")),
    "UNITS": (6, mark("units; the line shows the viewing direction")),
    "VIEWS": (140, mark("area that each camera sees: one layer per unit")),
    "UNSEEN": (1, mark("road that no camera sees")),
    "LEGEND": (7, mark("this list")),
}
"""By layer: its colour (AutoCAD's index), and what it holds, for the legend."""
# $INSUNITS.
_METRES = 6
_TEXT_M = 1.0
_POLE_M = 0.3
_ARROW_M = 4.0
# Lanes that are no farther apart than twice this have no kerb between them.
_GAP_M = 0.25
# Of the legend: its letters, from line to line, and the sample of a layer.
_LEGEND_TEXT_M = 2.0
_LINE_M = 4.0
_SAMPLE_M = 8.0


def to_dxf(layout: Layout, scene: Scene, *, crs: str = "") -> str:
    """Layout as a DXF drawing in metres.

    In the coordinate system `crs`, or else as :func:`drawing_crs` finds it. Layers are
    those of the legend, which is drawn beside the junction and stands in the layers'
    descriptions; the view of each camera has a layer of its own, VIEWS-ID. Areas are
    closed polylines. Not in it: the ground's heights. Raises MissingExtraError if
    ezdxf is not installed, InputError for a `crs` that is unknown or not in metres.
    """
    ezdxf = load_extra("ezdxf", "dxf needs ezdxf", "dxf")
    wanted = drawing_crs(scene, crs)
    drawing = ezdxf.new("R2010", units=_METRES)
    for name, (colour, content) in _LAYERS.items():
        drawing.layers.add(name, color=colour).description = tr(content)
    space = drawing.modelspace()

    def place(points_m: Any) -> FloatArray:
        points = np.asarray(points_m, dtype=np.float64)
        if wanted:
            return transform(points, scene.crs, wanted)
        return points + scene.source_origin_m

    def add_areas(area: Any, layer: str) -> None:
        """Draw the rings of polygons that lie in the drawing's coordinates."""
        for polygon in getattr(area, "geoms", [area]):
            for ring in (polygon.exterior, *polygon.interiors):
                points = list(ring.coords)[:-1]
                space.add_lwpolyline(
                    points, format="xy", close=True, dxfattribs={"layer": layer}
                )

    def add_text(text: str, at: Any, layer: str, height_m: float = _TEXT_M) -> None:
        on = {"layer": layer}
        space.add_text(text, height=height_m, dxfattribs=on).set_placement(at)

    add_areas(shapely.Polygon(place(scene.outline_m)), "JUNCTION")
    road = road_area(scene).buffer(_GAP_M, join_style="mitre")
    road = shapely.transform(road.buffer(-_GAP_M, join_style="mitre"), place)
    add_areas(road, "KERBS")
    for lane in scene.lanes:
        space.add_lwpolyline(place(lane.centreline_m), dxfattribs={"layer": "LANES"})
    for ends_m in scene.crosswalks_m:
        space.add_lwpolyline(place(ends_m), dxfattribs={"layer": "CROSSWALKS"})
    for index, thing in enumerate(scene.instances):
        layer = thing.class_name.upper()
        if layer in _LAYERS:
            add_areas(shapely.transform(thing_footprint(scene, index), place), layer)
    for site in scene.sites:
        (foot,) = place(site.position_m[None, :2])
        space.add_circle(foot, _POLE_M, dxfattribs={"layer": "POLES"})
        add_text(site.id, foot, "POLES")
    for unit in layout.units:
        yaw_rad = np.radians(unit.pose.yaw_deg)
        ahead_m = _ARROW_M * np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
        at_m = unit.pose.position_m
        ends = place([at_m[:2], at_m[:2] + ahead_m])
        on = {"layer": "UNITS"}
        space.add_line(*([*end, at_m[2]] for end in ends.tolist()), dxfattribs=on)
        add_text(unit.id, ends[1], "UNITS")
    for view in find_views(layout, scene, place):
        layer = "UNSEEN"
        if view.unit:
            # Without what the format forbids in names.
            layer = "VIEWS-" + re.sub(r'[<>/\\":;?*|=`,]', "_", view.unit)
        if layer not in drawing.layers:
            drawing.layers.add(layer, color=_LAYERS["VIEWS"][0])
        add_areas(view.area, layer)
    # Beside the junction, where the longest arm ends.
    _, _, right_m, top_m = road.bounds
    left_m = right_m + _SAMPLE_M
    add_text(_coordinates(wanted), (left_m, top_m), "LEGEND", _LEGEND_TEXT_M)
    for line, (name, (_, content)) in enumerate(_LAYERS.items(), start=1):
        y_m = top_m - line * _LINE_M
        sample = [(left_m, y_m), (left_m + _SAMPLE_M, y_m)]
        space.add_lwpolyline(sample, dxfattribs={"layer": name})
        text = f"{name}: {tr(content)}"
        beside = (left_m + _SAMPLE_M + _LEGEND_TEXT_M, y_m)
        add_text(text, beside, "LEGEND", _LEGEND_TEXT_M)
    file = io.StringIO()
    drawing.write(file)
    return file.getvalue()


def drawing_crs(scene: Scene, crs: str = "") -> str:
    """Coordinate system in metres in which a drawing of a scene lies.

    `crs`, or else that of the scene's map; for a map in degrees the UTM zone (WGS 84)
    of the junction's middle. Empty: nobody knows where on earth the scene lies.
    Raises InputError if `crs` is unknown, not in metres, or asked of such a scene.
    """
    if crs:
        require_crs(scene.crs, f"--crs {crs}")
        check_crs(crs, "--crs")
        axes = parse_crs(crs).axis_info
        if not all(axis.unit_name == "metre" for axis in axes):
            raise InputError("--crs", crs, "one in metres, such as EPSG:25832")
        return crs
    declared = scene.source_crs or scene.crs
    if not declared or not parse_crs(declared).is_geographic:
        return declared
    middle_m = scene.outline_m.mean(axis=0)
    ((longitude_deg, latitude_deg),) = to_geographic(middle_m[None], scene.crs)
    zone = int((longitude_deg + 180.0) // 6.0) % 60 + 1
    first = 32600 if latitude_deg >= 0.0 else 32700
    return f"EPSG:{first + zone}"


def _coordinates(crs: str) -> str:
    """Line of the legend that names the coordinates."""
    if not crs:
        return tr("Coordinates: the model's own, in metres")
    name = parse_crs(crs).name
    if name == "unknown":
        return tr("Coordinates: {crs}, in metres", crs=crs)
    return tr("Coordinates: {crs} ({name}), in metres", crs=crs, name=name)


FORMAT = ExportFormat(
    write=to_dxf,
    options=("crs",),
)
