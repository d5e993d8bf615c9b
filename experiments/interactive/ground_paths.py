"""What lies and stands on the ground, as SVG paths in whole centimetres."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from geometry.arrays import FloatArray
from geometry.junction import build_junction
from geometry.scene import Lane, Scene
from geometry.scene_footprints import thing_footprint

from ..ground import CLASS_STYLES

_MAX_HALF_M = 120.0  # farther things are never in the player's window
_LEAST_HALF_M = 30.0
_TOLERANCE_M = 0.1  # corners nearer than this to the line between their neighbours drop out
_LABEL_SHARE = 0.86


def plan_record(scene: Scene, unit_positions_m: FloatArray) -> dict[str, Any]:
    """The still part of the player's plan.

    Parameters
    ----------
    scene : Scene
        What is drawn.
    unit_positions_m : (n, 2) float
        The window holds these, too, unless they are very far. World frame. [m]

    Returns
    -------
    record : dict
        "middle" and "half" of the window, "classes" (name, colour, path), "sites", "crosswalks",
        "arms" (name, place). Centimetres.
    """
    import shapely

    middle = 0.5 * (scene.outline_m.min(axis=0) + scene.outline_m.max(axis=0))
    window = shapely.box(*(middle - _MAX_HALF_M), *(middle + _MAX_HALF_M))
    reach = np.abs(np.concatenate([scene.outline_m, unit_positions_m]) - middle).max() + 8.0
    half = float(np.clip(reach, _LEAST_HALF_M, 0.5 * _MAX_HALF_M))
    layers: list[tuple[str, str, Any]] = [
        ("parking lane", "#ececec", _areas(scene.lanes, "parking")),
        ("lane", "#dedede", _areas(scene.lanes, "driving")),
        ("junction", "#dedede", shapely.make_valid(shapely.Polygon(scene.outline_m))),
    ]
    for name, style in CLASS_STYLES.items():
        parts = [
            thing_footprint(scene, index)
            for index, thing in enumerate(scene.instances)
            if thing.class_name == name
        ]
        layers.append((name, str(style["facecolor"]), shapely.union_all(parts)))
    paths = [
        {"name": name, "colour": colour, "path": _svg_path(shape.intersection(window))}
        for name, colour, shape in layers
    ]
    return {
        "middle": _centimetres(middle),
        "half": round(100.0 * half),
        "classes": [path for path in paths if path["path"]],
        "sites": _centimetres(
            np.array([site.position_m[:2] for site in scene.sites]).reshape(-1, 2)
        ),
        "crosswalks": _centimetres(scene.crosswalks_m),
        "arms": _arm_labels(scene, middle, half),
    }


def lane_area(lane: Lane) -> Any:
    """What a lane covers: a shapely polygon. World frame, metres."""
    import shapely

    return shapely.LineString(lane.centreline_m).buffer(0.5 * lane.width_m, cap_style="flat")


def road_area(scene: Scene) -> Any:
    """Lanes and the junction's inside: a shapely polygon or several. World frame, metres."""
    import shapely

    inside = shapely.make_valid(shapely.Polygon(scene.outline_m))
    return shapely.union_all([inside, *(lane_area(lane) for lane in scene.lanes)])


def _areas(lanes: Iterable[Lane], kind: str) -> Any:
    import shapely

    # Not put together: the white lines between lanes stay.
    areas = [lane_area(lane) for lane in lanes if lane.kind == kind]
    return shapely.geometrycollections(areas)


def _svg_path(shape: Any) -> str:
    """Closed rings of all polygons of a shape."""
    import shapely

    parts = shapely.get_parts(shapely.get_parts(shape).tolist())
    rings = [
        ring
        for part in parts
        if part.geom_type == "Polygon" and not part.is_empty
        for simple in shapely.get_parts(part.simplify(_TOLERANCE_M))
        if simple.geom_type == "Polygon"
        for ring in (simple.exterior, *simple.interiors)
    ]
    return "".join(
        "M" + "L".join(f"{x} {y}" for x, y in _centimetres(np.asarray(ring.coords)[:-1])) + "Z"
        for ring in rings
        if len(ring.coords) > 3
    )


def _arm_labels(scene: Scene, middle_m: FloatArray, half_m: float) -> list[dict[str, Any]]:
    labels = []
    for arm in build_junction(scene).arms.values():
        mouths = [lane.centreline_m[-1] for lane in arm.lanes_in]
        mouths += [lane.centreline_m[0] for lane in arm.lanes_out]
        outward = np.mean(mouths, axis=0) - middle_m
        outward /= max(float(np.hypot(*outward)), 1.0e-9)
        place = middle_m + _LABEL_SHARE * half_m * outward
        labels.append({"name": arm.name, "place": _centimetres(place)})
    return labels


def _centimetres(values_m: FloatArray) -> Any:
    return np.rint(100.0 * values_m).astype(int).tolist()
