"""A recording from its folder: strict about what would make the result wrong, counting the rest."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from geometry.errors import InputError, Unquoted

from .drives import Drive, cut_drives, with_class
from .files import (
    VRU_CLASSES,
    Box,
    FrameKey,
    Label,
    RecordingFormat,
    World,
    load_format,
    read_detections,
    read_labels,
    read_world,
)

NO_WORLD = "frames without WorldData"
OTHER_LABELS = "labels of other classes"
OTHER_DETECTIONS = "detections of other classes"
OUTSIDE = "boxes outside the image"
NO_AREA = "boxes without area"
REPEATED = "lines that repeat others"
OTHER_NAMES = "files and folders with other names"

_FRAME_NAME = re.compile(r"(0|[1-9]\d{0,8})_(0|[1-9]\d{0,8})\.txt", re.ASCII)
_UNIT_NAME = re.compile(r"0|[1-9]\d{0,8}", re.ASCII)
_BESIDE = (".png", ".bin")  # images and points of the frames


class Found(NamedTuple):
    """A detection of a VRU by a unit.

    Attributes
    ----------
    class_name : str
        "pedestrian" or "bicycle".
    box_px : (4,) float
        Inside the image. [px]
    confidence : float
        0 .. 1.
    """

    class_name: str
    box_px: Box
    confidence: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """What a folder in the study's format holds.

    Attributes
    ----------
    folder : Path
        Where it was read.
    units : tuple of str
        Names of the roadside units' folders, ascending.
    has_vut : bool
        Whether the VUT's own camera is recorded, too.
    drives : tuple of Drive
        At least one.
    labels : mapping of str to mapping of FrameKey to list of Label
        Per unit ("car": the VUT): VRUs in view, boxes clipped to the image.
    detections : mapping of str to mapping of FrameKey to list of Found
        Per unit: VRUs found, boxes clipped to the image.
    n_frames : int
        Frames with WorldData.
    skipped : mapping of str to int
        What was left out: reason and count.
    """

    folder: Path
    units: tuple[str, ...]
    has_vut: bool
    drives: tuple[Drive, ...]
    labels: Mapping[str, Mapping[FrameKey, list[Label]]]
    detections: Mapping[str, Mapping[FrameKey, list[Found]]]
    n_frames: int
    skipped: Mapping[str, int]

    @property
    def n_missing(self) -> int:
        """Frames that are missing within drives."""
        return sum(drive.n_missing for drive in self.drives)

    def __repr__(self) -> str:
        return (
            f"Recording({self.folder.name!r}: {len(self.units)} units, {len(self.drives)} drives, "
            f"{self.n_frames} frames)"
        )


def read_recording(folder: Path) -> Recording:
    """Read a folder in the format of the released CarlaNCAP data.

    Parameters
    ----------
    folder : Path
        With unit folders ``0``, ``1``.. and ``car``, ``WorldData`` and ``Eval``. In ``Eval``,
        cam_index is the name of a unit's folder; where there is no unit folder ``12``, that number
        means the VUT's camera, as -1 does: the release does not say which it uses.

    Returns
    -------
    recording : Recording
        With a count of everything that was left out.

    Raises
    ------
    InputError
        A folder is missing or holds no frame, a line is not what it should be, Eval names a unit
        that has no folder, or nothing is left that could be judged.
    """
    form = load_format()
    skipped: Counter[str] = Counter()
    units, has_vut = _find_units(folder, form, skipped)
    names = [*units, form.vut_folder] if has_vut else [*units]
    world = _read_all_world(folder / form.world_folder, form, skipped)
    labels = {name: _read_all_labels(folder / name, form, skipped) for name in names}
    detections, evaluated = _read_all_detections(folder, names, form, skipped)
    skipped[NO_WORLD] += len(set(evaluated).union(*labels.values()).difference(world))
    drives, left_out = cut_drives(world, form)
    skipped += left_out
    if not drives:
        raise InputError(
            str(folder),
            Unquoted("no drive; " + ", ".join(f"{n} {why}" for why, n in skipped.items())),
            "frames in which the VUT and a VRU come together",
        )
    return Recording(
        folder=folder,
        units=tuple(units),
        has_vut=has_vut,
        drives=tuple(_with_class(drive, labels) for drive in drives),
        labels=labels,
        detections=detections,
        n_frames=len(world),
        skipped=dict(+skipped),
    )


def _find_units(
    folder: Path, form: RecordingFormat, skipped: Counter[str]
) -> tuple[list[str], bool]:
    try:
        entries = list(folder.iterdir())
    except OSError as error:
        raise InputError(
            str(folder), Unquoted(error.strerror or error), "a folder with a recording"
        ) from None
    names = {entry.name for entry in entries if entry.is_dir()}
    for name in (form.world_folder, form.eval_folder):
        if name not in names:
            raise InputError(str(folder / name), Unquoted("nothing"), "a folder with frames")
    units = sorted((name for name in names if _UNIT_NAME.fullmatch(name)), key=int)
    if not units:
        raise InputError(
            str(folder), Unquoted("no unit"), "a folder named 0, 1 .. for each roadside unit"
        )
    known = {*units, form.vut_folder, form.world_folder, form.eval_folder}
    skipped[OTHER_NAMES] += len({entry.name for entry in entries} - (known & names))
    return units, form.vut_folder in names


def _frames(folder: Path, skipped: Counter[str]) -> Iterator[tuple[FrameKey, Path]]:
    """Frames of a folder, in order."""
    found = {}
    try:
        for path in folder.iterdir():
            match = _FRAME_NAME.fullmatch(path.name)
            if match:
                found[FrameKey(int(match[1]), int(match[2]))] = path
            elif path.suffix not in _BESIDE:
                skipped[OTHER_NAMES] += 1
    except OSError as error:
        raise InputError(
            str(folder), Unquoted(error.strerror or error), "a folder that can be read"
        ) from None
    if not found:
        raise InputError(str(folder), Unquoted("no frame"), "files SCENARIO_FRAME.txt")
    for key in sorted(found):
        yield key, found[key]


def _read_all_world(
    folder: Path, form: RecordingFormat, skipped: Counter[str]
) -> dict[FrameKey, World]:
    world = {}
    for key, path in _frames(folder, skipped):
        world[key], n_repeated = read_world(path, form)
        skipped[REPEATED] += n_repeated
    return world


def _read_all_labels(
    folder: Path, form: RecordingFormat, skipped: Counter[str]
) -> dict[FrameKey, list[Label]]:
    """Labels of VRUs; a frame without any has an empty list."""
    frames: dict[FrameKey, list[Label]] = {}
    for key, path in _frames(folder, skipped):
        labels, n_repeated = read_labels(path, form)
        skipped[REPEATED] += n_repeated
        frames[key] = kept = []
        for label in labels:
            if label.class_name not in VRU_CLASSES:
                skipped[OTHER_LABELS] += 1
                continue
            box = _inside(label.box_px, form, skipped)
            if box is not None:
                kept.append(label._replace(box_px=box))
    return frames


def _read_all_detections(
    folder: Path, names: list[str], form: RecordingFormat, skipped: Counter[str]
) -> tuple[dict[str, dict[FrameKey, list[Found]]], list[FrameKey]]:
    """Detections of VRUs per unit, and the frames for which there is a file."""
    by_unit: dict[str, dict[FrameKey, list[Found]]] = {name: {} for name in names}
    unit_of = {name: name for name in names}
    if form.vut_folder in names:
        unit_of = dict.fromkeys(form.vut_indices, form.vut_folder) | unit_of
    frames = []
    for key, path in _frames(folder / form.eval_folder, skipped):
        frames.append(key)
        detections, n_repeated = read_detections(path, form)
        skipped[REPEATED] += n_repeated
        for detection in detections:
            if detection.unit not in unit_of:
                raise InputError(
                    f"{path}:{detection.line_number}: cam_index",
                    detection.unit,
                    f"a unit that has a folder: {', '.join(unit_of)}",
                )
            if detection.class_name not in VRU_CLASSES:
                skipped[OTHER_DETECTIONS] += 1
                continue
            box = _inside(detection.box_px, form, skipped)
            if box is not None:
                found = Found(detection.class_name, box, detection.confidence)
                by_unit[unit_of[detection.unit]].setdefault(key, []).append(found)
    return by_unit, frames


def _inside(box: Box, form: RecordingFormat, skipped: Counter[str]) -> Box | None:
    """The part of a box inside the image; None, counted, if there is none."""
    x_min, y_min, x_max, y_max = box
    if x_min == x_max or y_min == y_max:
        skipped[NO_AREA] += 1
        return None
    x_min, x_max = max(x_min, 0.0), min(x_max, float(form.width_px))
    y_min, y_max = max(y_min, 0.0), min(y_max, float(form.height_px))
    if x_min >= x_max or y_min >= y_max:
        skipped[OUTSIDE] += 1
        return None
    return x_min, y_min, x_max, y_max


def _with_class(drive: Drive, labels: Mapping[str, Mapping[FrameKey, list[Label]]]) -> Drive:
    return with_class(
        drive,
        Counter(
            label.class_name
            for frames in labels.values()
            for key in drive.frames
            for label in frames.get(key, ())
        ),
    )
