"""Where detectors place people, and whether a car would brake for tracks of nothing."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from geometry.arrays import FloatArray
from geometry.calibrations import CalibratedCamera, ground_points, read_kitti_camera
from geometry.lidar import load_lidars
from placement.detectors.evidence import Interval
from placement.detectors.fitting import (
    LabelledPicture,
    find_alarms_px,
    link_alarms,
    wilson,
)
from placement.positions import GroundErrors, aim_sd_deg, camera_errors, lidar_errors
from placement.recordings.files import read_lines
from placement.recordings.formats import RecordedBoxes, read_boxes
from placement.recordings.pairs import pair_boxes
from placement.sampling.uncertainty import CALIBRATED
from scenarios.aeb import braking_distance_m, load_aeb_rule, standstill_time_s
from scenarios.decision import (
    CarWays,
    DecisionRule,
    load_decision_rule,
    overlap_probability,
    track,
)
from scenarios.runs import FrameAxis

from .projection import KITTI_SIZE_PX, bottoms, pets_tracks
from .response import KITTI_SEQUENCES, N_CONFIRMATIONS, TABLE_HZ, Watched, kitti_found

_BANDS_M = (0.0, 18.0, 22.0, 26.0, 30.0, np.inf)
# A walking adult's height and width.
_BODY_M = (1.8, 0.6)
# KITTI's car: its camera stands so high, within 0.3 m of its middle. [m]
_CAMERA_M = 1.65
_HALF_CAR_M = (2.4, 0.9)
_HALF_BODY_M = (0.25, 0.25)
# KITTI's LiDAR; in the catalogue the one with beams as near to each other.
_LIDAR = "carla-ncap-lidar"
# Fields of OXTS, of which the first nine are read, and the rest are not named.
_CAR = ("lat", "lon", "alt", "roll", "pitch", "yaw", "north", "east", "forward")
_OXTS = (*_CAR, *(f"further {number}" for number in range(21)))
_EARTH_M = 6_378_137.0
# After the end of a recording the car goes on as it was, for so many frames.
_FRAMES_BEYOND = 80


# ---------- errors of places
@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceBand:
    """Errors of detected places at some distance, in m.

    Attributes
    ----------
    words : str
        The distance.
    n : int
        Detections.
    along_m, across_m : float
        Measured standard deviations along and across the line of sight.
    predicted_along_m, predicted_across_m : float
        Those of :func:`placement.positions.camera_errors`, without body and aim.
    """

    words: str
    n: int
    along_m: float
    across_m: float
    predicted_along_m: float
    predicted_across_m: float


def measure_places(folder: Path, watched: Watched) -> list[PlaceBand]:
    """Foot points of PETS' detections against drawn ones, by distance.

    Both are the middle of a box's lower side, on the ground; `watched` is of PETS.
    """
    _, camera = pets_tracks(folder)
    seen = watched.sightings.take(np.flatnonzero(watched.sightings.is_found))
    drawn_px = watched.label_px[watched.sightings.is_found]
    size_px = np.tile(drawn_px[:, 2:] - drawn_px[:, :2], 2)
    found_px = drawn_px + seen.box_error * size_px
    drawn_m = ground_points(bottoms(drawn_px), camera)[:, :2]
    off_m = ground_points(bottoms(found_px), camera)[:, :2] - drawn_m
    feet_m = np.column_stack([drawn_m, np.zeros(len(drawn_m))])
    rule = load_decision_rule()
    predicted = camera_errors(
        camera.position_m,
        feet_m,
        np.tile(_BODY_M, (len(feet_m), 1)),
        rule=rule,
        box_noise_share=rule.box_noise_share,
        aim_sd_deg=(0.0, 0.0),
    )
    # What the body adds is the same in both: its feet are where its box ends.
    along_m, across_m = (
        np.sqrt(np.maximum(one**2 - rule.body_sd_m**2, 0.0))
        for one in (predicted.box_along_m, predicted.box_across_m)
    )
    east, north = predicted.sight.T
    measured_along_m = off_m[:, 0] * east + off_m[:, 1] * north
    measured_across_m = off_m[:, 1] * east - off_m[:, 0] * north
    distance_m = np.hypot(*(drawn_m - camera.position_m[:2]).T)
    bands = []
    for low, high in pairwise(_BANDS_M):
        here = (distance_m >= low) & (distance_m < high)
        if not here.any():
            continue
        words = f"{low:g} to {high:g} m"
        if high == np.inf:
            words = f"{low:g} m and more"
        bands.append(
            PlaceBand(
                words=words,
                n=int(here.sum()),
                along_m=float(measured_along_m[here].std()),
                across_m=float(measured_across_m[here].std()),
                predicted_along_m=float(along_m[here].mean()),
                predicted_across_m=float(across_m[here].mean()),
            )
        )
    return bands


# ---------- tracks of nothing, and the decision to brake
@dataclass(frozen=True, slots=True, kw_only=True)
class FalseBraking:
    """How many confirmed tracks of nothing a car would brake for.

    Attributes
    ----------
    braked, tracks : int
        Tracks that it brakes for by the default rule, and all.
    """

    braked: int
    tracks: int

    @property
    def share(self) -> Interval:
        """Share that the decision lets through, with its 95 % interval."""
        return wilson(self.braked, self.tracks)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ghost:
    """A confirmed track of nothing: frames, places in the world and their errors."""

    frames: FloatArray
    place_m: FloatArray
    covariance_m2: FloatArray


def decide_false_tracks(folder: Path, name: str, class_name: str) -> FalseBraking:
    """Whether KITTI's car would brake for its detector's confirmed tracks of nothing.

    A track of nothing is one of boxes that overlap nobody, for three frames in a row or
    more; boxes of any score count, for the more tracks, the better the share is known.
    The car goes on as it did in the recording. `name` is one of the detectors of
    :func:`experiments.study.reality.response.watch_kitti`.
    """
    rule = load_decision_rule()
    braked = 0
    tracks = 0
    data = folder / "OpenTraj" / "datasets" / "KITTI" / "data"
    for number in KITTI_SEQUENCES:
        given = read_boxes(data / "label" / f"{number:04d}.txt")
        if not (given.is_class(class_name) & (given.track >= 0)).any():
            continue
        found = kitti_found(folder, name, class_name, number)
        car = _read_car(data / "oxts" / f"{number:04d}.txt")
        camera = read_kitti_camera(data / "calib" / f"{number:04d}.txt", KITTI_SIZE_PX)
        pictures = pair_boxes(
            given,
            found,
            classes={class_name: class_name},
            min_score=-np.inf,
            n_frames=len(car),
        ).pictures
        ghosts = []
        for boxes in _false_tracks(pictures):
            ghosts.append(_place(boxes, found, car, camera, rule))
        tracks += len(ghosts)
        braked += sum(_brakes(ghost, car, rule) for ghost in ghosts)
    return FalseBraking(braked=braked, tracks=tracks)


def _false_tracks(
    pictures: Sequence[LabelledPicture],
) -> list[list[tuple[int, FloatArray]]]:
    """Frames and boxes of confirmed tracks of nothing; see FalseAlarms."""
    finished = []
    # Tracks that end in the picture before, in the order of its alarms.
    open_tracks: list[list[tuple[int, FloatArray]]] = []
    before_px = np.zeros((0, 4))
    for frame, picture in enumerate(pictures):
        alarms_px = find_alarms_px(picture)
        links = link_alarms(before_px, alarms_px)
        goes_on = []
        for box_px, old in zip(alarms_px, links, strict=True):
            past = open_tracks[old] if old >= 0 else []
            goes_on.append([*past, (frame, box_px)])
        finished += [one for n, one in enumerate(open_tracks) if n not in links]
        open_tracks = goes_on
        before_px = alarms_px
    finished += open_tracks
    return [one for one in finished if len(one) >= N_CONFIRMATIONS]


def _read_car(path: Path) -> FloatArray:
    """East, north, heading and speed of KITTI's car in each frame, (n, 4).

    [m], [m], [rad], [m/s]; headings count from east.
    """
    lines = read_lines(path, _OXTS, separator=None, least=len(_CAR))
    values = np.array([[line.number(name) for name in _CAR] for line in lines])
    latitude_rad, longitude_rad = np.radians(values[:, :2]).T
    east_m = _EARTH_M * np.cos(latitude_rad[0]) * (longitude_rad - longitude_rad[0])
    north_m = _EARTH_M * (latitude_rad - latitude_rad[0])
    yaw_rad = np.unwrap(values[:, 5])
    return np.column_stack([east_m, north_m, yaw_rad, values[:, 8]])


def _place(
    boxes: list[tuple[int, FloatArray]],
    found: RecordedBoxes,
    car: FloatArray,
    camera: CalibratedCamera,
    rule: DecisionRule,
) -> _Ghost:
    """Places of a track's boxes: as the detector says, else where they meet the road.

    In the camera's frame x is right, y down and z ahead.
    """
    frames = np.array([frame for frame, _ in boxes])
    box_px = np.array([box for _, box in boxes])
    right_m = np.empty(len(frames))
    ahead_m = np.empty(len(frames))
    for row, (frame, box) in enumerate(zip(frames, box_px, strict=True)):
        (which,) = np.flatnonzero(
            (found.frame == frame) & (found.box_px == box).all(axis=1)
        )[:1]
        right_m[row], _, ahead_m[row] = found.position_m[which]
    by_camera = np.isnan(ahead_m)
    if by_camera.any():
        foot_px = bottoms(box_px)
        below = np.maximum(foot_px[:, 1] - camera.cy_px, 1.0) / camera.fy_px
        ahead_m = np.where(by_camera, _CAMERA_M / below, ahead_m)
        sideways = (foot_px[:, 0] - camera.cx_px) / camera.fx_px
        right_m = np.where(by_camera, sideways * ahead_m, right_m)
    east_m, north_m, yaw_rad, _ = car[frames].T
    cos = np.cos(yaw_rad)
    sin = np.sin(yaw_rad)
    place_m = np.column_stack(
        [
            east_m + ahead_m * cos + right_m * sin,
            north_m + ahead_m * sin - right_m * cos,
        ]
    )
    lens_m = np.column_stack([east_m, north_m, np.full(len(frames), _CAMERA_M)])
    feet_m = np.column_stack([place_m, np.zeros(len(frames))])
    errors: GroundErrors
    if by_camera.any():
        errors = camera_errors(
            lens_m,
            feet_m,
            np.tile(_BODY_M, (len(frames), 1)),
            rule=rule,
            box_noise_share=rule.box_noise_share,
            aim_sd_deg=aim_sd_deg(CALIBRATED),
        )
    else:
        errors = lidar_errors(
            lens_m,
            load_lidars()[_LIDAR],
            feet_m,
            rule=rule,
            aim_sd_deg=aim_sd_deg(CALIBRATED),
        )
    return _Ghost(frames=frames, place_m=place_m, covariance_m2=errors.covariance_m2())


def _brakes(ghost: _Ghost, car: FloatArray, rule: DecisionRule) -> bool:
    """True if the car brakes for a track of nothing."""
    aeb = load_aeb_rule()
    n = len(ghost.frames)
    time_s = np.arange(n) / TABLE_HZ
    axis = FrameAxis(
        run_ids=("ghost",),
        cases=("",),
        approaches=("",),
        weathers=("day",),
        vut_speed_kmh=np.zeros(1),
        weight=np.ones(1),
        last_brake_time_s=np.zeros(1),
        run_start=np.array([0, n]),
        time_s=time_s,
    )
    tracks = track(
        np.ones((1, n), dtype=bool),
        ghost.place_m[None, None],
        ghost.covariance_m2[None],
        axis,
        aeb=aeb,
        rule=rule,
    )
    # The car drives as it was recorded, from the track's first frame on.
    way = car[ghost.frames[0] :, :3]
    # Beyond the recording's end the car goes straight on at its last speed.
    *_, yaw_rad, speed_mps = car[-1]
    beyond_m = speed_mps / TABLE_HZ * np.arange(1, _FRAMES_BEYOND + 1)
    steps_m = beyond_m[:, None] * [np.cos(yaw_rad), np.sin(yaw_rad)]
    on_m = np.column_stack([way[-1, :2] + steps_m, np.full(_FRAMES_BEYOND, yaw_rad)])
    speed_mps = max(float(car[ghost.frames, 3].mean()), 0.1)
    standstill_s = standstill_time_s(speed_mps, rule=aeb)
    stopping_m = float(braking_distance_m(standstill_s, speed_mps=speed_mps, rule=aeb))
    ways = CarWays(
        place=np.concatenate([way, on_m]),
        start=np.array([0, len(way) + _FRAMES_BEYOND]),
        time_to_stop_s=np.array([stopping_m / speed_mps + aeb.latency_s]),
        half_vut_m=np.array(_HALF_CAR_M),
        half_vru_m=np.array([_HALF_BODY_M]),
    )
    found = overlap_probability(tracks, axis, ways, [rule.reserve_s], rule=rule)
    return bool(found.max() >= rule.threshold)
