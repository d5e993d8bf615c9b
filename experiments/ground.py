"""What lies on the ground and stands there, from above: shared by plan and film."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch, Polygon
from matplotlib.path import Path

from geometry.actors import PlacedActor
from geometry.arrays import FloatArray
from geometry.footprints import footprint_corners
from geometry.scene import Lane, Scene
from geometry.scene_footprints import thing_footprint

CLASS_STYLES: dict[str, dict[str, Any]] = {
    "building": {"facecolor": "#c9c4bb", "edgecolor": "#8d887f", "linewidth": 0.8},
    "wall": {"facecolor": "#5b5b5b", "edgecolor": "#5b5b5b", "linewidth": 1.2},
    "vegetation": {"facecolor": "#b7d3ae", "edgecolor": "#7d9c73", "linewidth": 0.6},
    "parked vehicle": {"facecolor": "#a9a9a9", "edgecolor": "#6e6e6e", "linewidth": 0.6},
    "traffic light": {"facecolor": "#7a7a7a", "edgecolor": "#7a7a7a", "linewidth": 0.8},
}
PARKED_STYLE: dict[str, Any] = {
    "facecolor": "#f2f2f2",
    "edgecolor": "#8a8a8a",
    "linewidth": 0.7,
    "hatch": "....",
}
SITE_STYLE: dict[str, Any] = {
    "marker": "o",
    "markersize": 4.0,
    "markerfacecolor": "white",
    "markeredgecolor": "#444444",
    "markeredgewidth": 0.9,
}


def draw_scene(axes: Axes, scene: Scene) -> None:
    """Draw lanes, sites, buildings and walls; later things go on top up to zorder 6.5."""
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
    for index, instance in enumerate(scene.instances):
        if instance.class_name in CLASS_STYLES:
            path = _footprint_path(scene, index)
            axes.add_patch(PathPatch(path, zorder=6.5, **CLASS_STYLES[instance.class_name]))
    sites = np.array([site.position_m[:2] for site in scene.sites]).reshape(-1, 2)
    axes.plot(*sites.T, linestyle="none", zorder=5, **SITE_STYLE)


def draw_parked(axes: Axes, bodies: Iterable[PlacedActor]) -> None:
    """Draw bodies that belong to single cases: footprints, each once."""
    for body in {body.key: body for body in bodies}.values():
        corners = footprint_corners(
            body.pose.position_m[:2],
            body.pose.yaw_deg,
            length_m=body.actor.length_m,
            width_m=body.actor.width_m,
        )
        axes.add_patch(Polygon(corners, zorder=2.2, **PARKED_STYLE))


def _footprint_path(scene: Scene, index: int) -> Path:
    """What a thing covers, courtyards left out."""
    shape = thing_footprint(scene, index)
    rings = [
        np.asarray(ring.coords)
        for part in getattr(shape, "geoms", [shape])
        if part.geom_type == "Polygon"
        for ring in (part.exterior, *part.interiors)
    ]
    return Path.make_compound_path(*(Path(ring, closed=True) for ring in rings if len(ring)))


def _lane_polygon(lane: Lane) -> FloatArray:
    direction = np.gradient(lane.centreline_m, axis=0)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    left = 0.5 * lane.width_m * np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    polygon: FloatArray = np.concatenate(
        [lane.centreline_m + left, (lane.centreline_m - left)[::-1]]
    )
    return polygon
