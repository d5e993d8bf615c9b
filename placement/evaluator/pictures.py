"""Pictures for networks, whole ones and crops, and of one frame of a run."""

from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass, replace
from threading import Lock
from typing import NamedTuple

import numpy as np

from geometry.arrays import FloatArray
from geometry.catalogue import Sensor
from geometry.errors import InputError, check_one_of
from geometry.lidar import LidarModel
from geometry.poses import Pose, to_world
from geometry.scene import Scene
from geometry.sensors import CameraModel, project_points
from geometry.terrain import on_ground
from geometry.weather import Weather, pick_weather
from scenarios.runs import Run

from ..compute import Compute
from ..detectors.evidence import Crop, Image
from ..imaging import Backdrop, PointCloud, build_backdrop, draw_picture
from ..imaging.mesh import (
    FrameMesh,
    build_frame_mesh,
    build_static_mesh,
    place_mesh,
    scan_mesh,
    vut_pose,
)
from ..imaging.picture import RenderedPicture, Window
from ..imaging.stills import draw_crop, meter, window_around
from ..layout import Layout
from .picture_sources import PictureOfFrame
from .surroundings import (
    FrameCamera,
    VutCamera,
    load_vut_camera,
    load_vut_lidar,
    obstruction_key,
    vut_pitch_deg,
)

_CROP_SIDES_PX = (64, 96, 128, 160)
# share of a crop that a road user may take up; for larger ones the scale is less
_ROOM = 0.625
# How far blur and glare reach beyond a body.
_HALO_PX = 4.0


class RenderedPictures:
    """Draws a frame when it is asked for.

    What stands still is prepared once per obstruction.

    Parameters
    ----------
    scene : Scene
        The scene.
    runs : sequence of Run
        Their frames, end to end, are asked for by number.
    seed : int
        Of sensor noise and drops.
    workers : int
        Threads of each picture: one where several are drawn side by side.

    Attributes
    ----------
    n_drawn : int
        Pictures so far, and crops, those included that look like an earlier one.
    """

    def __init__(
        self, scene: Scene, runs: Sequence[Run], *, seed: int, workers: int = 1
    ) -> None:
        self._scene = scene
        self._runs = runs
        self._compute = Compute(seed=seed, workers=workers)
        self._start = np.concatenate(
            [[0], np.cumsum([len(run.time_s) for run in runs])]
        )
        self._still: dict[tuple[object, ...], tuple[Backdrop, FrameMesh]] = {}
        self._whites: dict[tuple[object, ...], float] = {}
        self._lock = Lock()
        self._is_closed = False
        self.n_drawn = 0

    def close(self) -> None:
        """Draw no more: whoever asks for another picture is stopped."""
        self._is_closed = True

    def pictures(self, camera: FrameCamera) -> PictureOfFrame:
        """Function from a frame of all runs, end to end, to a camera's image."""

        def picture(frame: int) -> Image:
            pose, model = _placed(camera, *self._find(frame))
            return self._draw(
                frame, pose, model, with_vut=not isinstance(camera, VutCamera)
            )

        return picture

    def crops(self, camera: FrameCamera, boxes_px: FloatArray) -> "RenderedCrops":
        """Crops of a camera's pictures around the road user's boxes (n, 4)."""
        return RenderedCrops(self, camera, boxes_px)

    def _find(self, frame: int) -> tuple[Run, int]:
        """Run of a frame, and its index in the run."""
        run_index = int(np.searchsorted(self._start, frame, side="right")) - 1
        return self._runs[run_index], frame - int(self._start[run_index])

    def _draw(
        self, frame: int, pose: Pose, camera: CameraModel, *, with_vut: bool
    ) -> Image:
        """Draw a whole picture of a frame, (h, w, 3)."""
        run, index = self._find(frame)
        picture = draw_picture(
            self._standing(run)[0],
            run,
            index,
            pose,
            camera,
            weather=pick_weather(run.weather, "run: weather"),
            with_vut=with_vut,
            compute=self._compute,
        )
        self._count()
        return picture.rgb

    def _draw_crop(self, frame: int, view: "_CropView") -> Crop:
        """Draw a crop of a frame at its own scale."""
        run, index = self._find(frame)
        small = view.small
        window = view.window
        white = None
        if view.is_fixed:
            white = self._white(run, view)
        picture = draw_crop(
            *self._standing(run),
            run,
            index,
            view.pose,
            small,
            window,
            weather=pick_weather(run.weather, "run: weather"),
            with_vut=view.shows_vut,
            white_cd_m2=white,
            seed=self._compute.seed,
        )
        return Crop(
            pixels=picture.rgb,
            left_px=window.left - 0.5 * small.width_px,
            top_px=window.top - 0.5 * small.height_px,
            scale=view.camera.width_px / small.width_px,
            middle_px=(0.5 * view.camera.width_px, 0.5 * view.camera.height_px),
        )

    def _white(self, run: Run, view: "_CropView") -> float | None:
        """Exposure of a fixed camera by daylight, when what moves changes little.

        None where lamps are on.
        """
        weather = pick_weather(run.weather, "run: weather")
        if weather.has_lamps:
            return None
        pose = view.pose
        key = (
            pose.position_m.tobytes(),
            pose.yaw_deg,
            pose.pitch_deg,
            view.camera,
            weather,
            obstruction_key(run),
        )
        if key not in self._whites:
            self._whites[key] = meter(*self._standing(run), pose, view.camera, weather)
        return self._whites[key]

    def _count(self) -> None:
        """Count one more picture; several threads draw."""
        with self._lock:
            self.n_drawn += 1

    def _standing(self, run: Run) -> tuple[Backdrop, FrameMesh]:
        """What stands still in a run, to be drawn and ready for rays.

        Raises
        ------
        CancelledError
            The source is closed.
        """
        if self._is_closed:
            raise CancelledError
        key = obstruction_key(run)
        with self._lock:
            if key not in self._still:
                backdrop = build_backdrop(self._scene, run.obstruction)
                self._still[key] = backdrop, place_mesh(backdrop.mesh, np.zeros(3))
            return self._still[key]


class _CropView(NamedTuple):
    """How a frame is shown.

    Attributes
    ----------
    pose : Pose
        Of the camera.
    camera : CameraModel
        The camera.
    box_px : (4,) float
        Of the whole road user in the whole image. [px]
    side_px : int
        Of the crop. [px]
    scale : int
        Pixels of the whole image per pixel of the crop.
    shows_vut : bool
        The VUT may change the crop.
    is_fixed : bool
        The camera is not the VUT's own.
    """

    pose: Pose
    camera: CameraModel
    box_px: FloatArray
    side_px: int
    scale: int
    shows_vut: bool
    is_fixed: bool

    @property
    def small(self) -> CameraModel:
        """The camera at the crop's resolution."""
        sides = self.camera.width_px, self.camera.height_px
        width_px, height_px = (round(side / self.scale) for side in sides)
        return replace(self.camera, width_px=width_px, height_px=height_px)

    @property
    def window(self) -> Window:
        """The crop, in the image of `small`."""
        return window_around(self.box_px / self.scale, self.small, side_px=self.side_px)


class RenderedCrops:
    """Crops of a camera's pictures around the road user.

    See :class:`placement.detectors.evidence.Crops`. A road user that would fill a
    crop is drawn at a half, a third and so on of the camera's resolution. Where the
    VUT, its shadow and its mirror image lie outside a crop by daylight, the VUT is
    left out: then all frames with the same road user look the same.

    Parameters
    ----------
    source : RenderedPictures
        Draws them.
    camera : VutCamera or (Pose, CameraModel)
        The camera.
    boxes_px : (n_frames, 4) float
        Box of the whole road user in each frame. [px]
    """

    def __init__(
        self, source: RenderedPictures, camera: FrameCamera, boxes_px: FloatArray
    ) -> None:
        self._source = source
        self._camera = camera
        self._boxes_px = boxes_px

    def key(self, frame: int) -> tuple[object, ...]:
        """Key of a frame: equal for frames whose crops look the same."""
        self._source._count()
        run, index = self._source._find(frame)
        view = self._view(frame)
        where = (
            run.weather,
            id(run.encounter.vru),
            int(run.vru_shape[index]),
            obstruction_key(run),
            view.side_px,
            view.scale,
            run.vru_position_m[index].tobytes(),
            float(run.vru_yaw_deg[index]),
        )
        if view.shows_vut or run.traffic or isinstance(self._camera, VutCamera):
            return (*where, frame)
        return where

    def draw_all(self, frames: Sequence[int]) -> Iterator[tuple[int, Crop]]:
        """Frames and their crops, drawn one after the other."""
        for frame in frames:
            yield frame, self._source._draw_crop(frame, self._view(frame))

    def _view(self, frame: int) -> _CropView:
        """How a frame is shown: side and scale of the crop, and if the VUT is in it."""
        run, index = self._source._find(frame)
        pose, camera = _placed(self._camera, run, index)
        # The smallest crop with room for the road user, at a scale at which one has.
        box_px = self._boxes_px[frame]
        size_px = float((box_px[2:] - box_px[:2]).max())
        scale = max(1, int(np.ceil(size_px / (_ROOM * _CROP_SIDES_PX[-1]))))
        side_px = next(
            (side for side in _CROP_SIDES_PX if size_px / scale <= _ROOM * side),
            _CROP_SIDES_PX[-1],
        )
        is_fixed = not isinstance(self._camera, VutCamera)
        shows_vut = is_fixed and _may_show_vut(
            run, index, pose, camera, box_px, 0.5 * side_px * scale
        )
        return _CropView(pose, camera, box_px, side_px, scale, shows_vut, is_fixed)


def _placed(camera: FrameCamera, run: Run, index: int) -> tuple[Pose, CameraModel]:
    """Pose and model of a camera in a frame of a run."""
    if isinstance(camera, VutCamera):
        return vut_camera_pose(camera, run, index), camera.camera
    return camera


def _may_show_vut(
    run: Run,
    index: int,
    pose: Pose,
    camera: CameraModel,
    box_px: FloatArray,
    reach_px: float,
) -> bool:
    """True if the VUT may change a crop.

    Pixels that its body, its shadow on level ground and its mirror image in wet
    ground can cover lie inside the bounding box of their corners.

    Parameters
    ----------
    run, index : Run, int
        The frame.
    pose, camera : Pose, CameraModel
        The camera.
    box_px : (4,) float
        Of the road user. [px]
    reach_px : float
        How far the crop reaches from the middle of the box. [px]
    """
    weather = pick_weather(run.weather, "run: weather")
    if weather.has_lamps or run.terrain is not None:
        return True
    corners = _cast_corners(run, index, weather)
    points = project_points(corners, pose, camera)[:, :2]
    if not np.isfinite(points).all():
        return not np.isnan(points).all()
    # At the image's edge a crop is moved inwards.
    reach = reach_px + _HALO_PX
    size = np.array([camera.width_px, camera.height_px])
    middle = 0.5 * (box_px[:2] + box_px[2:])
    middle = np.clip(middle, reach_px, np.maximum(size - reach_px, 0.0))
    is_before_end = (points.min(axis=0) < middle + reach).all()
    is_after_begin = (points.max(axis=0) > middle - reach).all()
    return bool(is_after_begin and is_before_end)


def _cast_corners(run: Run, index: int, weather: Weather) -> FloatArray:
    """Corners of the VUT, of its shadow and of its mirror image, (n, 3).

    The shadow lies on level ground, the mirror image below the road; each only
    where the weather shows it.
    """
    vut = run.encounter.vut
    half = np.array([0.5 * vut.length_m, 0.5 * vut.width_m])
    signs = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    flat = np.concatenate([signs * half, np.zeros((4, 1))], axis=1)
    top = flat + [0.0, 0.0, vut.height_m]
    body = to_world(np.concatenate([flat, top]), vut_pose(run, index))
    corners = [body]
    if weather.wetness > 0.0:
        corners.append(body * [1.0, 1.0, -1.0])
    if weather.sun_lux > 0.0 and weather.sun_elevation_deg > 0.0:
        yaw, elevation = np.radians([weather.sun_yaw_deg, weather.sun_elevation_deg])
        away = body[:, 2:] / np.tan(elevation) * np.array([np.cos(yaw), np.sin(yaw)])
        corners.append(np.concatenate([body[:, :2] - away, np.zeros((8, 1))], axis=1))
    return np.concatenate(corners)


def vut_camera_pose(mount: VutCamera, run: Run, frame_index: int) -> Pose:
    """Pose of the VUT's camera in a frame of a run, world frame."""
    on_vut = mount.pose_on(run.encounter.vut)
    yaw_deg = float(run.vut_yaw_deg[frame_index])
    position_m = on_ground(run.vut_position_m[frame_index], run.terrain)
    pitch_deg = vut_pitch_deg(
        run.encounter.vut, run.vut_position_m[frame_index], yaw_deg, run.terrain
    )
    vut = Pose(position_m=position_m, yaw_deg=yaw_deg, pitch_deg=float(pitch_deg))
    return Pose(
        position_m=to_world(on_vut.position_m[None], vut)[0],
        yaw_deg=yaw_deg + on_vut.yaw_deg,
        pitch_deg=vut.pitch_deg + on_vut.pitch_deg,
    )


# ---------- a frame of a run as one unit sees it
VUT_UNIT = "VUT"
VUT_LIDAR_UNIT = "VUT-LIDAR"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Viewpoint:
    """Where a frame is seen from.

    Attributes
    ----------
    pose : Pose
        Of the sensor, world frame.
    sensor : CameraModel or LidarModel
        What looks.
    with_vut : bool
        The VUT is there to be seen; its own sensors do not see it.
    """

    pose: Pose
    sensor: Sensor
    with_vut: bool


def find_frame(run: Run, frame: int) -> int:
    """Index of a frame from the start; negative numbers count from the end.

    Raises
    ------
    InputError
        The run has no such frame.
    """
    n_frames = len(run.time_s)
    if not -n_frames <= frame < n_frames:
        raise InputError(
            "frame",
            frame,
            f"0 to {n_frames - 1}, or -{n_frames} to -1 from the end of {run.id}",
        )
    return frame % n_frames


def find_viewpoint(
    layout: Layout, unit_id: str, run: Run, frame_index: int
) -> Viewpoint:
    """Pose and sensor of a unit in a frame.

    Parameters
    ----------
    layout : Layout
        The units.
    unit_id : str
        One of them, or "VUT" for its camera, "VUT-LIDAR" for its LiDAR.
    run : Run
        What drives.
    frame_index : int
        When.

    Returns
    -------
    viewpoint : Viewpoint
        Pose and sensor.

    Raises
    ------
    InputError
        There is no such unit.
    """
    mount = load_vut_camera()
    own: dict[str, Sensor] = {VUT_UNIT: mount.camera, VUT_LIDAR_UNIT: load_vut_lidar()}
    if unit_id.upper() in own:
        pose = vut_camera_pose(mount, run, frame_index)
        return Viewpoint(pose=pose, sensor=own[unit_id.upper()], with_vut=False)
    units = {unit.id: unit for unit in layout.units}
    check_one_of("unit_id", unit_id, [*units, *own])
    return Viewpoint(
        pose=units[unit_id].pose, sensor=units[unit_id].sensor, with_vut=True
    )


def render(
    scene: Scene, run: Run, frame_index: int, viewpoint: Viewpoint, *, compute: Compute
) -> RenderedPicture | PointCloud:
    """Picture or point cloud of a frame, in the run's weather."""
    weather = pick_weather(run.weather, "weather")
    pose = viewpoint.pose
    sensor = viewpoint.sensor
    # Without the VUT its headlights still shine.
    with_vut = viewpoint.with_vut
    if isinstance(sensor, LidarModel):
        static = build_static_mesh(scene, run.obstruction)
        mesh = build_frame_mesh(
            static, run, frame_index, pose.position_m, with_vut=with_vut
        )
        return scan_mesh(mesh, run, pose, sensor, weather=weather, seed=compute.seed)
    return draw_picture(
        build_backdrop(scene, run.obstruction),
        run,
        frame_index,
        pose,
        sensor,
        weather=weather,
        with_vut=with_vut,
        compute=compute,
    )
