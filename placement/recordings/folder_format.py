"""What is known of the folder layout of the CarlaNCAP study."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import NamedTuple

from geometry.toml_files import load_toml, take, take_list, take_number, take_text

VRU_CLASSES = ("pedestrian", "bicycle")


class FrameKey(NamedTuple):
    """What a file's name SCENARIO_FRAME.txt says.

    Attributes
    ----------
    scenario : int
        Index of the scenario.
    number : int
        Number of the frame: it runs on over all drives of the scenario.
    """

    scenario: int
    number: int

    @property
    def file_name(self) -> str:
        """Name of the frame's text files."""
        return f"{self.scenario}_{self.number}.txt"


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingFormat:
    """The study's folder layout, and how motion is read off it.

    Attributes
    ----------
    width_px, height_px : int
        Of every image.
    frame_rate_hz : float
        Of every unit. [Hz]
    n_reset_frames : int
        Frames between two drives.
    min_iou : float
        A detection must overlap the label by more than this.
    vut_folder, world_folder, eval_folder : str
        Names of folders; all others are units and have a number for a name.
    vut_indices : tuple of str
        What stands for the VUT in Eval.
    label_fields, world_fields, eval_fields : tuple of str
        What a line holds.
    actor_types : mapping of str to str
        Spelling to class: "pedestrian", "bicycle", "other".
    window_s, min_closing_speed_mps, max_same_direction_deg, speed_tolerance, jump_m, max_gap_s,
    standing_m
        See the data file. [s], [m/s], [deg], share, [m], [s], [m]
    min_frames : int
        See the data file.
    """

    width_px: int
    height_px: int
    frame_rate_hz: float
    n_reset_frames: int
    min_iou: float
    vut_folder: str
    world_folder: str
    eval_folder: str
    vut_indices: tuple[str, ...]
    label_fields: tuple[str, ...]
    world_fields: tuple[str, ...]
    eval_fields: tuple[str, ...]
    actor_types: Mapping[str, str]
    window_s: float
    min_frames: int
    min_closing_speed_mps: float
    max_same_direction_deg: float
    speed_tolerance: float
    jump_m: float
    max_gap_s: float
    standing_m: float


@cache
def load_format() -> RecordingFormat:
    """The layout, from ``data/carla_ncap_format.toml``."""
    where = "carla_ncap_format.toml"
    table = load_toml(files(__package__) / "data" / where)
    motion = take(table, "motion", where)

    def number(name: str) -> float:
        return take_number(table, name, where)

    def moving(name: str) -> float:
        return take_number(motion, name, f"{where}: motion")

    return RecordingFormat(
        width_px=int(number("width_px")),
        height_px=int(number("height_px")),
        frame_rate_hz=number("frame_rate_hz"),
        n_reset_frames=int(number("n_reset_frames")),
        min_iou=number("min_iou"),
        vut_folder=take_text(table, "vut_folder", where),
        world_folder=take_text(table, "world_folder", where),
        eval_folder=take_text(table, "eval_folder", where),
        vut_indices=tuple(take_list(table, "vut_indices", where)),
        label_fields=tuple(take_list(table, "label_fields", where)),
        world_fields=tuple(take_list(table, "world_fields", where)),
        eval_fields=tuple(take_list(table, "eval_fields", where)),
        actor_types=dict(take(table, "actor_types", where)),
        window_s=moving("window_s"),
        min_frames=int(moving("min_frames")),
        min_closing_speed_mps=moving("min_closing_speed_mps"),
        max_same_direction_deg=moving("max_same_direction_deg"),
        speed_tolerance=moving("speed_tolerance"),
        jump_m=moving("jump_m"),
        max_gap_s=moving("max_gap_s"),
        standing_m=moving("standing_m"),
    )
