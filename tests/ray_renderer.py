"""Instance image and depth: one ray per pixel centre, every body cast in its own frame.

A *road pose* is a row of three numbers: east and north in metres, yaw in degrees. It places the
frame of a :class:`Solid` in the frame in which the lens stands.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from geometry.actors import PlacedActor, Shape
from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.image_boxes import mask_box
from geometry.poses import Pose, body_rotation, camera_rotation, to_world
from geometry.raycast import FloatRays, RayCaster, build_caster, ray_lengths_m
from geometry.scene import Scene
from geometry.sensors import CameraModel, pixel_rays

STATIC, VRU, VUT = 0, 1, 2  # instance codes; STATIC also where nothing is hit


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solid:
    """Triangles that keep together, ready for rays in their own frame."""

    caster: RayCaster  # rays against the triangles
    hull_m: FloatArray  # (n, 3): vertices of the convex hull; none for the static world. [m]
    normals: FloatArray  # (n_triangles, 3): unit normals; none for the static world


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lens:
    """A camera at its place, with the rays of its pixels."""

    camera: CameraModel  # resolution, field of view, nearest distance that is drawn
    # where it is and looks: in the world frame, or in that of the vehicle that carries it
    pose: Pose
    # across, down: (width_px, 3), (height_px, 3): the ray of pixel (row, column), one metre deep,
    # is ``across[column] + down[row]``
    across: FloatRays
    down: FloatRays


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """A part of a camera's image: instances and depths."""

    # (h, w): the nearest thing: ``STATIC`` (also where nothing is hit), ``VRU`` or ``VUT``
    instance: NDArray[np.uint8]
    depth_m: FloatRays  # (h, w): along the optical axis; infinite where nothing is hit. [m]
    amodal_mask: BoolArray  # (h, w): pixels of the whole VRU, hidden parts too
    # x_min_px, y_min_px: where the first pixel lies in the image. [px]
    x_min_px: int
    y_min_px: int

    @property
    def amodal_box_px(self) -> FloatArray:
        """Box of the whole VRU inside the image, (4,); zeros if it is not there."""
        return mask_box(self.amodal_mask, x_min_px=self.x_min_px, y_min_px=self.y_min_px)

    @property
    def visible_box_px(self) -> FloatArray:
        """Box of the part of the VRU that is seen, (4,); zeros if none is."""
        return mask_box(self.instance == VRU, x_min_px=self.x_min_px, y_min_px=self.y_min_px)


def build_body(shape: Shape, *, library: str | None = None) -> Solid:
    """A road user at one instant of its gait, ready for rays in its body frame."""
    hull = ConvexHull(shape.vertices_m).vertices
    return Solid(
        caster=build_caster(shape.vertices_m, shape.triangles, library=library),
        hull_m=shape.vertices_m[hull],
        normals=_normals(shape),
    )


def build_static(
    scene: Scene,
    obstruction: Sequence[PlacedActor],
    *,
    middle_m: FloatArray,
    library: str | None = None,
) -> Solid:
    """Everything that stands still, with the parked bodies of a run, ready for rays.

    The origin is `middle_m`, (2,) in the world frame [m], so that coordinates are small where rays
    are cast in single precision: its road pose in the world is (*middle_m, 0).
    """
    vertices, triangles = [scene.vertices_m], [scene.triangles]
    for body in obstruction:
        shape = body.actor.shapes[0]
        triangles.append(shape.triangles + sum(map(len, vertices)))
        vertices.append(to_world(shape.vertices_m, body.pose))
    return Solid(
        caster=build_caster(
            np.concatenate(vertices) - [*middle_m, 0.0], np.concatenate(triangles), library=library
        ),
        hull_m=np.empty((0, 3)),
        normals=np.empty((0, 3)),
    )


def _normals(shape: Shape) -> FloatArray:
    """Unit normals of a shape's triangles, (n_triangles, 3)."""
    a, b, c = np.moveaxis(shape.vertices_m[shape.triangles], 1, 0)
    across = np.cross(b - a, c - a)
    normals: FloatArray = across / np.linalg.norm(across, axis=1, keepdims=True).clip(1.0e-12)
    return normals


def build_lens(pose: Pose, camera: CameraModel) -> Lens:
    """A camera at its place, in the frame of `pose`: the world, or the VUT."""
    columns, rows = np.arange(camera.width_px), np.arange(camera.height_px)
    across = pixel_rays(columns, np.zeros_like(columns), pose, camera)
    down = pixel_rays(np.zeros_like(rows), rows, pose, camera)
    return Lens(
        camera=camera,
        pose=pose,
        across=across.astype(np.float32),
        down=(down - across[0]).astype(np.float32),
    )


def render_view(
    lens: Lens,
    *,
    static: tuple[Solid, FloatArray],
    vru: tuple[Solid, FloatArray],
    vut: tuple[Solid, FloatArray] | None = None,
    crop_px: tuple[int, int, int, int] | None = None,
) -> View:
    """Render the image of a camera, or a part of it.

    `static`, `vru` and `vut` come with their road poses (3,) in the lens's frame; without `vut`
    there is no VUT, as for the VUT's own camera. `crop_px` is x_min, y_min, x_max, y_max: columns
    x_min .. x_max - 1 and rows y_min .. y_max - 1; by default the whole image.
    """
    whole = (0, 0, lens.camera.width_px, lens.camera.height_px)
    crop = np.array([crop_px or whole], dtype=np.int64)
    x_min, y_min, x_max, y_max = crop[0].tolist()
    shape = (y_max - y_min, x_max - x_min)
    instance = np.full(shape, STATIC, dtype=np.uint8)
    depth = cast_crops(lens, static[0], static[1][None], crop)[0].reshape(shape)
    amodal_mask = np.zeros(shape, dtype=bool)
    for code, body in ((VRU, vru), (VUT, vut)):
        if body is None:
            continue
        body_depth = cast_crops(lens, body[0], body[1][None], crop)[0].reshape(shape)
        if code == VRU:
            amodal_mask = np.isfinite(body_depth)
        is_nearer = body_depth < depth
        instance[is_nearer] = code
        depth[is_nearer] = body_depth[is_nearer]
    return View(
        instance=instance, depth_m=depth, amodal_mask=amodal_mask, x_min_px=x_min, y_min_px=y_min
    )


def crop_boxes(
    lens: Lens, hull_m: FloatArray, road_poses: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Parts of the image that hold a body, and its depths, for many road poses (n, 3).

    Gives (n, 4) the box around the projection of the hull's vertices (body frame), a pixel larger,
    clipped to the image [px]: zeros where the body is outside the field of view, the whole image
    where it reaches behind the lens; and (n, 2) the depth of the nearest and the farthest vertex
    [m].
    """
    camera = lens.camera
    right, down, depth = _hulls_in_camera(lens, hull_m, road_poses)
    size_px = np.array([camera.width_px, camera.height_px], dtype=np.float64)
    low, high = np.empty((len(road_poses), 2)), np.empty((len(road_poses), 2))
    is_outside = (depth <= 0.0).all(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):  # replaced below
        for axis, aside in enumerate((right, down)):
            aside_px = camera.focal_length_px * aside
            # The planes through the lens and the image's edges: they also hold behind the lens.
            for side in (-1.0, 1.0):
                is_outside |= (side * aside_px > 0.5 * size_px[axis] * depth).all(axis=1)
            pixels = 0.5 * size_px[axis] + aside_px / depth
            low[:, axis], high[:, axis] = pixels.min(axis=1), pixels.max(axis=1)
    depths = np.stack([depth.min(axis=1), depth.max(axis=1)], axis=1)
    reaches_behind = depths[:, 0] <= _MIN_DEPTH_M
    low[reaches_behind], high[reaches_behind] = 0.0, size_px
    crops = np.concatenate(
        [np.clip(np.floor(low) - 1.0, 0.0, size_px), np.clip(np.ceil(high) + 1.0, 0.0, size_px)],
        axis=1,
    ).astype(np.int64)
    crops[is_outside | (crops[:, 2:] <= crops[:, :2]).any(axis=1)] = 0
    return crops, depths


def inside_shares(lens: Lens, hull_m: FloatArray, road_poses: FloatArray) -> FloatArray:
    """Part of a body's box that the image's edges do not cut off, (n,) 0 .. 1.

    It is 0 where the body reaches behind the lens.
    """
    right, down, depth = _hulls_in_camera(lens, hull_m, road_poses)
    inside = np.ones(len(road_poses))
    with np.errstate(divide="ignore", invalid="ignore"):  # replaced below
        for aside, size_px in ((right, lens.camera.width_px), (down, lens.camera.height_px)):
            pixels = 0.5 * size_px + lens.camera.focal_length_px * aside / depth
            low, high = pixels.min(axis=1), pixels.max(axis=1)
            cut = np.clip(high, 0.0, size_px) - np.clip(low, 0.0, size_px)
            inside *= cut / np.maximum(high - low, 1.0e-9)
    return np.where(depth.min(axis=1) > _MIN_DEPTH_M, inside, 0.0)


def cast_crops(
    lens: Lens,
    solid: Solid,
    road_poses: FloatArray,
    crops_px: IntArray,
    masks: Sequence[BoolArray] | None = None,
) -> list[FloatRays]:
    """Depths of one solid at many road poses (n, 3), in a part of the image for each, in one go.

    `crops_px` is (n, 4): x_min, y_min, x_max, y_max; `masks` say which of their pixels are wanted,
    by default all. Depths are float32, row by row, infinite where nothing is hit beyond the
    camera's nearest distance [m].
    """
    rotations, origins = _into_body(lens, road_poses)
    shapes = crops_px[:, [3, 2]] - crops_px[:, [1, 0]]
    counts = shapes.prod(axis=1) if masks is None else [np.count_nonzero(mask) for mask in masks]
    ends = np.cumsum(counts).tolist()
    parts = [slice(start, end) for start, end in zip([0, *ends], ends, strict=False)]
    directions = np.empty((ends[-1], 3), dtype=np.float32)
    turns = rotations.astype(np.float32)
    for index, (x_min, y_min, x_max, y_max) in enumerate(crops_px.tolist()):
        across = lens.across[x_min:x_max] @ turns[index]
        down = lens.down[y_min:y_max] @ turns[index]
        rays = directions[parts[index]]
        if masks is None:
            np.add(across[None], down[:, None], out=rays.reshape(*shapes[index], 3))
        else:
            rows, columns = np.nonzero(masks[index])
            np.add(across[columns], down[rows], out=rays)
    # Rays start where drawing starts: at the nearest distance from the lens.
    near_depth = lens.camera.near_m / ray_lengths_m(directions)
    starts = near_depth[:, None] * directions
    for part, origin in zip(parts, origins.astype(np.float32), strict=True):
        starts[part] += origin
    depth = solid.caster.first_hit(starts, directions) + near_depth
    return [depth[part] for part in parts]


_MIN_DEPTH_M = 1.0e-6


def _hulls_in_camera(lens: Lens, hull_m: FloatArray, road_poses: FloatArray) -> FloatArray:
    """Right, down and depth of every vertex at every pose, (3, n, n_vertices)."""
    rotations, origins = _into_body(lens, road_poses)
    R_body_camera = rotations.transpose(0, 2, 1) @ camera_rotation(
        lens.pose.yaw_deg, lens.pose.pitch_deg
    )
    return np.moveaxis((hull_m - origins[:, None, :]) @ R_body_camera, -1, 0)


def _into_body(lens: Lens, road_poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """R_lens_body (rows @ it: into the body's frame), and where the lens is in that frame."""
    rotations = body_rotation(road_poses[:, 2])
    offsets = np.repeat(lens.pose.position_m[None], len(road_poses), axis=0)
    offsets[:, :2] -= road_poses[:, :2]
    origins: FloatArray = (offsets[:, None, :] @ rotations)[:, 0]
    return rotations, origins
