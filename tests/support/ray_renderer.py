"""Instance image and depth with one ray per pixel centre: what the evaluator is tested
against.

It shares nothing with the evaluator's pixels but the scene, the poses and the meshes:
rays are cast by Embree, in single precision, every body in its own frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from camera_rays import pixel_rays
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.image_boxes import mask_box
from geometry.poses import Pose, body_rotation
from geometry.raycast import FloatRays, ray_lengths_m
from geometry.sensors import CameraModel
from placement.evaluator.surroundings import Solid, Surroundings

STATIC = 0
VRU = 1
VUT = 2  # instance codes; STATIC also where nothing is hit


@dataclass(
    frozen=True,
    slots=True,
    kw_only=True,
    eq=False,
)
class Lens:
    """A camera at its place, with the rays of its pixels."""

    camera: CameraModel  # resolution, field of view, nearest distance that is drawn
    # where it is and looks: in the world frame, or in that of the vehicle that carries
    # it
    pose: Pose
    # across, down: (width_px, 3), (height_px, 3): the ray of pixel (row, column), one
    # metre deep, is ``across[column] + down[row]``
    across: FloatRays
    down: FloatRays


@dataclass(
    frozen=True,
    slots=True,
    kw_only=True,
    eq=False,
)
class View:
    """A part of a camera's image: instances and depths."""

    # (h, w): the nearest thing: ``STATIC`` (also where nothing is hit), ``VRU``, or
    # ``VUT``, as also for other vehicles
    instance: NDArray[np.uint8]
    depth_m: (
        FloatRays  # (h, w): along the optical axis; infinite where nothing is hit. [m]
    )
    amodal_mask: BoolArray  # (h, w): pixels of the whole VRU, hidden parts too
    # x_min_px, y_min_px: where the first pixel lies in the image. [px]
    x_min_px: int
    y_min_px: int

    @property
    def amodal_box_px(self) -> FloatArray:
        """Box of the whole VRU inside the image, (4,); zeros if it is not there."""
        return self._box_px(self.amodal_mask)

    @property
    def visible_box_px(self) -> FloatArray:
        """Box of the part of the VRU that is seen, (4,); zeros if none is."""
        return self._box_px(self.instance == VRU)

    def _box_px(self, mask: BoolArray) -> FloatArray:
        shift_px = np.array([self.x_min_px, self.y_min_px] * 2)
        if mask.any():
            return mask_box(mask) + shift_px
        return np.zeros(4)


def build_lens(pose: Pose, camera: CameraModel) -> Lens:
    """A camera at its place, in the frame of `pose`: the world, or the VUT."""
    columns = np.arange(camera.width_px)
    rows = np.arange(camera.height_px)
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
    traffic: Sequence[tuple[Solid, FloatArray]] = (),
    crop_px: tuple[int, int, int, int] | None = None,
) -> View:
    """Render the image of a camera, or a part of it.

    `static`, `vru`, `vut` and `traffic` come with their road poses (4,) in the lens's
    frame; without `vut` there is no VUT, as for the VUT's own camera. `crop_px` is
    x_min, y_min, x_max, y_max: columns x_min .. x_max - 1 and rows y_min .. y_max - 1;
    by default the whole image.
    """
    whole = (0, 0, lens.camera.width_px, lens.camera.height_px)
    crop = np.array([crop_px or whole], dtype=np.int64)
    x_min, y_min, x_max, y_max = crop[0].tolist()
    shape = (y_max - y_min, x_max - x_min)
    instance = np.full(shape, STATIC, dtype=np.uint8)
    depth = cast_crops(lens, static[0], static[1][None], crop)[0].reshape(shape)
    amodal_mask = np.zeros(shape, dtype=bool)

    for code, body in (
        (VRU, vru),
        (VUT, vut),
        *((VUT, vehicle) for vehicle in traffic),
    ):
        if body is None:
            continue
        body_depth = cast_crops(lens, body[0], body[1][None], crop)[0].reshape(shape)
        if code == VRU:
            amodal_mask = np.isfinite(body_depth)
        is_nearer = body_depth < depth
        instance[is_nearer] = code
        depth[is_nearer] = body_depth[is_nearer]

    return View(
        instance=instance,
        depth_m=depth,
        amodal_mask=amodal_mask,
        x_min_px=x_min,
        y_min_px=y_min,
    )


def render_frame(
    surroundings: Surroundings,
    frame_index: int,
    pose: Pose,
    camera: CameraModel,
    *,
    with_vut: bool = True,
    crop_px: tuple[int, int, int, int] | None = None,
) -> View:
    """Render one frame of some surroundings; `crop_px` as for :func:`render_view`."""
    vut = (surroundings.vehicles[0], surroundings.vut_poses[frame_index])
    driving = surroundings.traffic_index[frame_index]
    return render_view(
        build_lens(pose, camera),
        static=(
            surroundings.statics[surroundings.static_index[frame_index]],
            surroundings.static_poses[frame_index],
        ),
        vru=(
            surroundings.vrus[surroundings.vru_index[frame_index]],
            surroundings.vru_poses[frame_index],
        ),
        vut=vut if with_vut else None,
        traffic=[
            (surroundings.vehicles[index], pose)
            for index, pose in zip(
                driving, surroundings.traffic_poses[frame_index], strict=True
            )
            if index >= 0
        ],
        crop_px=crop_px,
    )


def cast_crops(
    lens: Lens, solid: Solid, road_poses: FloatArray, crops_px: IntArray
) -> list[FloatRays]:
    """Depths of one solid at many road poses (n, 4), in a part of the image for each,
    in one go.

    `crops_px` is (n, 4): x_min, y_min, x_max, y_max. Depths are float32, row by row,
    infinite where nothing is hit beyond the camera's nearest distance [m].
    """
    rotations, origins = _into_body(lens, road_poses)
    shapes = crops_px[:, [3, 2]] - crops_px[:, [1, 0]]
    ends = np.cumsum(shapes.prod(axis=1)).tolist()
    parts = [slice(start, end) for start, end in zip([0, *ends], ends, strict=False)]
    directions = np.empty((ends[-1], 3), dtype=np.float32)
    turns = rotations.astype(np.float32)

    for index, (x_min, y_min, x_max, y_max) in enumerate(crops_px.tolist()):
        across = lens.across[x_min:x_max] @ turns[index]
        down = lens.down[y_min:y_max] @ turns[index]
        rays = directions[parts[index]]
        np.add(across[None], down[:, None], out=rays.reshape(*shapes[index], 3))
    # Rays start where drawing starts: at the nearest distance from the lens.
    near_depth = lens.camera.near_m / ray_lengths_m(directions)
    starts = near_depth[:, None] * directions
    for part, origin in zip(parts, origins.astype(np.float32), strict=True):
        starts[part] += origin
    depth = solid.caster.first_triangle(starts, directions)[0] + near_depth
    return [depth[part] for part in parts]


def _into_body(lens: Lens, road_poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """R_lens_body (rows @ it: into the body's frame), and where the lens is in that
    frame.
    """
    rotations = body_rotation(road_poses[:, 2])
    offsets = np.repeat(lens.pose.position_m[None], len(road_poses), axis=0)
    offsets -= road_poses[:, [0, 1, 3]]
    origins: FloatArray = (offsets[:, None, :] @ rotations)[:, 0]
    return rotations, origins
