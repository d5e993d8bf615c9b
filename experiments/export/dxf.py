"""Layouts as layers of a drawing: DXF."""

import io
import re
from typing import Any

import numpy as np

from geometry.scene import Scene
from placement.layout import Layout

from . import ExportFormat, load_extra
from .places import metric_points
from .views import find_views

_LAYERS = {"LANES": 8, "CROSSWALKS": 9, "POLES": 3, "UNITS": 5, "UNSEEN": 1}
_VIEWS = 140
# $INSUNITS.
_METRES = 6
_TEXT_M = 0.6
_POLE_M = 0.3
_ARROW_M = 4.0


def to_dxf(layout: Layout, scene: Scene) -> str:
    """Layout as a DXF drawing in metres.

    In the coordinates of the scene's map if these are metres.

    Layers: LANES and CROSSWALKS (lines), POLES (circles: all sites, with their ids),
    UNITS (arrows along the view at the height of the unit, with their ids), VIEWS
    (outlines of what each camera sees, with its id as layer VIEWS-ID), UNSEEN (road
    that no camera sees). Maps in degrees are drawn in the world frame. Not in it:
    buildings, and the ground's heights. Raises MissingExtraError if ezdxf is not
    installed.
    """
    ezdxf = load_extra("ezdxf", "dxf needs ezdxf", "dxf")
    drawing = ezdxf.new("R2010", units=_METRES)
    for name, colour in _LAYERS.items():
        drawing.layers.add(name, color=colour)
    space = drawing.modelspace()

    def place(points_m: Any) -> Any:
        return metric_points(np.asarray(points_m, dtype=np.float64), scene)

    for lane in scene.lanes:
        space.add_lwpolyline(place(lane.centreline_m), dxfattribs={"layer": "LANES"})
    for ends_m in scene.crosswalks_m:
        space.add_lwpolyline(place(ends_m), dxfattribs={"layer": "CROSSWALKS"})
    for site in scene.sites:
        (foot,) = place(site.position_m[None, :2])
        on = {"layer": "POLES"}
        space.add_circle(foot, _POLE_M, dxfattribs=on)
        space.add_text(site.id, height=_TEXT_M, dxfattribs=on).set_placement(foot)
    for unit in layout.units:
        yaw_rad = np.radians(unit.pose.yaw_deg)
        ahead_m = _ARROW_M * np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
        at_m = unit.pose.position_m
        ends = place([at_m[:2], at_m[:2] + ahead_m])
        on = {"layer": "UNITS"}
        space.add_line(*([*end, at_m[2]] for end in ends.tolist()), dxfattribs=on)
        space.add_text(unit.id, height=_TEXT_M, dxfattribs=on).set_placement(ends[1])
    for view in find_views(layout, scene, place):
        # Without what the format forbids in names.
        name = re.sub(r'[<>/\\":;?*|=`,]', "_", view.unit)
        if view.unit:
            layer = f"VIEWS-{name}"
        else:
            layer = "UNSEEN"
        if layer not in drawing.layers:
            drawing.layers.add(layer, color=_VIEWS)
        for polygon in getattr(view.area, "geoms", [view.area]):
            for ring in (polygon.exterior, *polygon.interiors):
                points = list(ring.coords)[:-1]
                space.add_lwpolyline(
                    points, format="xy", close=True, dxfattribs={"layer": layer}
                )
    file = io.StringIO()
    drawing.write(file)
    return file.getvalue()


FORMAT = ExportFormat(
    write=to_dxf,
)
