"""Bodies placed by hand or at random, and what stands in a frame as one mesh."""

import numpy as np

from geometry.actors import PlacedActor, load_actors
from geometry.poses import Pose, to_world
from geometry.terrain import ground_height_m


def poses_within(rng, n_poses, reach_m):
    """East and north within a reach, and any yaw: (n_poses, 3). [m, m, deg]"""
    places_m = rng.uniform(-reach_m, reach_m, (n_poses, 2))
    yaws_deg = rng.uniform(-180.0, 180.0, n_poses)
    return np.column_stack([places_m, yaws_deg])


def poses_beside(rng, poses, nearest_m, farthest_m):
    """Poses (n, 3) at random distances from others, on any side of them."""
    n_poses = len(poses)
    distance_m = rng.uniform(nearest_m, farthest_m, n_poses)
    aside_m = distance_m * np.exp(1j * rng.uniform(0.0, 2.0 * np.pi, n_poses))
    turn_deg = rng.uniform(-180.0, 180.0, n_poses)
    return poses + np.column_stack([aside_m.real, aside_m.imag, turn_deg])


def parked_at(name, east_m, north_m, yaw_deg=0.0):
    """A body of the catalogue that stands there."""
    pose = Pose(position_m=[east_m, north_m, 0.0], yaw_deg=yaw_deg)
    return PlacedActor(actor=load_actors()[name], pose=pose)


def parts_of_frame(scene, run, frame):
    """Vertices and triangles of VRU, VUT, scene and all else that stands there."""
    encounter = run.encounter
    vru = encounter.vru.shapes[run.vru_shape[frame]]
    vut = encounter.vut.shapes[0]

    def stand(shape, positions_m, yaws_deg):
        """The shape where it is in the frame, on the ground."""
        place_m = positions_m[frame]
        height_m = ground_height_m(scene, place_m)
        pose = Pose(position_m=np.append(place_m, height_m), yaw_deg=yaws_deg[frame])
        return to_world(shape.vertices_m, pose), shape.triangles

    parts = [
        stand(vru, run.vru_position_m, run.vru_yaw_deg),
        stand(vut, run.vut_position_m, run.vut_yaw_deg),
        (scene.vertices_m, scene.triangles),
    ]
    for parked in run.obstruction:
        shape = parked.actor.shapes[0]
        parts.append((to_world(shape.vertices_m, parked.pose), shape.triangles))

    for driving in run.traffic:
        shape = driving.actor.shapes[0]
        parts.append(stand(shape, driving.position_m, driving.yaw_deg))

    return parts


def one_mesh(parts):
    """Vertices and triangles of all parts, and which part each triangle is of."""
    first = np.cumsum([0, *(len(vertices_m) for vertices_m, _ in parts)])
    triangles = [faces + first[n] for n, (_, faces) in enumerate(parts)]
    owner = np.repeat(np.arange(len(parts)), list(map(len, triangles)))
    vertices_m = np.concatenate([vertices_m for vertices_m, _ in parts])
    return vertices_m, np.concatenate(triangles), owner


def ahead_of(yaw_deg):
    """Unit vectors (..., 2) along yaws: east, north."""
    yaw = np.radians(yaw_deg)
    return np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
