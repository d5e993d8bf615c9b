"""Candidate poses: every site x height x sensor x yaw x pitch."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geometry.arrays import BoolArray, FloatArray, float_array
from geometry.catalogue import Sensor, load_catalogue, pick_sensor
from geometry.errors import InputError, refuse
from geometry.lidar import LidarModel
from geometry.poses import Pose, body_rotation
from geometry.scene import Scene
from geometry.sensors import CameraModel, project_points
from geometry.tables import pick
from geometry.terrain import ground_height_m
from geometry.text_formats import load_data

from .compute import check_distinct
from .question import Question, read_number, split_names

# Solvers of differential equations come with it.
if TYPE_CHECKING:
    from scenarios.aeb import AebRule


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CandidatePose:
    """A sensor that could be mounted.

    Attributes
    ----------
    id : str
        Unique name.
    site_id : str
        Site of the scene that carries it; empty for a pose that belongs to no known
        site.
    pose : Pose
        Where it is and looks. World frame.
    sensor : CameraModel or LidarModel
        What is mounted.
    latency_s : float, optional
        From its frame to the onset of braking; by default that of the braking rule. [s]
    """

    id: str
    site_id: str
    pose: Pose
    sensor: Sensor
    latency_s: float | None = None

    def latency(self, rule: "AebRule") -> float:
        """Its own latency, or the rule's, in seconds."""
        if self.latency_s is None:
            return rule.latency_s
        return self.latency_s

    def __repr__(self) -> str:
        return f"CandidatePose({self.id!r})"


def above_ground(unit: CandidatePose, scene: Scene) -> CandidatePose:
    """A unit as if the ground below it were the plane z = 0.

    Where it is that plane, the same unit is returned.
    """
    ground_m = float(ground_height_m(scene, unit.pose.position_m[:2]))
    if ground_m == 0.0:
        return unit
    position_m = unit.pose.position_m - [0.0, 0.0, ground_m]
    return replace(unit, pose=replace(unit.pose, position_m=position_m))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CandidateGrid:
    """Which poses are tried at every site.

    Attributes
    ----------
    heights_m : (n,) float
        Above the road; at a site with a smaller range the nearest height in its range.
        [m]
    yaw_step_deg : float
        Yaws are the multiples of this all around; it divides 360. [deg]
    pitches_deg : (n,) float
        Positive up. [deg]
    sensors : tuple of CameraModel or LidarModel
        Models to choose from.
    ring_pitches_deg : (n,) float
        In place of `pitches_deg`, of LiDARs that scan all round. Level by default: a
        ring that is tilted down on one side looks into the sky on the other, which
        suits none but a mount at the edge of everything that matters. Positive up.
        [deg]
    """

    heights_m: FloatArray
    yaw_step_deg: float
    pitches_deg: FloatArray
    sensors: tuple[Sensor, ...]
    ring_pitches_deg: FloatArray = field(default_factory=lambda: np.zeros(1))

    def __post_init__(self) -> None:
        for name in ("heights_m", "pitches_deg", "ring_pitches_deg"):
            values = float_array(getattr(self, name), (-1,), name)
            object.__setattr__(self, name, values)
            if len(values) == 0:
                refuse(name, "none", "at least one")
            if name != "heights_m" and (np.abs(values) > 90.0).any():
                raise InputError(name, values.tolist(), "-90 .. 90 degrees")
        if (self.heights_m <= 0.0).any():
            raise InputError("heights_m", self.heights_m.tolist(), "metres, > 0")
        step_deg = float(float_array(self.yaw_step_deg, (), "yaw_step_deg"))
        if not 0.0 < step_deg <= 360.0:
            raise InputError("yaw_step_deg", step_deg, "0 < degrees <= 360")
        if not abs(self.n_yaws * step_deg - 360.0) <= 1.0e-9:
            raise InputError("yaw_step_deg", step_deg, "degrees that divide 360 evenly")
        if not self.sensors:
            refuse("sensors", "none", "at least one")

    @property
    def n_yaws(self) -> int:
        """Number of yaws."""
        return round(360.0 / self.yaw_step_deg)

    def directions_deg(self, sensor: Sensor) -> list[tuple[float, float]]:
        """Yaw and pitch of each direction that is tried for a sensor.

        A LiDAR that scans all round sees the same however it is turned, as long as it
        is level: then only yaw 0 is tried.
        """
        # From the whole circle, and rounded: sums of steps would miss 0 and 180 by a
        # hair.
        yaws_deg = (
            (360.0 * np.arange(1, self.n_yaws + 1) / self.n_yaws - 180.0)
            .round(12)
            .tolist()
        )
        if not is_ring(sensor):
            return list(product(yaws_deg, self.pitches_deg.tolist()))
        if (self.ring_pitches_deg == 0.0).any():
            level = [(0.0, 0.0)]
        else:
            level = []
        # A ring that is tilted sees something else at each yaw.
        tilts_deg = self.ring_pitches_deg[self.ring_pitches_deg != 0.0].tolist()
        return level + list(product(yaws_deg, tilts_deg))


def is_ring(sensor: Sensor) -> bool:
    """True if a sensor is a LiDAR that scans all round."""
    return isinstance(sensor, LidarModel) and sensor.scans_all_round


def is_turn_useless(sensor: Sensor, *, pitch_deg: float) -> bool:
    """True if a sensor sees the same at every yaw.

    That is so for a level LiDAR that scans all round.
    """
    return is_ring(sensor) and pitch_deg == 0.0


def is_in_view(unit: CandidatePose, points_m: FloatArray) -> BoolArray:
    """True for points (n, 3) in a unit's field of view, (n,) bool.

    Neither distance nor occlusion matters.
    """
    sensor = unit.sensor
    pose = unit.pose
    is_inside: BoolArray
    if isinstance(sensor, LidarModel):
        # A LiDAR sees by angles around its own axes.
        offsets = points_m - pose.position_m
        ahead, left, up = np.moveaxis(
            offsets @ body_rotation(pose.yaw_deg, pose.pitch_deg), -1, 0
        )
        azimuth_deg = np.degrees(np.arctan2(left, ahead))
        elevation_deg = np.degrees(np.arctan2(up, np.hypot(ahead, left)))
        is_inside = np.abs(azimuth_deg) <= 0.5 * sensor.horizontal_fov_deg
        is_inside &= np.abs(elevation_deg) <= 0.5 * sensor.vertical_fov_deg
    else:
        # A camera sees what is projected into its image.
        column, row, _ = project_points(points_m, pose, sensor).T
        # NaN, behind the lens, is inside nothing.
        is_inside = (column >= 0.0) & (column <= sensor.width_px)
        is_inside &= (row >= 0.0) & (row <= sensor.height_px)
    return is_inside


def build_candidates(
    scene: Scene,
    grid: CandidateGrid | None = None,
    *,
    extra: Sequence[CandidatePose] = (),
) -> tuple[CandidatePose, ...]:
    """Every site x height x sensor x direction, and some more by name.

    Parameters
    ----------
    scene : Scene
        Its sites are used.
    grid : CandidateGrid, optional
        What is tried at each; by default :func:`load_candidate_grid`.
    extra : sequence of CandidatePose
        Added behind, such as the poses of an existing layout.

    Returns
    -------
    candidates : tuple of CandidatePose
        Ids are unique.

    Raises
    ------
    InputError
        There is no site, or two ids are equal.
    """
    if not scene.sites:
        refuse(f"{scene.name}: sites", "none", "at least one mount site")
    grid = grid or load_candidate_grid()
    # The grid is the product of sites, heights, sensors and directions.
    candidates = [
        CandidatePose(
            id=f"{site.id}/{height_m:g}m/{yaw_deg:g}/{pitch_deg:g}/{sensor.name}",
            site_id=site.id,
            pose=Pose(
                position_m=site.position_m + [0.0, 0.0, height_m],
                yaw_deg=yaw_deg,
                pitch_deg=pitch_deg,
            ),
            sensor=sensor,
        )
        for site in scene.sites
        for height_m in np.unique(np.clip(grid.heights_m, *site.height_range_m))
        for sensor in grid.sensors
        for yaw_deg, pitch_deg in grid.directions_deg(sensor)
    ]
    candidates += extra
    check_distinct(
        "candidates", [candidate.id for candidate in candidates], "every id once"
    )
    return tuple(candidates)


@cache
def load_candidate_grid(*, is_coarse: bool = False) -> CandidateGrid:
    """The default grid, or a coarse one with a ninth of its poses.

    They are read from ``data/candidates.toml`` and ``coarse_candidates.toml``.
    """
    if is_coarse:
        where = "coarse_candidates.toml"
    else:
        where = "candidates.toml"
    table = load_data(__package__, where)
    models = tuple(
        pick_sensor(name, f"{where}: sensors") for name in table.pop("sensors")
    )
    return CandidateGrid(**table, sensors=models)


def build_grid(question: Question, *, is_coarse: bool = False) -> CandidateGrid:
    """The default grid, with the sensors, heights, yaws and pitches of a question.

    Raises InputError if a sensor is unknown, or a number cannot be.
    """
    # Only what the question gives replaces the default.
    changes: dict[str, Any] = {}
    if question.sensors:
        changes["sensors"] = tuple(own_models(question.sensors).values())
    if question.heights:
        changes["heights_m"] = _numbers(
            "heights", question.heights, "metres", 0.5, 50.0
        )
    if question.pitches:
        changes["pitches_deg"] = _numbers(
            "pitches", question.pitches, "degrees", -90.0, 90.0
        )
    if question.yaw_step_deg is not None:
        changes["yaw_step_deg"] = question.yaw_step_deg
    return replace(load_candidate_grid(is_coarse=is_coarse), **changes)


def _numbers(where: str, text: str, unit: str, low: float, high: float) -> FloatArray:
    """Numbers with commas between, each once."""
    expected = f"{unit} with commas between, {low:g} to {high:g}"
    numbers = [
        read_number(where, word, expected, low, high)
        for word in split_names(text, where)
    ]
    return np.array(numbers)


def own_models(sensors: str) -> dict[str, Sensor]:
    """Models by name, as a user lists them: of the catalogue, or of files."""
    names = split_names(sensors, "sensors")
    return {model.name: model for name in names for model in _sensors(name)}


def _sensors(word: str) -> Sequence[Sensor]:
    """The model of a name; all of a catalogue FILE.toml, or FILE.toml:NAME."""
    # A word is a file, a file with a name, or a name of the catalogue.
    path, _, name = word.rpartition(":")
    if word.endswith(".toml"):
        return list(load_catalogue(Path(word)).values())
    if path.endswith(".toml"):
        return [pick(load_catalogue(Path(path)), name, f"sensors: {path}")]
    return [pick_sensor(word, "sensors")]


def depth_in_picture(points_m: FloatArray, candidate: CandidatePose) -> FloatArray:
    """Depth of points (n, 3) in a camera's picture, hidden or not.

    It is infinite for points outside of the picture.
    """
    camera = candidate.sensor
    if not isinstance(camera, CameraModel):
        return np.full(len(points_m), np.inf)
    column, row, depth = project_points(points_m, candidate.pose, camera).T
    with np.errstate(invalid="ignore"):
        is_inside = (
            (column >= 0.0) & (column < camera.width_px) & (depth > camera.near_m)
        )
        is_inside &= (row >= 0.0) & (row < camera.height_px)
    return np.where(is_inside, depth, np.inf)
