"""Candidate poses and runs to a detection table, and tables cached on disk."""

from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray
from geometry.errors import InputError
from geometry.lidar import LidarModel, load_lidar_detection
from geometry.phrases import Phrase
from geometry.scene import Scene
from geometry.weather import pick_weather
from scenarios.runs import FrameAxis, Run

from ..cache import CachedArrays, load_arrays, save_arrays, tell_unused
from ..candidates import CandidatePose
from ..compute import DEFAULT_COMPUTE, Compute, one_blas_thread, threads
from ..detection_table import DetectionTable
from ..detectors import PlanningDetector
from ..fingerprints import Fingerprints
from ..setting import Setting
from .casting import SharedScene, World, build_world
from .sensing import build_sensing, cast_for

# Points on each VRU: neighbours are about 10 cm apart.
N_POINTS = 160

STAGE = Phrase("detection table")


def build_detection_table(
    scene: Scene,
    candidates: Sequence[CandidatePose],
    runs: Sequence[Run],
    axis: FrameAxis,
    *,
    detector: PlanningDetector,
    compute: Compute = DEFAULT_COMPUTE,
    shared: SharedScene | None = None,
) -> DetectionTable:
    """Detections V[c, f] of every candidate pose in every frame.

    Parameters
    ----------
    scene : Scene
        What stands there in all runs.
    candidates : sequence of CandidatePose
        A row of the table each.
    runs : sequence of Run
        All have the same VUT.
    axis : FrameAxis
        Frames of all runs, the columns of the table.
    detector : PlanningDetector
        Says what counts as a detection of a camera; a LiDAR counts points.
    compute : Compute
        Seed, ray library, threads. Progress counts mount positions.
    shared : SharedScene, optional
        What this world has in common with others.
    """
    world = build_world(
        scene,
        runs,
        n_points=N_POINTS,
        seed=compute.seed,
        rays=compute.rays,
        shared=shared,
    )
    looks = [(candidate, detector) for candidate in candidates]
    return DetectionTable(
        pose_ids=tuple(candidate.id for candidate in candidates),
        axis=axis,
        packed=_pack_rows(world, looks, compute),
    )


Look = tuple[CandidatePose, PlanningDetector]


def _pack_rows(
    world: World, looks: Sequence[Look], compute: Compute
) -> NDArray[np.uint8]:
    """Rows of all looks, as bits; rays are cast once for each place.

    Returns
    -------
    packed : (n_looks, ceil(n_frames / 8)) uint8
        The first frame in the lowest bit.
    """
    packed = np.zeros(
        (len(looks), -(-len(world.views.view_of_frame) // 8)), dtype=np.uint8
    )

    def fill(rows: list[int]) -> None:
        here = [looks[row] for row in rows]
        position_m = here[0][0].pose.position_m
        sight = cast_for(world, position_m, here)
        sensing = build_sensing(world, sight, position_m, here[0][1])
        # Each detector once: what is seen is the same for all of them.
        rows_of: dict[PlanningDetector, list[int]] = {}
        for row in rows:
            rows_of.setdefault(looks[row][1], []).append(row)
        for detector, alike in rows_of.items():
            seeing = replace(sensing, detector=detector)
            packed[alike] = seeing.packed([looks[row][0] for row in alike])

    at_each_mount(
        [candidate for candidate, _ in looks], fill, stage=STAGE, compute=compute
    )
    return packed


def at_each_mount(
    candidates: Sequence[CandidatePose],
    work: Callable[[list[int]], None],
    *,
    stage: str,
    compute: Compute,
) -> None:
    """Call a function for the candidates of each mount, in threads.

    Parameters
    ----------
    candidates : sequence of CandidatePose
        All candidates.
    work : callable
        Called with the rows of all candidates at one place with one near limit.
    stage : str
        Stage whose progress is reported, mount by mount.
    compute : Compute
        Number of threads, and where progress goes.
    """
    mounts: dict[tuple[float, ...], list[int]] = {}
    for row, candidate in enumerate(candidates):
        key = (*candidate.pose.position_m.tolist(), candidate.sensor.near_m)
        mounts.setdefault(key, []).append(row)
    # One BLAS thread per worker: the matrices are small, and idle BLAS threads spin.
    with one_blas_thread(), threads(compute.workers) as pool:
        pending = [pool.submit(work, rows) for rows in mounts.values()]
        for done, future in enumerate(as_completed(pending), start=1):
            future.result()
            compute.progress(stage, done, len(mounts))


# ---------- a few poses, each with a detector of its own
def detected_frames(
    setting: Setting, looks: Sequence[Look], *, stage: str, compute: Compute
) -> BoolArray:
    """Frames in which units detect, each with a detector of its own.

    These are the rows that :func:`build_detection_table` has for each unit. Rays are
    cast once for all units at one place, and only to what any of them has in view.
    Frames that an earlier call has cached are not computed again.

    Parameters
    ----------
    setting : Setting
        Scene, runs and frame axis.
    looks : sequence of (CandidatePose, PlanningDetector)
        The units, each with its detector.
    stage : str
        Stage whose progress is reported.
    compute : Compute
        Seed, ray library, threads and cache folder.

    Returns
    -------
    detected : (n_looks, n_frames) bool
    """
    compute.progress(stage, 0, 0)
    hashes = Fingerprints()
    names = [
        hashes.of(
            unit.pose, unit.sensor, detector.fingerprint(), load_lidar_detection()
        )
        for unit, detector in looks
    ]
    scene_hash = ""
    if compute.cache_folder is not None:
        scene_hash = table_fingerprint(
            setting.scene, (), setting.runs, setting.table_detector, seed=compute.seed
        )
    cached = CachedArrays(
        compute.cache_folder, "looks", kind=_FORMAT, fingerprint=scene_hash
    )
    new = {
        name: look
        for name, look in zip(names, looks, strict=True)
        if name not in cached.arrays
    }
    if new:
        world = build_world(
            setting.scene,
            setting.runs,
            n_points=N_POINTS,
            seed=compute.seed,
            rays=compute.rays,
        )
        packed = _pack_rows(world, [*new.values()], compute.within(stage))
        frames = np.unpackbits(
            packed, axis=1, count=setting.axis.n_frames, bitorder="little"
        )
        cached.add(dict(zip(new, frames.astype(bool), strict=True)))
    return np.array([cached.arrays[name] for name in names])


# ---------- tables on disk, under a hash of everything that went into them
# Raise it whenever the same inputs give another table.
_FORMAT = "place-rsus/table/7"
_WHAT = "detection table"


def table_fingerprint(
    scene: Scene,
    candidates: Sequence[CandidatePose],
    runs: Sequence[Run],
    detector: PlanningDetector,
    *,
    seed: int,
) -> str:
    """Hash of all that a detection table depends on, 32 hexadecimal digits."""
    sensors = list(dict.fromkeys(candidate.sensor for candidate in candidates))
    has_lidar = any(isinstance(sensor, LidarModel) for sensor in sensors)
    poses = [candidate.pose for candidate in candidates]
    lidar_detection = None
    if has_lidar:
        lidar_detection = load_lidar_detection()
    weathers = dict.fromkeys(run.weather for run in runs)
    return Fingerprints().of(
        (_FORMAT, N_POINTS, seed, detector.fingerprint()),
        (scene.vertices_m, scene.triangles, scene.outline_m),
        (sensors, lidar_detection),
        # By number, not by name: names may be equal.
        [(candidate.id, sensors.index(candidate.sensor)) for candidate in candidates],
        np.array([pose.position_m for pose in poses]),
        np.array([(pose.yaw_deg, pose.pitch_deg) for pose in poses]),
        [pick_weather(name, "runs: weather") for name in weathers],
        [
            (
                run.id,
                run.weather,
                run.encounter.vut,
                run.encounter.vru,
                run.time_s,
                run.vut_position_m,
                run.vut_yaw_deg,
                run.vru_position_m,
                run.vru_yaw_deg,
                run.vru_shape,
                run.obstruction,
                run.traffic,
            )
            for run in runs
        ],
    )


def save_table(path: Path, table: DetectionTable, *, fingerprint: str) -> None:
    """Write a table, whole or not at all.

    A folder that cannot be written to is only logged.

    Parameters
    ----------
    path : Path
        The file.
    table : DetectionTable
        The table.
    fingerprint : str
        From :func:`table_fingerprint`; :func:`load_table` compares it.
    """
    save_arrays(
        path,
        {"packed": table.packed},
        what=_WHAT,
        kind=_FORMAT,
        fingerprint=fingerprint,
    )


def load_table(
    path: Path,
    *,
    fingerprint: str,
    candidates: Sequence[CandidatePose],
    axis: FrameAxis,
) -> DetectionTable | None:
    """Read a table with a fingerprint.

    Parameters
    ----------
    path : Path
        A file that :func:`save_table` wrote.
    fingerprint : str
        The one that it must have.
    candidates : sequence of CandidatePose
        Rows of the table.
    axis : FrameAxis
        Columns of the table.

    Returns
    -------
    table : DetectionTable or None
        None, and a line in the log, if the file is damaged or foreign.
    """
    arrays = load_arrays(path, what=_WHAT, kind=_FORMAT, fingerprint=fingerprint)
    if arrays is None:
        return None
    try:
        return DetectionTable(
            pose_ids=tuple(candidate.id for candidate in candidates),
            axis=axis,
            **arrays,
        )
    # Another number of frames, or other arrays.
    except (
        InputError,
        TypeError,
    ) as error:
        tell_unused(path, error, what=_WHAT)
        return None
