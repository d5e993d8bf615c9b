"""A made-up placement instance of any size, made directly as bits."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from placement.detection_table import DetectionTable
from scenarios.runs import FrameAxis

_ARM_M = 120.0
_KERB_M = 8.0  # of the poles, from the middle of the street
_WIDTH_PX = 1920
_MIN_HEIGHT_PX = 40
_VRU_M = 1.7
_MAX_RANGE_M = 50.0
_ASPECT = 9.0 / 16.0
_DECELERATION_MPS2 = 7.72
_FRAME_RATE_HZ = 10.0
_MISSED_SHARE = 0.03
_PARKED_SHARE = 0.7


@dataclass(frozen=True, slots=True, kw_only=True)
class SyntheticSize:
    """Poles along both sides of four arms, their poses, and runs with all frames
    together.
    """

    n_sites: int = 100
    heights_m: tuple[float, ...] = (5.0, 8.0)
    n_yaws: int = 40
    pitches_deg: tuple[float, ...] = (-4.0, -8.0, -14.0, -22.0, -32.0)
    zooms_deg: tuple[float, ...] = (40.0, 55.0, 70.0, 90.0, 110.0)
    n_runs: int = 1000
    n_frames: int = 50_000

    @property
    def poses_per_mount(self) -> int:
        """Orientations and zooms of one height of one pole."""
        return self.n_yaws * len(self.pitches_deg) * len(self.zooms_deg)

    @property
    def n_poses(self) -> int:
        """Poses of all poles."""
        return self.n_sites * len(self.heights_m) * self.poses_per_mount


@dataclass(
    frozen=True,
    slots=True,
    kw_only=True,
    eq=False,
)
class SyntheticInstance:
    """V[c, f] as packed bits, the pole of every pose, and units per pole; runs weigh
    alike.
    """

    axis: FrameAxis
    packed: NDArray[np.uint8]
    site_index: IntArray
    site_capacity: IntArray

    def to_table(self) -> DetectionTable:
        """Detection table with a copy of the bits."""
        ids = tuple(f"pose-{pose}" for pose in range(len(self.packed)))
        return DetectionTable(pose_ids=ids, axis=self.axis, packed=self.packed)

    def __repr__(self) -> str:
        return (
            f"SyntheticInstance({len(self.packed)} poses, {self.axis.n_frames} frames)"
        )


@dataclass(
    frozen=True,
    slots=True,
    kw_only=True,
    eq=False,
)
class _Frames:
    """Positions of VRU and parked van by frame, (n_frames, 2), and heights in metres;
    0: none.
    """

    vru_m: FloatArray
    van_start_m: FloatArray
    van_end_m: FloatArray
    van_height_m: FloatArray


def build_synthetic_instance(
    size: SyntheticSize | None = None, *, seed: int = 0, workers: int = 1
) -> SyntheticInstance:
    """An instance, made pole by pole, directly as bits; the default size takes 1.25
    GB.
    """
    if size is None:
        size = SyntheticSize()
    axis, frames = _drive(size, np.random.default_rng([seed, 0]))
    packed = np.empty((size.n_poses, -(-axis.n_frames // 8)), dtype=np.uint8)
    fill = partial(_fill_mount, packed, size, axis, frames, seed)
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(fill, range(size.n_sites * len(size.heights_m))))

    per_site = len(size.heights_m) * size.poses_per_mount
    return SyntheticInstance(
        axis=axis,
        packed=packed,
        site_index=np.repeat(np.arange(size.n_sites), per_site),
        site_capacity=np.full(size.n_sites, 2),
    )


def _drive(
    size: SyntheticSize, random: np.random.Generator
) -> tuple[FrameAxis, _Frames]:
    """Runs that end at an impact on one of the arms."""
    n_runs = size.n_runs
    shares = np.linspace(0, size.n_frames, n_runs + 1).astype(np.int64)
    counts = shares[1:] - shares[:-1]
    spread = random.integers(0, max(1, int(counts.min()) // 3), size=n_runs // 2)
    counts[: 2 * len(spread) : 2] += spread
    counts[1 : 2 * len(spread) : 2] -= spread
    start = np.concatenate([[0], np.cumsum(counts)])
    run = np.repeat(np.arange(n_runs), counts)
    time_s = (np.arange(size.n_frames) - start[1:][run] + 1) / _FRAME_RATE_HZ

    vut_speed_kmh = 5.0 * random.integers(2, 13, size=n_runs).astype(np.float64)
    # In a street's own axes: along it, away from the crossing; and across it, to the
    # left.
    along_m = random.uniform(6.0, 70.0, size=n_runs)
    across_m = random.uniform(-5.0, 5.0, size=n_runs)
    walks_along = random.random(n_runs) < 0.25
    speed_mps = random.uniform(1.0, 4.5, size=n_runs) * random.choice(
        [-1.0, 1.0], size=n_runs
    )

    velocity = (
        np.where(walks_along, [[1.0], [0.0]], [[0.0], [1.0]]).T * speed_mps[:, None]
    )
    # The van stands beside the lane that the VRU is about to enter.
    van_across_m = np.where(speed_mps > 0.0, across_m - 2.5, across_m + 2.5)
    van_along_m = along_m + random.uniform(1.0, 3.0, size=n_runs)
    van_start = np.column_stack([van_along_m, van_across_m])
    van_end = van_start + np.column_stack(
        [random.uniform(3.0, 7.0, size=n_runs), np.zeros(n_runs)]
    )

    van_height_m = random.uniform(1.4, 3.0, size=n_runs)
    van_height_m[random.random(n_runs) > _PARKED_SHARE] = 0.0

    turn = 0.5 * np.pi * random.integers(0, 4, size=n_runs)
    ahead = np.column_stack([np.cos(turn), np.sin(turn)])
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])

    def to_world(street_m: FloatArray, index: IntArray) -> FloatArray:
        return street_m[:, :1] * ahead[index] + street_m[:, 1:] * left[index]

    every = np.arange(n_runs)
    impact = np.column_stack([along_m, across_m])
    frames = _Frames(
        vru_m=to_world(impact[run] + velocity[run] * time_s[:, None], run),
        van_start_m=to_world(van_start, every)[run],
        van_end_m=to_world(van_end, every)[run],
        van_height_m=van_height_m[run],
    )

    axis = FrameAxis(
        run_ids=tuple(f"synthetic/{number}" for number in every),
        cases=("synthetic",) * n_runs,
        approaches=("synthetic",) * n_runs,
        weathers=("day",) * n_runs,
        vut_speed_kmh=vut_speed_kmh,
        weight=np.full(n_runs, 1.0 / n_runs),
        last_brake_time_s=-vut_speed_kmh / 3.6 / (2.0 * _DECELERATION_MPS2),
        run_start=start,
        time_s=time_s,
    )
    return axis, frames


def _fill_mount(
    packed: NDArray[np.uint8],
    size: SyntheticSize,
    axis: FrameAxis,
    frames: _Frames,
    seed: int,
    mount: int,
) -> None:
    """Bits of all poses at one height of one pole."""
    site, height = divmod(mount, len(size.heights_m))
    height_m = size.heights_m[height]
    offset_m = frames.vru_m - _pole_m(size, site)
    distance_m = np.hypot(offset_m[:, 0], offset_m[:, 1])
    azimuth_deg = np.degrees(np.arctan2(offset_m[:, 1], offset_m[:, 0]))
    elevation_deg = np.degrees(np.arctan2(0.5 * _VRU_M - height_m, distance_m))

    seen = ~_is_hidden(_pole_m(size, site), height_m, frames)
    seen &= ~_is_grown_over(
        azimuth_deg, distance_m, np.random.default_rng([seed, 1, site])
    )
    missed = (
        np.random.default_rng([seed, 2, mount]).random(axis.n_frames) < _MISSED_SHARE
    )
    seen &= ~missed

    n_pitches = len(size.pitches_deg)
    n_zooms = len(size.zooms_deg)
    rows = np.empty((size.n_yaws, n_pitches, n_zooms, packed.shape[1]), dtype=np.uint8)

    for zoom, fov_deg in enumerate(size.zooms_deg):
        focal_px = 0.5 * _WIDTH_PX / np.tan(np.radians(0.5 * fov_deg))
        half_vertical_deg = np.degrees(
            np.arctan(_ASPECT * np.tan(np.radians(0.5 * fov_deg)))
        )
        range_m = min(_MAX_RANGE_M, focal_px * _VRU_M / _MIN_HEIGHT_PX)
        is_near = seen & (np.hypot(distance_m, height_m) <= range_m)
        inside = np.stack(
            [
                is_near & (np.abs(elevation_deg - pitch_deg) <= half_vertical_deg)
                for pitch_deg in size.pitches_deg
            ]
        )
        by_pitch = np.packbits(inside, axis=1, bitorder="little")
        for yaw, ahead in enumerate(_aimed(azimuth_deg, 0.5 * fov_deg, size.n_yaws)):
            rows[yaw, :, zoom] = by_pitch & np.packbits(ahead, bitorder="little")

    first = mount * size.poses_per_mount
    packed[first : first + size.poses_per_mount] = rows.reshape(-1, packed.shape[1])


def _pole_m(size: SyntheticSize, site: int) -> FloatArray:
    """Foot of a pole in metres, (2,)."""
    arm = site % 4
    number = site // 4
    per_arm = -(-size.n_sites // 4)
    if number % 2:
        side = _KERB_M
    else:
        side = -_KERB_M

    along_m = _KERB_M + (_ARM_M - _KERB_M) * number / max(per_arm - 1, 1)
    turn = 0.5 * np.pi * arm
    return np.array(
        [
            along_m * np.cos(turn) - side * np.sin(turn),
            along_m * np.sin(turn) + side * np.cos(turn),
        ]
    )


def _aimed(
    azimuth_deg: FloatArray, half_deg: float, n_yaws: int
) -> Iterator[BoolArray]:
    """For each yaw, the frames within a half angle of it."""
    for yaw_deg in np.arange(n_yaws) * (360.0 / n_yaws):
        away_deg = np.abs(azimuth_deg - yaw_deg)
        yield np.minimum(away_deg, np.abs(360.0 - away_deg)) <= half_deg


def _is_grown_over(
    azimuth_deg: FloatArray, distance_m: FloatArray, random: np.random.Generator
) -> BoolArray:
    """Frames in which trees and signs hide the VRU: a few sectors, each from some
    distance on.
    """
    hidden = np.zeros(len(azimuth_deg), dtype=bool)
    for middle_deg in random.uniform(-180.0, 180.0, size=random.integers(3, 8)):
        away_deg = np.abs(azimuth_deg - middle_deg)
        away_deg = np.minimum(away_deg, 360.0 - away_deg)
        beyond_m = random.uniform(10.0, 50.0)
        hidden |= (away_deg <= random.uniform(1.0, 8.0)) & (distance_m >= beyond_m)

    return hidden


def _is_hidden(pole_m: FloatArray, height_m: float, frames: _Frames) -> BoolArray:
    """Frames in which the parked van stands in the line of sight to the VRU's
    middle.
    """
    sight = frames.vru_m - pole_m
    van = frames.van_end_m - frames.van_start_m
    to_van = frames.van_start_m - pole_m
    cross = sight[:, 0] * van[:, 1] - sight[:, 1] * van[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (to_van[:, 0] * van[:, 1] - to_van[:, 1] * van[:, 0]) / cross
        along = (to_van[:, 0] * sight[:, 1] - to_van[:, 1] * sight[:, 0]) / cross

    line_m = height_m + share * (0.5 * _VRU_M - height_m)
    is_met = (share > 0.0) & (share < 1.0) & (along >= 0.0) & (along <= 1.0)
    return is_met & (line_m < frames.van_height_m)
