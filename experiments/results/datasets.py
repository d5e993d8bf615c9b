"""Contents of a dataset, as ``dataset.json`` lists them, and the summary of the command."""

from pathlib import Path

import msgspec

from geometry.errors import InputError, Unquoted
from geometry.files import read_bytes
from placement.recordings import FrameKey

from .record import Record

MANIFEST = "dataset.json"
SCHEMA = "place-rsus/dataset/1"


class DatasetUnit(Record, frozen=True):
    """A unit of a dataset: its folder, and its camera's calibration as OpenCV has it.

    Attributes
    ----------
    folder : str
        Name of its folder.
    id : str
        Of the unit in its layout, or "VUT".
    width_px, height_px : int
        Size of the pictures.
    camera_matrix : tuple
        K; the middle of the first pixel is (0, 0). [px]
    world_to_camera, translation_m : tuple or None
        R and t, x_camera = R x_world + t; None of the VUT's camera, which drives.
    """

    folder: str
    id: str
    width_px: int
    height_px: int
    camera_matrix: tuple[tuple[float, ...], ...]
    world_to_camera: tuple[tuple[float, ...], ...] | None
    translation_m: tuple[float, ...] | None


class DatasetDrive(Record, frozen=True):
    """A run as part of a dataset: files of its frames are called SCENARIO_NUMBER.

    Attributes
    ----------
    run : str
        Id.
    weather : str
        Of the run.
    scenario, first_number, frames : int
        Of the names of its files; numbers run on.
    last_brake_time_s : float or None
        Relative to the impact, which is the last frame; None: braking cannot help. [s]
    """

    run: str
    weather: str
    scenario: int
    first_number: int
    frames: int
    last_brake_time_s: float | None

    def pictured(self, every: int) -> range:
        """Frames with pictures: every so many."""
        return range(0, self.frames, every)

    def stem(self, frame: int) -> str:
        """Name of a frame's files, without its ending."""
        return FrameKey(self.scenario, self.first_number + frame).file_name.removesuffix(".txt")


class DatasetRecord(Record, frozen=True):
    """``dataset.json``: what a dataset holds; a folder with another one is not added to.

    Attributes
    ----------
    schema : str
        Name and version of the file's format.
    format : str
        One of ``FORMATS``.
    scene : str
        Name of the junction.
    detector : str
        Whose detections are in ``Eval``.
    every : int
        Pictures are of every so many frames of a run.
    lidar : str
        Model of the LiDAR beside each camera; "none" for none.
    masks, depth : bool
        Whether there are pictures of instances and of depths.
    vehicles : bool
        Whether vehicles have labels, too, in frames with pictures.
    vary : bool
        Whether clothes, paints and facades are others in each run.
    seed : int
        Of noise, of what is left to chance.
    units, drives : tuple
        Who looks, and at what.
    """

    schema: str
    format: str
    scene: str
    detector: str
    every: int
    lidar: str
    masks: bool
    depth: bool
    vehicles: bool
    vary: bool
    seed: int
    units: tuple[DatasetUnit, ...]
    drives: tuple[DatasetDrive, ...]


class DatasetSummary(Record, frozen=True):
    """What a call has done.

    Attributes
    ----------
    folder : str
        Where the dataset is.
    pictures, drawn : int
        In it, and of these drawn by this call.
    frames, runs, units : int
        Of the dataset.
    size_bytes : int
        Of pictures and clouds drawn by this call.
    seconds : float
        For drawing.
    """

    folder: str
    pictures: int
    drawn: int
    frames: int
    runs: int
    units: int
    size_bytes: int
    seconds: float


def load_manifest(path: Path) -> DatasetRecord:
    """Read ``dataset.json``; InputError if it is something else."""
    data = read_bytes(path)
    try:
        return msgspec.json.decode(data, type=DatasetRecord)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputError(str(path), Unquoted(error), "a manifest of place-rsus dataset") from None
