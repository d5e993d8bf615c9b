"""The study's own cases: start and collision points of its released generator."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from msgspec import Struct

from geometry.actors import Actor, PlacedActor
from geometry.arrays import FloatArray, Point2
from geometry.errors import InputError, Unquoted
from geometry.frames import from_carla_points, from_carla_yaw
from geometry.lines import cross
from geometry.study_scene import ParkedRow
from geometry.tables import Text, pick, read_table
from geometry.text_formats import load_data

from .cases import Case, load_cases
from .encounters import Encounter
from .paths import MPS_PER_KMH, Motion, StraightPath
from .staging import Staging, impact_offset_m

_ON_LINE_TOLERANCE_M = 0.05
_ANGLE_TOLERANCE_DEG = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CasePlacement:
    """Where a case is driven at a junction, in the world frame.

    Attributes
    ----------
    scene_name, approach : str
        The junction, and the arm from which the VUT comes.
    case : Case
        What is driven.
    vut_path, vru_path : StraightPath
        From the start points on.
    vut_meeting_m, vru_meeting_m : float
        Distances along the paths from their starts to where the middle of the VRU is at
        the impact, and to the point beside it on the VUT's path. [m]
    obstruction : tuple of PlacedActor
        Parked bodies that belong to this case only.
    """

    scene_name: str
    case: Case
    approach: str
    vut_path: StraightPath
    vru_path: StraightPath
    vut_meeting_m: float
    vru_meeting_m: float
    obstruction: tuple[PlacedActor, ...]


class _Entry(Struct, frozen=True, kw_only=True):
    """A case on an approach, in CARLA's frame."""

    case: Text
    approach: Text
    vut_start_m: Point2
    vut_yaw_deg: float
    vru_start_m: Point2
    vru_yaw_deg: float
    collision_point_m: Point2


class _File(Struct, frozen=True, kw_only=True):
    scene: Text
    placements: tuple[_Entry, ...]
    parked_rows: tuple[ParkedRow, ...] = ()


@cache
def load_placements() -> tuple[CasePlacement, ...]:
    """Where the study's cases are driven at its junction.

    They are read from ``data/town05_runs.toml``.
    """
    where = "town05_runs.toml"
    table = read_table(load_data(__package__, where), _File, where)
    rows = enumerate(table.parked_rows)
    parked = tuple(
        one for at, row in rows for one in row.bodies(f"{where}: parked_rows[{at}]")
    )
    return tuple(
        _build_placement(entry, f"{where}: placements[{index}]", table.scene, parked)
        for index, entry in enumerate(table.placements)
    )


def find_placement(scene_name: str, case: Case, approach: str) -> CasePlacement | None:
    """Where a case is driven from an approach of a scene; None if no file says."""
    wanted = (scene_name, case.name, approach)
    every = load_placements()
    keys = ((one.scene_name, one.case.name, one.approach) for one in every)
    return next(
        (one for one, key in zip(every, keys, strict=True) if key == wanted), None
    )


def stage_published(
    placement: CasePlacement, *, vut_speed_kmh: float, vut: Actor
) -> Staging:
    """Set a run up as the study's generator does.

    Both stand at their start, set off at full speed and keep it. At the impact the
    middle of the VRU is at the meeting point, and the VUT's front at its flank
    (longitudinal: its rear).
    """
    case = placement.case
    vut_speed = vut_speed_kmh * MPS_PER_KMH
    vru_speed = case.vru_speed_kmh * MPS_PER_KMH
    # The VUT's front is at the VRU's flank, or behind it at its rear.
    gap_m = 0.5 * (case.vru.width_m if case.kind == "crossing" else case.vru.length_m)
    vut_distance = placement.vut_meeting_m - 0.5 * vut.length_m - gap_m
    # +1 if the VRU walks towards the VUT's left, -1 towards its right, 0 along its path
    ahead = placement.vut_path.direction
    walking = placement.vru_path.direction
    sign = float(np.sign(cross(ahead, walking)))
    sign *= case.kind != "longitudinal"
    vru_distance = placement.vru_meeting_m + impact_offset_m(case, vut) * sign
    vut_motion, vru_motion = (
        Motion(path=path, speed_mps=speed, start_time_s=-distance / speed)
        for path, speed, distance in (
            (placement.vut_path, vut_speed, vut_distance),
            (placement.vru_path, vru_speed, vru_distance),
        )
    )
    encounter = Encounter(
        vut=vut, vut_motion=vut_motion, vru=case.vru, vru_motion=vru_motion
    )
    return Staging(encounter=encounter, obstruction=placement.obstruction)


def _build_placement(
    entry: _Entry, where: str, scene_name: str, parked: tuple[PlacedActor, ...]
) -> CasePlacement:
    """Where a case of the file is driven, or InputError."""
    case = pick(load_cases(), entry.case, f"{where}.case")
    vut_path = _build_path(entry.vut_start_m, entry.vut_yaw_deg)
    vru_path = _build_path(entry.vru_start_m, entry.vru_yaw_deg)
    collision = from_carla_points(entry.collision_point_m)
    if case.kind == "crossing":
        vut_meeting, vru_meeting = _crossing_distances(vut_path, vru_path, where)
    else:
        if vut_path.direction @ vru_path.direction < np.cos(
            np.radians(_ANGLE_TOLERANCE_DEG)
        ):
            got = Unquoted(
                f"headings {vut_path.yaw_deg:g} and {vru_path.yaw_deg:g} degrees"
            )
            raise InputError(where, got, "one heading for VUT and VRU")
        vut_meeting = float((collision - vut_path.start_m) @ vut_path.direction)
        vru_meeting = float((collision - vru_path.start_m) @ vru_path.direction)
    met_m, _ = vut_path.at(vut_meeting)
    east, north = collision - met_m
    beside_m = abs(vut_path.direction[0] * north - vut_path.direction[1] * east)
    if beside_m > _ON_LINE_TOLERANCE_M:
        point = entry.collision_point_m.tolist()
        raise InputError(
            f"{where}.collision_point_m", point, "a point on the VUT's path"
        )
    if not (vut_meeting > 0.0 and vru_meeting > 0.0):
        got = Unquoted("paths that meet behind a start")
        raise InputError(where, got, "starts before the meeting point")
    return CasePlacement(
        scene_name=scene_name,
        case=case,
        approach=entry.approach,
        vut_path=vut_path,
        vru_path=vru_path,
        vut_meeting_m=vut_meeting,
        vru_meeting_m=vru_meeting,
        obstruction=parked,
    )


def _build_path(start_m: FloatArray, yaw_deg: float) -> StraightPath:
    return StraightPath(
        start_m=from_carla_points(start_m), yaw_deg=float(from_carla_yaw(yaw_deg))
    )


def _crossing_distances(
    a: StraightPath, b: StraightPath, where: str
) -> tuple[float, float]:
    """Distances from both starts to where the paths cross, in metres."""
    # At the impact the gap between the bodies' middles is half the VRU's width only if
    # it crosses squarely.
    angle_deg = float(
        np.degrees(np.arccos(np.clip(abs(a.direction @ b.direction), 0.0, 1.0)))
    )
    if angle_deg < 90.0 - _ANGLE_TOLERANCE_DEG:
        got = Unquoted(f"paths at {angle_deg:.1f} degrees")
        raise InputError(where, got, "perpendicular paths")
    matrix = np.stack([a.direction, -b.direction], axis=1)
    distances = np.linalg.solve(matrix, b.start_m - a.start_m)
    return float(distances[0]), float(distances[1])
