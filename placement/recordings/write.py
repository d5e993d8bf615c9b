"""Write labels, detections and motions as a folder in the study's format."""

import shutil
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

from geometry.arrays import FloatArray, float_array
from geometry.errors import InputError, Unquoted

from .files import VRU_CLASSES, FrameKey, RecordingFormat, load_format

CONFIDENCE = 1.0
"""Of every detection that is written."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WrittenDrive:
    """A drive to write.

    Attributes
    ----------
    scenario : int
        Index in the recording.
    vru_class : str
        "pedestrian" or "bicycle".
    vut_speed_mps, vru_speed_mps : float
        Target speeds. [m/s]
    distance_m : (n_frames,) float
        Between the origins of VUT and VRU; the last frame is that of the impact. [m]
    labels_px, detections_px : mapping of str to (n_frames, 4) float
        Per unit, by the name of its folder, the VRU's box and what was found; a box without area
        stands for none. [px]
    label_distance_m : mapping of str to (n_frames,) float
        Per unit, how far the VRU is. [m]
    """

    scenario: int
    vru_class: str
    vut_speed_mps: float
    vru_speed_mps: float
    distance_m: FloatArray
    labels_px: Mapping[str, FloatArray]
    detections_px: Mapping[str, FloatArray]
    label_distance_m: Mapping[str, FloatArray]

    def __post_init__(self) -> None:
        if self.vru_class not in VRU_CLASSES:
            raise InputError("vru_class", self.vru_class, "one of " + ", ".join(VRU_CLASSES))
        object.__setattr__(self, "distance_m", float_array(self.distance_m, (-1,), "distance_m"))
        n_frames, units = len(self.distance_m), list(self.labels_px)
        for name, shape in (
            ("labels_px", (n_frames, 4)),
            ("detections_px", (n_frames, 4)),
            ("label_distance_m", (n_frames,)),
        ):
            arrays = getattr(self, name)
            if list(arrays) != units:
                raise InputError(name, list(arrays), f"the units of labels_px: {units}")
            checked = {
                unit: float_array(array, shape, f"{name}[{unit}]") for unit, array in arrays.items()
            }
            object.__setattr__(self, name, checked)


def write_recording(
    folder: Path,
    drives: Sequence[WrittenDrive],
    *,
    bicycle_name: str = "bycicle",
    n_reset_frames: int | None = None,
    left_out: Collection[str] = (),
) -> None:
    """Write drives (with the same units) as the study's generator does, whole or not at all.

    Frame numbers run on over all drives. After each drive there are `n_reset_frames` frames, by
    default as many as the generator's, with the bodies back at their starts, as in its first frame.
    `bicycle_name` is spelled as in the study's paper; `left_out` are files that shall be missing,
    such as "3/0_17.txt". Raises InputError if units differ, or the folder is not empty or not
    writable.
    """
    form = load_format()
    if not drives:
        raise InputError("drives", Unquoted("none"), "at least one")
    units = list(drives[0].labels_px)
    for drive in drives:
        if list(drive.labels_px) != units:
            raise InputError("units", list(drive.labels_px), f"those of the first drive: {units}")
    n_resets = form.n_reset_frames if n_reset_frames is None else n_reset_frames
    temporary = folder.with_name(f".{folder.name}.{uuid4().hex}.tmp")
    try:
        if folder.exists() and any(folder.iterdir()):
            raise InputError(str(folder), Unquoted("a folder that is not empty"), "a new one")
        for name in (*units, form.world_folder, form.eval_folder):
            (temporary / name).mkdir(parents=True)
        for file_name, text in _files(drives, form, bicycle_name, n_resets):
            if file_name not in left_out:
                (temporary / file_name).write_text(text, encoding="utf-8")
        temporary.rename(folder)  # onto an empty folder, too
    except OSError as error:
        raise InputError(
            str(folder), Unquoted(error.strerror or error), "a folder that can be written"
        ) from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _files(
    drives: Sequence[WrittenDrive], form: RecordingFormat, bicycle_name: str, n_resets: int
) -> Iterator[tuple[str, str]]:
    """Names relative to the folder, and contents."""
    number = 0
    for drive in drives:
        actor = bicycle_name if drive.vru_class == "bicycle" else drive.vru_class
        for frame in [*range(len(drive.distance_m)), *[0] * n_resets]:
            name = FrameKey(drive.scenario, number).file_name
            number += 1
            yield (
                f"{form.world_folder}/{name}",
                _words(drive.distance_m[frame], drive.vut_speed_mps, drive.vru_speed_mps),
            )
            found = []
            for unit, labels_px in drive.labels_px.items():
                label, detection = labels_px[frame], drive.detections_px[unit][frame]
                distance_m = drive.label_distance_m[unit][frame]
                text = f"{actor} {_words(*label, distance_m)}\n" if _has_area(label) else ""
                yield f"{unit}/{name}", text
                if _has_area(detection):
                    found.append(f"{unit} {actor} {_words(*detection, CONFIDENCE)}\n")
            yield f"{form.eval_folder}/{name}", "".join(found)


def _words(*numbers: float) -> str:
    return " ".join(str(float(number)) for number in numbers)


def _has_area(box_px: FloatArray) -> bool:
    return bool(box_px[2] > box_px[0] and box_px[3] > box_px[1])
