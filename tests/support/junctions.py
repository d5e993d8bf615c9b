"""Junctions to lay cases on: Euro NCAP's own, and others made from it."""

import numpy as np

from geometry.scene import Instance, Lane, Scene

LANE_M = 3.5
MOUTH_M = 11.5
ARM_M = 250.0  # Euro NCAP AEB/LSS VRU: intersection
SQUARE_M = MOUTH_M * np.array(
    [
        [1.0, -1.0],
        [1.0, 1.0],
        [-1.0, 1.0],
        [-1.0, -1.0],
    ]
)
ARMS = {
    "east": 0.0,
    "north": 90.0,
    "west": 180.0,
    "south": 270.0,
}


def turned(points_m, angle_deg):
    """Points turned by an angle around the origin."""
    angle = np.radians(angle_deg)
    matrix = np.array(
        [
            [np.cos(angle), -np.sin(angle)],
            [np.sin(angle), np.cos(angle)],
        ]
    )
    return np.asarray(points_m) @ matrix.T


def lanes_of(arm, bearing_deg, *, n_lanes=1, arm_m=ARM_M, has_in=True, has_out=True):
    """Lanes of an arm that leaves the junction in a direction; right-hand traffic."""
    lanes = []
    for index in range(n_lanes):
        offset_m = (n_lanes - index - 0.5) * LANE_M  # 0 is at the kerb
        way_in = [
            [MOUTH_M + arm_m, offset_m],
            [MOUTH_M, offset_m],
        ]
        way_out = [
            [MOUTH_M, -offset_m],
            [MOUTH_M + arm_m, -offset_m],
        ]
        for exists, name, way in (
            (has_in, "in", way_in),
            (has_out, "out", way_out),
        ):
            if exists:
                lanes.append(
                    Lane(
                        id=f"{arm}-{name}-{index}",
                        kind="driving",
                        width_m=LANE_M,
                        centreline_m=turned(way, bearing_deg),
                    )
                )

    return lanes


def build_scene(lanes, *, name="protocol", boxes=(), crosswalks_m=(), outline_m=None):
    """A scene with these lanes, and boxes (id, x, y, length, width, height) on it."""
    vertices = []
    triangles = []
    instance_of = []
    instances = [Instance(id="ground", class_name="ground")]
    vertices.append(
        np.array(
            [
                [-400.0, -400.0, 0.0],
                [400.0, -400.0, 0.0],
                [0.0, 600.0, 0.0],
            ]
        )
    )
    triangles.append(np.array([[0, 1, 2]]))
    instance_of.append(np.array([0]))

    for box_id, x, y, length, width, height in boxes:
        import trimesh

        box = trimesh.creation.box([length, width, height])
        triangles.append(np.asarray(box.faces) + sum(map(len, vertices)))
        vertices.append(np.asarray(box.vertices) + [x, y, 0.5 * height])
        instance_of.append(np.full(len(box.faces), len(instances)))
        instances.append(Instance(id=box_id, class_name="wall"))

    return Scene(
        name=name,
        vertices_m=np.concatenate(vertices),
        triangles=np.concatenate(triangles),
        triangle_instance=np.concatenate(instance_of),
        instances=tuple(instances),
        sites=(),
        outline_m=SQUARE_M if outline_m is None else outline_m,
        lanes=tuple(lanes),
        crs="EPSG:25832",
        crosswalks_m=np.array(crosswalks_m, dtype=float).reshape(-1, 2, 2),
    )


def protocol_scene(**scene_fields):
    """Euro NCAP's junction: four arms at right angles, one lane of 3.5 m per
    direction.
    """
    lanes = [lane for arm, bearing in ARMS.items() for lane in lanes_of(arm, bearing)]
    return build_scene(lanes, **scene_fields)
