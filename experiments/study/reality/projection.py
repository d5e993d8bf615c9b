"""Boxes of real people against those predicted by camera and body."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from geometry.actors import pick_actor
from geometry.arrays import FloatArray, IntArray
from geometry.calibrations import (
    CalibratedCamera,
    ground_points,
    project_distorted,
    read_kitti_camera,
    read_opencv_camera,
    read_tsai,
)
from geometry.image_boxes import box_height_px
from geometry.poses import Pose, body_rotation
from geometry.sensors import CameraModel, project_points
from placement.detectors.evidence import Interval
from placement.recordings.formats import RecordedBoxes, read_boxes, read_wildtrack

BODY = "adult"
# Before and after, over which a heading is measured.
WALKED_FRAMES = 4
TILTS_DEG = np.linspace(-2.0, 2.0, 41)
_DRAWS = 400
# A box that comes nearer to the picture's edge may be cut off.
_INSIDE_PX = 2.0
KITTI_SIZE_PX = (1242, 375)
_WILDTRACK_SIZE = (1920, 1080)
_WILDTRACK_VIEWS = (
    "CVLab1",
    "CVLab2",
    "CVLab3",
    "CVLab4",
    "IDIAP1",
    "IDIAP2",
    "IDIAP3",
)


@cache
def _hulls() -> tuple[FloatArray, ...]:
    """Corners of the body's convex hull in each phase of its gait.

    They make its box.
    """
    from scipy.spatial import ConvexHull

    shapes = (shape.vertices_m for shape in pick_actor(BODY, "body").shapes)
    return tuple(vertices[ConvexHull(vertices).vertices] for vertices in shapes)


Projection = Callable[[FloatArray], FloatArray]


def body_boxes(
    foot_m: FloatArray, heading_deg: FloatArray, phase: IntArray, project: Projection
) -> FloatArray:
    """Boxes (n, 4) around bodies that stand at `foot_m` (n, 3), in pixels.

    Not clipped.
    """
    boxes = np.empty((len(foot_m), 4))
    hulls = _hulls()
    # Bodies in the same phase of their gait have the same hull.
    for number, hull in enumerate(hulls):
        rows = np.flatnonzero(phase % len(hulls) == number)
        points = np.einsum("nij,kj->nki", body_rotation(heading_deg[rows]), hull)
        points += foot_m[rows, None]
        pixels = project(points.reshape(-1, 3))[:, :2].reshape(len(rows), len(hull), 2)
        boxes[rows, :2] = pixels.min(axis=1)
        boxes[rows, 2:] = pixels.max(axis=1)
    return boxes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Heights:
    """Drawn over predicted heights of a recording's boxes."""

    # (n,): on the ground.
    distance_m: FloatArray
    track: IntArray
    # (n,): by the calibrated camera.
    ratio: FloatArray
    # (n,): by this project's pinhole at the same pose.
    pinhole_ratio: FloatArray
    # That fits best, relative to the calibration.
    tilt_deg: Interval
    # Height of the camera.
    seen_from_m: float


def measure_pets_heights(folder: Path) -> Heights:
    """Drawn over predicted heights of PETS' boxes.

    Of those that lie wholly in the picture.
    """
    drawn, camera = pets_tracks(folder)
    height = camera.height_px
    width = camera.width_px
    # A box at the picture's edge may be cut off, and is no whole body then.
    box = drawn.box_px
    whole = (box[:, :2] > _INSIDE_PX).all(axis=1) & (box[:, 2] < width - _INSIDE_PX)
    drawn = drawn.take(whole & (box[:, 3] < height - _INSIDE_PX))
    heading, phase = _gait(drawn, camera)
    foot, ratio = _ratios(drawn, camera, heading, phase)
    pinhole, pose = nearest_pinhole(camera)
    boxes = body_boxes(
        foot, heading, phase, lambda points: project_points(points, pose, pinhole)
    )
    drawn_px = box_height_px(drawn.box_px)
    offset = foot[:, :2] - camera.position_m[:2]
    return Heights(
        distance_m=np.hypot(*offset.T),
        track=drawn.track,
        ratio=ratio,
        pinhole_ratio=drawn_px / box_height_px(boxes),
        tilt_deg=_best_tilt(drawn, camera, heading, phase),
        seen_from_m=float(camera.position_m[2]),
    )


def pets_tracks(folder: Path) -> tuple[RecordedBoxes, CalibratedCamera]:
    """Annotated people of PETS S2L1 and the camera of view 1."""
    data = folder / "OpenTraj" / "datasets" / "PETS-2009" / "data"
    return (
        read_boxes(data / "annotations" / "PETS2009-S2L1.xml"),
        read_tsai(data / "calibration" / "View_001.xml"),
    )


def bottoms(boxes_px: FloatArray) -> FloatArray:
    """Middles of the lower sides of boxes, (n, 2)."""
    return np.column_stack([0.5 * (boxes_px[:, 0] + boxes_px[:, 2]), boxes_px[:, 3]])


def _gait(
    drawn: RecordedBoxes, camera: CalibratedCamera
) -> tuple[FloatArray, IntArray]:
    """Heading of each box's body, and the phase of its gait.

    By its way over some frames.
    """
    ground = ground_points(bottoms(drawn.box_px), camera)[:, :2]
    heading = np.zeros(len(drawn))
    walked = np.zeros(len(drawn))
    for track in np.unique(drawn.track).tolist():
        rows = np.flatnonzero(drawn.track == track)
        rows = rows[np.argsort(drawn.frame[rows])]
        # From some frames before to some after: single boxes tremble.
        index = np.arange(len(rows))
        after = np.minimum(index + WALKED_FRAMES, len(rows) - 1)
        before = np.maximum(index - WALKED_FRAMES, 0)
        way = ground[rows[after]] - ground[rows[before]]
        heading[rows] = np.degrees(np.arctan2(way[:, 1], way[:, 0]))
        # The phase of the gait follows from the way walked since the track's begin.
        walked[rows] = np.cumsum(np.hypot(*way.T) / np.maximum(after - before, 1))
    return heading, pick_actor(BODY, "body").shape_index(walked)


def _ratios(
    drawn: RecordedBoxes, camera: CalibratedCamera, heading: FloatArray, phase: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Feet (n, 3) of bodies, and ratios of heights.

    The bodies' boxes end where the drawn ones do.
    """
    # A box ends below the middle of the body's footprint: two corrections are enough.
    wanted = ground_points(bottoms(drawn.box_px), camera)
    foot = wanted.copy()
    for _ in range(2):
        boxes = body_boxes(foot, heading, phase, lambda p: project_distorted(p, camera))
        foot += wanted - ground_points(bottoms(boxes), camera)
    boxes = body_boxes(foot, heading, phase, lambda p: project_distorted(p, camera))
    return foot, box_height_px(drawn.box_px) / box_height_px(boxes)


def _best_tilt(
    drawn: RecordedBoxes, camera: CalibratedCamera, heading: FloatArray, phase: IntArray
) -> Interval:
    """Tilt at which heights of bodies at the drawn feet agree best.

    Positive: down.

    The height of all is free: least squares of the logarithms of drawn over predicted
    heights around their mean. 95 % by tracks drawn with repetition.
    """
    # Sums of powers by track: a draw of tracks is a weighted sum of them.
    _, which = np.unique(drawn.track, return_inverse=True)
    moments = []
    for tilt in TILTS_DEG:
        log = np.log(_ratios(drawn, tilted(camera, float(tilt)), heading, phase)[1])
        moments.append([np.bincount(which, weights=log**power) for power in (0, 1, 2)])
    # (n_tilts, 3, n_tracks).
    sums = np.array(moments)
    n_tracks = sums.shape[2]
    rng = np.random.default_rng(0)
    counts = rng.multinomial(n_tracks, np.full(n_tracks, 1.0 / n_tracks), size=_DRAWS)

    def best(weight: FloatArray) -> float:
        n, first, second = np.moveaxis(sums @ weight, 1, 0)
        return float(TILTS_DEG[np.argmin(second / n - (first / n) ** 2)])

    low, high = np.quantile([best(row) for row in counts.astype(float)], [0.025, 0.975])
    return Interval(best(np.ones(n_tracks)), float(low), float(high))


def tilted(camera: CalibratedCamera, tilt_deg: float) -> CalibratedCamera:
    """The camera turned down about its own x axis."""
    c = np.cos(np.radians(tilt_deg))
    s = np.sin(np.radians(tilt_deg))
    down = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return replace(camera, R_camera_world=down @ camera.R_camera_world)


def nearest_pinhole(camera: CalibratedCamera) -> tuple[CameraModel, Pose]:
    """Ideal camera that looks where the middle of a real picture is.

    Square pixels as wide as the real ones, no distortion, no roll.
    """
    middle = np.array([[0.5 * camera.width_px, 0.5 * camera.height_px]])
    ahead = ground_points(middle, camera)[0] - camera.position_m
    half = 0.5 * camera.width_px / camera.fx_px
    pinhole = CameraModel(
        name="pinhole",
        width_px=camera.width_px,
        height_px=camera.height_px,
        horizontal_fov_deg=float(np.degrees(2.0 * np.arctan(half))),
        frame_rate_hz=10.0,
        near_m=0.5,
        price_eur=0.0,
    )
    pose = Pose(
        position_m=camera.position_m,
        yaw_deg=float(np.degrees(np.arctan2(ahead[1], ahead[0]))),
        pitch_deg=float(np.degrees(np.arctan2(ahead[2], np.hypot(ahead[0], ahead[1])))),
    )
    return pinhole, pose


# The camera frame (x right, y down, z ahead) of a body that stands upright and looks to
# the right.
_R_CAMERA_BODY = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def measure_kitti_heights(folder: Path, sequences: tuple[int, ...]) -> FloatArray:
    """Labelled over predicted heights (n,) of pedestrians.

    Of those that no edge of the picture cuts off.
    """
    data = folder / "OpenTraj" / "datasets" / "KITTI" / "data"
    width, height = KITTI_SIZE_PX
    ratios = []
    for number in sequences:
        labels = read_boxes(data / "label" / f"{number:04d}.txt")
        camera = read_kitti_camera(data / "calib" / f"{number:04d}.txt", KITTI_SIZE_PX)
        box = labels.box_px
        whole = (box[:, :2] > _INSIDE_PX).all(axis=1) & (box[:, 2] < width - 20.0)
        labels = labels.take(
            labels.is_class("pedestrian") & whole & (box[:, 3] < height - 20.0)
        )
        if not len(labels):
            continue
        hull = _hulls()[0] @ _R_CAMERA_BODY.T
        points = labels.position_m[:, None] + hull
        rows = project_distorted(points.reshape(-1, 3), camera)[:, 1].reshape(
            len(labels), -1
        )
        ratios.append(box_height_px(labels.box_px) / np.ptp(rows, axis=1))
    return np.concatenate(ratios)


@dataclass(frozen=True, slots=True)
class ViewFlags:
    """Share of people whose being in a view is predicted as it is annotated."""

    view: str
    people: int
    # Share, as annotated.
    in_view: float
    # With the lens as calibrated.
    agreed: float
    # Without its distortion.
    agreed_pinhole: float


def measure_flags(folder: Path) -> tuple[ViewFlags, ...]:
    """Flags of WILDTRACK's views against this.

    The body's middle is in the picture.
    """
    data = folder / "OpenTraj" / "datasets" / "Wild-Track"
    views = read_wildtrack(data / "annotations_positions")
    middle = np.array([0.0, 0.0, 0.5 * pick_actor(BODY, "body").height_m])
    rows = []
    for name, boxes in zip(_WILDTRACK_VIEWS, views, strict=True):
        is_flagged = boxes.box_px[:, 2] > boxes.box_px[:, 0]
        agreed = []
        for kind in ("original", "zero"):
            camera = read_opencv_camera(
                data / "calibrations" / f"intrinsic_{kind}" / f"intr_{name}.xml",
                data / "calibrations" / "extrinsic" / f"extr_{name}.xml",
                _WILDTRACK_SIZE,
            )
            x, y = project_distorted(boxes.position_m + middle, camera)[:, :2].T
            # What is no number is not in the picture.
            is_in = (x >= 0) & (x < camera.width_px) & (y >= 0) & (y < camera.height_px)
            agreed.append(float((is_in == is_flagged).mean()))
        rows.append(ViewFlags(name, len(boxes), float(is_flagged.mean()), *agreed))
    return tuple(rows)
