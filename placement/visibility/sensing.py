"""Detections of the sensors at one mount, from the points that rays reach."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.catalogue import Sensor
from geometry.image_boxes import box_height_px
from geometry.lidar import (
    LidarModel,
    beams_per_steradian,
    load_lidar_detection,
    return_probability,
)
from geometry.poses import body_rotation, camera_rotation
from geometry.registry import load_entry
from geometry.sensors import CameraModel, sharpest_px_per_rad

from ..candidates import CandidatePose
from ..detectors import VRU_CLASSES, Evidence, PlanningDetector, aspects_deg, vru_class
from .casting import Sight, World, cast_sight

if TYPE_CHECKING:
    from .point_kernels import BodyPoints, Found, Seen

# Points next to or behind the lens are projected far outside the image.
MIN_DEPTH_M = 0.01
# Slack of a cosine, so that nobody at the edge is left out.
_SLACK = 1.0e-6
# Slack of a sphere around a body.
_SLACK_M = 1.0e-3
# How much mounts may be turned from world to world: three times one degree.
_FORESEEN_RAD = 0.06
# Largest half angle of a lens.
_WIDEST_RAD = 1.5
# Pairs of sensors and entries that are looked at together.
_PAIRS = 1 << 21


PROJECTIONS = {
    "pinhole": "placement.visibility.sensing:box_in_pinholes",
    "lens": "placement.visibility.lens_kernels:box_in_lenses",
}
"""Registry of what finds boxes of bodies in pictures, by how cameras project.

Each entry is a :class:`BoxFinder`.
"""


class BoxFinder(Protocol):
    """What finds the boxes of bodies in the pictures of cameras at one mount."""

    def __call__(
        self,
        bodies: "BodyPoints",
        eye_m: FloatArray,
        seen: "Seen",
        units: Sequence[CandidatePose],
        *,
        min_height_px: float,
        found: "Found",
    ) -> tuple[int, int]:
        """Fill `found`; returns how many bodies are whole inside an image, and others.

        `eye_m` (3,) is the mount. Pairs whose visible box is lower than `min_height_px`
        are left out.
        """


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensing:
    """One mount position and all that is seen from it, for any sensor there.

    Attributes
    ----------
    world : World
        What is looked at.
    sight : Sight
        Which points the rays reach. Its entries are the n below.
    detector : PlanningDetector
        Detector of the cameras.
    eye_m : (3,) float
        The mount, relative to the origin of `world`. [m]
    middle_m : (n, 3) float
        Mean of the points of each entry, from the mount. [m]
    distance_m : (n,) float
        Length of `middle_m`. [m]
    half_angle_rad : (n,) float
        Angle around its middle within which each body lies. [rad]
    contrast : (n_weathers, n) float
        Contrast of the VRU in each weather.
    vru_class : (n,) int
        Into ``VRU_CLASSES``.
    aspect_deg : (n,) float
        Angle between line of sight and heading. [deg]
    """

    world: World
    sight: Sight
    detector: PlanningDetector
    eye_m: FloatArray
    middle_m: FloatArray
    distance_m: FloatArray
    half_angle_rad: FloatArray
    contrast: FloatArray
    vru_class: IntArray
    aspect_deg: FloatArray

    def detected(self, candidates: Sequence[CandidatePose]) -> BoolArray:
        """Entries that each sensor detects in each weather.

        Parameters
        ----------
        candidates : sequence of CandidatePose
            Sensors at this mount. If one is a LiDAR, the sight must have been cast for
            LiDARs.

        Returns
        -------
        detected : (n_sensors, n_weathers, n) bool
        """
        detected = np.zeros((len(candidates), *self.contrast.shape), dtype=bool)
        # Rows of each model of LiDARs.
        lidars: dict[LidarModel, list[int]] = {}
        for row, candidate in enumerate(candidates):
            if isinstance(candidate.sensor, LidarModel):
                lidars.setdefault(candidate.sensor, []).append(row)
        for lidar, rows in lidars.items():
            of_model = [candidates[row] for row in rows]
            detected[rows] = _detect_echoes(self, lidar, of_model)
        least_px = self._least_height_px()
        for boxes in self._boxes(candidates):
            # Whole bodies inside the image are detected from some height on; the
            # detector is asked about all others.
            high_px = box_height_px(boxes.plain_px)
            plain, entry = boxes.plain.T
            part, evidence = _evidence(self, boxes, is_plain=False)
            for weather, contrast in enumerate(self.contrast):
                is_high = high_px >= least_px[weather, entry]
                detected[plain[is_high], weather, entry[is_high]] = True
                seen = replace(evidence, contrast=contrast[evidence.draw_index])
                is_expected = self.detector.is_expected(seen)
                detected[
                    part[is_expected], weather, evidence.draw_index[is_expected]
                ] = True
        return detected

    def packed(self, candidates: Sequence[CandidatePose]) -> NDArray[np.uint8]:
        """Frames in which each sensor detects a VRU, as bits.

        Returns
        -------
        packed : (n_sensors, ceil(n_frames / 8)) uint8
            Frames of the frame axis, the first one in the lowest bit.
        """
        # One entry more, of which nothing is seen: that of frames whose entry is -1.
        detected = np.pad(self.detected(candidates), ((0, 0), (0, 0), (0, 1)))
        n_entries = detected.shape[2]
        entry_of_frame = self.sight.entry_of_frame % n_entries
        column = n_entries * self.world.views.weather_of_frame + entry_of_frame
        # Weathers side by side: numpy takes columns faster than pairs of indices.
        frames = detected.reshape(len(detected), -1).take(column, axis=1)
        return np.packbits(frames, axis=1, bitorder="little")

    def evidence(
        self, candidates: Sequence[CandidatePose]
    ) -> Iterator[tuple[IntArray, Evidence]]:
        """Evidence of all cameras that see enough of an entry, at full contrast.

        Enough is a box as high as the detector asks for. LiDARs are left out.

        Yields
        ------
        rows : (m,) int
            Index of each row's candidate.
        evidence : Evidence
            Its `draw_index` is the entry.
        """
        for boxes in self._boxes(candidates):
            for is_plain in (True, False):
                yield _evidence(self, boxes, is_plain=is_plain)

    def _boxes(self, candidates: Sequence[CandidatePose]) -> Iterator["_Boxes"]:
        """Boxes in the cameras among the candidates, some of these at a time.

        Pinholes come first, then lenses that distort: each has its own kernels.
        """
        cameras = [
            i for i, c in enumerate(candidates) if not isinstance(c.sensor, LidarModel)
        ]
        step = max(1, _PAIRS // max(1, len(self.distance_m)))
        for through_lenses in (False, True):
            rows = [
                row for row in cameras if _has_lens(candidates[row]) == through_lenses
            ]
            for first in range(0, len(rows), step):
                some = np.array(rows[first : first + step])
                yield _box(self, candidates, some, through_lenses)

    def _least_height_px(self) -> FloatArray:
        """Height from which on an entry's box is detected if nothing hides it.

        Returns
        -------
        least_px : (n_weathers, n) float
            [px]
        """
        nothing = np.empty((len(self.distance_m), 0))
        whole = Evidence(
            visible_px=nothing,
            amodal_px=nothing,
            aspect_deg=self.aspect_deg,
            vru_class=self.vru_class,
            draw_index=np.arange(len(self.distance_m)),
        )
        least_px = []
        for contrast in self.contrast:
            in_weather = replace(whole, contrast=contrast)
            least_px.append(self.detector.least_height_px(in_weather))
        return np.stack(least_px)


def _in_cone(
    candidate: CandidatePose,
    middle_m: FloatArray,
    distance_m: FloatArray,
    spread_rad: FloatArray,
) -> BoolArray:
    """Mask of bodies of which a part may be in a sensor's field of view.

    Parameters
    ----------
    candidate : CandidatePose
        The sensor; its field of view counts as a cone around its axis.
    middle_m : (n, 3) float
        Middle of each body, from the mount. [m]
    distance_m : (n,) float
        Length of `middle_m`. [m]
    spread_rad : (n,) float
        Angle around its middle within which each body lies. [rad]

    Returns
    -------
    is_in : (n,) bool
    """
    ahead = body_rotation(candidate.pose.yaw_deg, candidate.pose.pitch_deg)[:, 0]
    half_rad = np.radians(0.5 * candidate.sensor.diagonal_fov_deg) + spread_rad
    along = middle_m @ ahead + _SLACK * distance_m
    is_in: BoolArray = along >= np.cos(np.minimum(half_rad, np.pi)) * distance_m
    return is_in


def build_sensing(
    world: World, sight: Sight, position_m: FloatArray, detector: PlanningDetector
) -> Sensing:
    """Compute all that does not depend on where a sensor at a mount looks.

    Parameters
    ----------
    world : World
        What is looked at.
    sight : Sight
        What rays from this mount reach; see :func:`cast_for`.
    position_m : (3,) float
        The mount, world frame. [m]
    detector : PlanningDetector
        Detector of the cameras.
    """
    views = world.views
    eye = np.asarray(position_m, dtype=np.float64) - world.origin_m
    middle = views.middle_m[sight.view_index] - eye
    distance = np.linalg.norm(middle, axis=1)
    radius = views.radius_m[sight.view_index]
    classes = np.array([VRU_CLASSES.index(vru_class(s.actor)) for s in world.surfaces])
    half_angle_sin = np.minimum(1.0, radius / np.maximum(distance, 1e-6))
    contrast = [w.contrast * w.transmission(distance) for w in views.weathers]
    return Sensing(
        world=world,
        sight=sight,
        detector=detector,
        eye_m=eye,
        middle_m=middle,
        distance_m=distance,
        half_angle_rad=np.arcsin(half_angle_sin),
        contrast=np.stack(contrast),
        vru_class=classes[views.surface_index[sight.view_index]],
        aspect_deg=aspects_deg(middle[:, :2], views.yaw_deg[sight.view_index]),
    )


def cast_for(
    world: World,
    position_m: FloatArray,
    looks: Sequence[tuple[CandidatePose, PlanningDetector]],
) -> Sight:
    """Sight of all that any sensor at one mount may detect.

    Parameters
    ----------
    world : World
        What rays are cast against.
    position_m : (3,) float
        The mount, world frame. [m]
    looks : sequence of (CandidatePose, PlanningDetector)
        Sensors at the mount, each with its detector; all have the same near limit.

    Returns
    -------
    sight : Sight
        Cast for LiDARs if one is among the sensors.
    """
    sensors = [candidate.sensor for candidate, _ in looks]
    is_asked = _may_detect(world, position_m, looks)
    # Where hidden points are cached, the next world may turn the mount a little.
    is_foreseen = None
    if world.shared.hidden_by_scene is not None:
        is_foreseen = _may_detect(world, position_m, looks, turned_rad=_FORESEEN_RAD)
    return cast_sight(
        world,
        position_m,
        near_m=sensors[0].near_m,
        is_asked=is_asked,
        is_foreseen=is_foreseen,
        for_lidar=any(isinstance(sensor, LidarModel) for sensor in sensors),
    )


def _may_detect(
    world: World,
    position_m: FloatArray,
    looks: Sequence[tuple[CandidatePose, PlanningDetector]],
    *,
    turned_rad: float = 0.0,
) -> BoolArray:
    """Mask of views that sensors at one mount may detect.

    Parameters
    ----------
    world, position_m, looks
        As in :func:`cast_for`.
    turned_rad : float
        The sensors may be turned by so much either way. [rad]

    Returns
    -------
    may_detect : (n_views,) bool
    """
    views = world.views
    eye = np.asarray(position_m, dtype=np.float64) - world.origin_m
    may_detect = np.zeros(len(views.yaw_deg), dtype=bool)
    least_px: dict[float, list[CandidatePose]] = {}
    for candidate, detector in looks:
        if isinstance(candidate.sensor, LidarModel):
            across = np.hypot(*(views.position_m - eye[:2]).T)
            distance = np.hypot(across, eye[2] - views.up_m)
            may_detect |= distance <= 2.0 * world.radius_m + candidate.sensor.range_m
        else:
            least_px.setdefault(detector.min_box_height_px, []).append(candidate)
    for height_px, listed in least_px.items():
        from .point_kernels import Cameras, find_views

        candidates = [candidate for candidate in listed if not _has_lens(candidate)]
        for candidate in filter(_has_lens, listed):
            may_detect |= _may_show(world, eye, candidate, height_px, turned_rad)
        if not candidates:
            continue
        find_views(
            views.middle_m,
            views.radius_m,
            eye.astype(np.float32),
            Cameras(_lenses(candidates, turned_rad=turned_rad), len(candidates)),
            height_px
            # Boxes are a little larger farther from the axis.
            * (1.0 - turned_rad),
            may_detect,
        )
    return may_detect


def _may_show(
    world: World,
    eye: FloatArray,
    candidate: CandidatePose,
    height_px: float,
    turned_rad: float,
) -> BoolArray:
    """Mask of views whose body may be high enough through a lens.

    Parameters
    ----------
    world : World
        What is looked at.
    eye : (3,) float
        The mount, relative to the origin of `world`. [m]
    candidate : CandidatePose
        A camera.
    height_px : float
        Least height of a box that counts. [px]
    turned_rad : float
        The camera may be turned by so much either way. [rad]

    Returns
    -------
    may_show : (n_views,) bool
    """
    views = world.views
    camera = candidate.sensor
    assert isinstance(camera, CameraModel)
    offsets = views.middle_m - eye
    away = np.linalg.norm(offsets, axis=1)
    radius_m = views.radius_m + _SLACK_M
    spread = np.arcsin(np.minimum(1.0, radius_m / np.maximum(away, 1.0e-6)))
    may_show = _in_cone(candidate, offsets, away, spread + turned_rad)
    most_px = 2.0 * spread * sharpest_px_per_rad(camera)
    may_show &= most_px >= height_px * (1.0 - turned_rad)
    return may_show


def _has_lens(candidate: CandidatePose) -> bool:
    """True if a candidate is a camera whose lens distorts."""
    return isinstance(candidate.sensor, CameraModel) and not candidate.sensor.is_pinhole


def reach_m(sensor: Sensor, detector: PlanningDetector, world: World) -> float:
    """Distance beyond which a sensor detects no VRU.

    Parameters
    ----------
    sensor : CameraModel or LidarModel
        Of a camera, the field of view that reaches farthest counts.
    detector : PlanningDetector
        Detector of cameras.
    world : World
        Gives the extent of the VRUs.

    Returns
    -------
    reach_m : float
        From the mount to the middle of the VRU's footprint; may be infinite. [m]
    """
    # The nearest point is at most this much nearer than the middle.
    extent_m = 2.0 * world.radius_m
    if isinstance(sensor, LidarModel):
        return extent_m + sensor.range_m
    fovs_deg = sensor.fov_range_deg or (sensor.horizontal_fov_deg,)
    cameras = [replace(sensor, horizontal_fov_deg=fov) for fov in fovs_deg]
    farthest_m = [
        max_distance_m(one, detector, vru_height_m=extent_m) for one in cameras
    ]
    if sensor.is_pinhole:
        # Convex in the focal length, so that the maximum is at either end.
        return extent_m + max(farthest_m)
    focal_px = [one.focal_length_px for one in cameras]
    return float(extent_m + max(np.divide(farthest_m, focal_px)) * max(focal_px))


def max_distance_m(
    camera: CameraModel, detector: PlanningDetector, *, vru_height_m: float
) -> float:
    """Distance beyond which no VRU is high enough in the image.

    Parameters
    ----------
    camera : CameraModel
        With or without a lens that distorts.
    detector : PlanningDetector
        Says how high a box must be.
    vru_height_m : float
        Extent of the VRU. [m]

    Returns
    -------
    distance_m : float
        Infinite if the detector takes boxes of any height. [m]

    Notes
    -----
    A body of extent h whose nearest point is at distance d from the lens spans at
    most h / d * f / cos^2(e) pixels, where e is the largest angle off the optical
    axis; through a lens that distorts, h / d times the most pixels that a radian
    takes up.
    """
    if detector.min_box_height_px == 0.0:
        return np.inf
    if not camera.is_pinhole:
        return vru_height_m * sharpest_px_per_rad(camera) / detector.min_box_height_px
    stretch = 1.0 / np.cos(np.radians(0.5 * camera.diagonal_fov_deg)) ** 2
    return float(
        vru_height_m * camera.focal_length_px * stretch / detector.min_box_height_px
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Boxes:
    """Boxes in cameras, as ``point_kernels.box_bodies`` finds them.

    Attributes
    ----------
    plain, part : (n, 2) int
        Index of the camera among the candidates, and the entry: of bodies that are
        whole and inside the image, and of all others.
    plain_px : (n_plain, 4) float
        Boxes of whole bodies inside the image. [px]
    visible_px : (n_part, 4) float
        Boxes of the visible points of other bodies. [px]
    amodal_px : (n_part, 4) float
        Boxes of all of their points. [px]
    inside_share : (n_part,) float
        How much of their boxes is inside the image.
    """

    plain: IntArray
    part: IntArray
    plain_px: FloatArray
    visible_px: FloatArray
    amodal_px: FloatArray
    inside_share: FloatArray


def _box(
    sensing: Sensing,
    candidates: Sequence[CandidatePose],
    rows: IntArray,
    through_lenses: bool,
) -> _Boxes:
    """Boxes of all entries in some cameras, with the kernels for their lenses.

    Parameters
    ----------
    sensing : Sensing
        What is seen from the mount.
    candidates : sequence of CandidatePose
        All candidates at the mount.
    rows : (k,) int
        Those to look at: all cameras, and all with or all without a lens that
        distorts.
    through_lenses : bool
        They have a lens that distorts.
    """
    views = sensing.world.views
    sight = sensing.sight
    chosen = [candidates[row] for row in rows.tolist()]
    from .point_kernels import BodyPoints, Found, Seen

    n = len(chosen) * len(sight.view_index)
    found = Found(
        plain=np.empty((n, 2), np.int32),
        plain_px=np.empty((n, 4), np.float32),
        part=np.empty((n, 2), np.int32),
        part_px=np.empty((n, 8), np.float32),
        inside_share=np.empty(n),
    )
    seen = Seen(sight.view_index, sight.is_visible, sight.is_whole)
    bodies = BodyPoints(views.axes_m, views.hull_m, views.middle_m, views.radius_m)
    if through_lenses:
        projection = "lens"
    else:
        projection = "pinhole"
    box: BoxFinder = load_entry(PROJECTIONS[projection])
    min_height_px = sensing.detector.min_box_height_px
    n_plain, n_part = box(
        bodies, sensing.eye_m, seen, chosen, min_height_px=min_height_px, found=found
    )
    # Copies: what was set aside for the most that there could be is given back.
    return _Boxes(
        plain=_with_rows(found.plain[:n_plain], rows),
        part=_with_rows(found.part[:n_part], rows),
        plain_px=found.plain_px[:n_plain].astype(np.float64),
        visible_px=found.part_px[:n_part, :4].astype(np.float64),
        amodal_px=found.part_px[:n_part, 4:].astype(np.float64),
        inside_share=found.inside_share[:n_part].copy(),
    )


def box_in_pinholes(
    bodies: "BodyPoints",
    eye_m: FloatArray,
    seen: "Seen",
    units: Sequence[CandidatePose],
    *,
    min_height_px: float,
    found: "Found",
) -> tuple[int, int]:
    """Boxes of bodies in cameras without distortion, as a :class:`BoxFinder`."""
    from .point_kernels import Cameras, Least, box_bodies

    pinholes = Cameras(_lenses(units), len(units))
    least = Least(np.float32(MIN_DEPTH_M), min_height_px)
    eye = eye_m.astype(np.float32)
    n_boxes: tuple[int, int] = box_bodies(bodies, eye, seen, pinholes, least, found)
    return n_boxes


def _with_rows(pairs: IntArray, rows: IntArray) -> IntArray:
    """Pairs (n, 2) of a candidate and an entry, from those of a camera and an entry."""
    return np.column_stack([rows[pairs[:, 0]], pairs[:, 1]])


def _lenses(
    candidates: Sequence[CandidatePose], *, turned_rad: float = 0.0
) -> NDArray[np.void]:
    """Pinhole cameras in the form that ``point_kernels.box_bodies`` takes.

    With `turned_rad`, images are as large as needed if each camera may be turned by
    so much either way. [rad]
    """
    from .point_kernels import pack_lenses

    cameras = [c.sensor for c in candidates if isinstance(c.sensor, CameraModel)]
    poses = [candidate.pose for candidate in candidates]
    focal = np.array([camera.focal_length_px for camera in cameras])
    size = np.array(
        [(camera.width_px, camera.height_px) for camera in cameras], dtype=np.float64
    )
    if turned_rad:
        half = np.arctan(0.5 * size / focal[:, None]) + turned_rad
        size = 2.0 * focal[:, None] * np.tan(np.minimum(half, _WIDEST_RAD))
    return pack_lenses(
        camera_rotation([p.yaw_deg for p in poses], [p.pitch_deg for p in poses]),
        focal,
        size,
    )


def _evidence(
    sensing: Sensing, boxes: _Boxes, *, is_plain: bool
) -> tuple[IntArray, Evidence]:
    """Candidates and evidence of one kind of boxes.

    Parameters
    ----------
    sensing : Sensing
        What is seen from the mount.
    boxes : _Boxes
        Boxes in its cameras.
    is_plain : bool
        Take the whole bodies inside the image, not the others.

    Returns
    -------
    rows : (n,) int
        Index of the candidate.
    evidence : Evidence
        Its `draw_index` is the entry.
    """
    if is_plain:
        rows, entries = boxes.plain.T
        visible_px = boxes.plain_px
        amodal_px = boxes.plain_px
        inside_share = np.ones(len(entries))
    else:
        rows, entries = boxes.part.T
        visible_px = boxes.visible_px
        amodal_px = boxes.amodal_px
        inside_share = boxes.inside_share
    evidence = Evidence(
        visible_px=visible_px,
        amodal_px=amodal_px,
        visible_share=sensing.sight.visible_share[entries],
        inside_share=inside_share,
        aspect_deg=sensing.aspect_deg[entries],
        vru_class=sensing.vru_class[entries],
        draw_index=entries,
    )
    return rows, evidence


# ---------- LiDARs
# Slack of a cosine and a sine: limits of a field of view belong to it.
_SLACK_LIMIT = 1.0e-12


def _detect_echoes(
    sensing: Sensing, lidar: LidarModel, candidates: Sequence[CandidatePose]
) -> BoolArray:
    """Entries on which LiDARs of one model have enough points.

    Parameters
    ----------
    sensing : Sensing
        What is seen from the mount.
    lidar : LidarModel
        The model of all candidates.
    candidates : sequence of CandidatePose
        n LiDARs.

    Returns
    -------
    found : (n, n_weathers, n_entries) bool

    Notes
    -----
    Each visible point stands for the part of the surface around it. The solid angle
    of that part, seen from the LiDAR, times the density of beams in its direction is
    the number of beams that hit it.
    """
    from .point_kernels import Echoes, LidarView, count_echoes

    world = sensing.world
    sight = sensing.sight
    vru_class = sensing.vru_class
    views = world.views
    # Visible points, one after the other, from the LiDAR.
    entry, point = np.nonzero(sight.is_visible)
    view = sight.view_index[entry]
    offsets = views.points_m[view, point] - sensing.eye_m
    distance = np.linalg.norm(offsets, axis=-1)
    # The area of each point that faces the LiDAR: minus the part along the ray.
    areas = np.stack([surface.area_m2 for surface in world.surfaces])
    area = areas[views.surface_index[view], point]
    yaw = np.radians(views.yaw_deg[view])
    cos = np.cos(yaw)
    sin = np.sin(yaw)
    facing_m2 = -(
        (area[:, 0] * cos - area[:, 1] * sin) * offsets[:, 0]
        + (area[:, 0] * sin + area[:, 1] * cos) * offsets[:, 1]
        + area[:, 2] * offsets[:, 2]
    ) / np.maximum(distance, 1.0e-12)
    faces = (facing_m2 > 0.0) & (distance <= lidar.range_m) & (distance >= lidar.near_m)
    entry = entry[faces]
    offsets = offsets[faces]
    distance = distance[faces]
    facing_m2 = facing_m2[faces]
    area = area[faces]
    detection = load_lidar_detection()
    classes = vru_class[entry]
    reflectivity = np.array([detection.reflectivity[name] for name in VRU_CLASSES])
    needed = np.array(
        [detection.min_points[name] for name in VRU_CLASSES], dtype=np.float64
    )
    # Beams on each point as dense as on the level, and how many come back.
    beams = facing_m2 / distance**2 * beams_per_steradian(lidar, 0.0)
    cosine = facing_m2 / np.maximum(np.linalg.norm(area, axis=-1), 1.0e-12)
    in_weathers = []
    for weather in views.weathers:
        probability = return_probability(
            lidar,
            distance,
            reflectivity=reflectivity[classes],
            incidence_cos=cosine,
            extinction_per_m=weather.lidar_extinction_per_m(lidar.wavelength_nm),
        )
        in_weathers.append(beams * probability)
    expected = np.stack(in_weathers)
    counts = np.bincount(entry, minlength=len(sight.view_index))
    found = np.zeros((len(candidates), *sensing.contrast.shape), dtype=bool)
    poses = [candidate.pose for candidate in candidates]
    rotations = [body_rotation(pose.yaw_deg, pose.pitch_deg) for pose in poses]
    is_near = [
        _in_cone(one, sensing.middle_m, sensing.distance_m, sensing.half_angle_rad)
        for one in candidates
    ]
    echoes = Echoes(
        first=np.concatenate([[0], np.cumsum(counts)]),
        directions=np.ascontiguousarray(offsets / distance[:, None]),
        expected=np.ascontiguousarray(expected),
        needed=needed[vru_class],
    )
    half_across_rad = math.radians(0.5 * lidar.horizontal_fov_deg)
    half_up_rad = math.radians(0.5 * lidar.vertical_fov_deg)
    limits = LidarView(
        cos_across=math.cos(half_across_rad) - _SLACK_LIMIT,
        sin_up=math.sin(half_up_rad) + _SLACK_LIMIT,
    )
    count_echoes(np.stack(rotations), np.stack(is_near), echoes, limits, found)
    table = sensing.detector.lidar
    if table is not None:
        found &= table.is_expected(np.hypot(*sensing.middle_m[:, :2].T), vru_class)
    return found
