"""Detection tables on disk, under a hash of everything that went into them."""

import hashlib
import logging
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TypeVar

import numpy as np

from geometry.actors import Actor
from geometry.files import write_atomically
from geometry.lidar import LidarModel, load_lidar_detection
from geometry.scene import Scene
from geometry.weather import pick_weather
from scenarios.runs import FrameAxis, Run

from ..candidates import CandidatePose
from ..detection_table import DetectionTable
from ..detectors import PlanningDetector
from . import build

_FORMAT = "place-rsus/table/3"  # raise it whenever the same inputs give another table
_log = logging.getLogger(__name__)
_T = TypeVar("_T")


def table_fingerprint(
    scene: Scene,
    candidates: Sequence[CandidatePose],
    runs: Sequence[Run],
    detector: PlanningDetector,
    *,
    seed: int,
) -> str:
    """Hash of all that a detection table depends on, 32 hexadecimal digits."""
    digest = hashlib.blake2b(digest_size=16)

    def add(*values: object) -> None:
        for value in values:
            if isinstance(value, np.ndarray):
                digest.update(f"{value.dtype}{value.shape}".encode())
                digest.update(np.ascontiguousarray(value).tobytes())
            else:
                digest.update(repr(value).encode())
            digest.update(b"\0")

    add(_FORMAT, build.N_POINTS, seed, detector.fingerprint())
    add(scene.vertices_m, scene.triangles, scene.outline_m)
    # By number, not by name: names may be equal.
    sensors = _numbered(candidate.sensor for candidate in candidates)
    for sensor in sensors:
        add(type(sensor).__name__, asdict(sensor))
    if any(isinstance(sensor, LidarModel) for sensor in sensors):
        add(asdict(load_lidar_detection()))
    add([(candidate.id, sensors[candidate.sensor]) for candidate in candidates])
    add(np.array([candidate.pose.position_m for candidate in candidates]))
    add(np.array([(c.pose.yaw_deg, c.pose.pitch_deg) for c in candidates]))
    actors = _numbered(actor for run in runs for actor in _actors_of(run))
    for actor in actors:
        add(actor.name, actor.length_m, actor.width_m, actor.height_m, len(actor.shapes))
        for shape in actor.shapes:
            add(shape.vertices_m, shape.triangles)
    for name in dict.fromkeys(run.weather for run in runs):
        add(asdict(pick_weather(name, "runs: weather")))
    for run in runs:
        add(run.id, run.weather, [actors[actor] for actor in _actors_of(run)], run.time_s)
        add(run.vut_position_m, run.vut_yaw_deg)
        add(run.vru_position_m, run.vru_yaw_deg, run.vru_shape)
        for parked in run.obstruction:
            add(parked.pose.position_m, parked.pose.yaw_deg, parked.pose.pitch_deg)
        add("end of run")
    return digest.hexdigest()


def _actors_of(run: Run) -> list[Actor]:
    return [run.encounter.vut, run.encounter.vru, *(parked.actor for parked in run.obstruction)]


def _numbered(things: Iterable[_T]) -> dict[_T, int]:
    """Number of each distinct thing, in the order in which they first appear."""
    return {thing: number for number, thing in enumerate(dict.fromkeys(things))}


def save_table(path: Path, table: DetectionTable, *, fingerprint: str) -> None:
    """Write a table, whole or not at all; a folder that cannot be written to is only logged."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(
            path,
            lambda file: np.savez(
                file, format=_FORMAT, fingerprint=fingerprint, packed=table.packed
            ),
        )
    except OSError as error:
        _log.warning("detection table not cached: %s: %s", path, error.strerror or error)


def load_table(
    path: Path, *, fingerprint: str, candidates: Sequence[CandidatePose], axis: FrameAxis
) -> DetectionTable | None:
    """Read a table of a fingerprint; None, and logged, if the file is damaged or foreign."""
    try:
        # Opened here: numpy does not close a file that turns out to be no archive.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            if str(stored["format"]) != _FORMAT or str(stored["fingerprint"]) != fingerprint:
                raise ValueError("made from other inputs")
            return DetectionTable(
                pose_ids=tuple(candidate.id for candidate in candidates),
                axis=axis,
                packed=stored["packed"],
            )
    except FileNotFoundError:
        return None
    except (
        Exception
    ) as error:  # what damaged archives raise has no end: zipfile's, zlib's, tokenize's
        _log.warning("cached detection table not used, made anew: %s: %s", path, error)
        return None
