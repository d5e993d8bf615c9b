"""A recording from its folder: drives, labels and detections.

Anything that would make the result wrong is an error; frames that are left out are
counted.
"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from geometry.arrays import FloatArray, IntArray, freeze
from geometry.errors import InputError, Unquoted
from geometry.phrases import Phrase

from .files import (
    VRU_CLASSES,
    Detection,
    FrameKey,
    Label,
    RecordedWorld,
    RecordingFormat,
    entries_of,
    load_format,
    read_detections,
    read_labels,
    read_world,
)
from .formats import STUDY, find_format

NO_WORLD = Phrase("frames without WorldData")
OTHER_LABELS = Phrase("labels of other classes")
OTHER_DETECTIONS = Phrase("detections of other classes")
OUTSIDE = Phrase("boxes outside the image")
NO_AREA = Phrase("boxes without area")
REPEATED = Phrase("lines that repeat others")
OTHER_NAMES = Phrase("files and folders with other names")
RESETS = "frames between drives (bodies back at their starts)"
TOO_SHORT = "frames of drives too short to tell their motion"
NO_APPROACH = "frames of drives in which nothing approaches"
MISFITS = "frames of drives whose distance does not fall as their speeds ask"

UNSEEN = "unseen"
"""Class of a VRU that no unit has a label of."""

_FRAME_NAME = re.compile(r"(0|[1-9]\d{0,8})_(0|[1-9]\d{0,8})\.txt", re.ASCII)
_UNIT_NAME = re.compile(r"0|[1-9]\d{0,8}", re.ASCII)
# Images and points of the frames.
_OF_FRAMES = (".png", ".bin")


# ---------- drives: frames of a scenario up to the impact
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """Frames of one scenario at one speed, up to the impact.

    Attributes
    ----------
    scenario : int
        Index in the recording.
    vru_class : str
        "pedestrian", "bicycle", or "unseen".
    vut_speed_mps, vru_speed_mps : float
        Target speeds. [m/s]
    closing_speed_mps : float
        At which the distance falls in the last second before the impact. [m/s]
    first_number : int
        Frame number of the first frame; the others follow one by one.
    distance_m : (n_frames,) float
        Between the origins of VUT and VRU; the last one is that of the impact. NaN for
        a frame that is missing. [m]
    """

    scenario: int
    vru_class: str
    vut_speed_mps: float
    vru_speed_mps: float
    closing_speed_mps: float
    first_number: int
    distance_m: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "distance_m", freeze(self.distance_m))

    @property
    def n_frames(self) -> int:
        """Number of frames, including missing ones."""
        return len(self.distance_m)

    @property
    def n_missing(self) -> int:
        """Number of frames that are missing."""
        return int(np.isnan(self.distance_m).sum())

    @property
    def frames(self) -> tuple[FrameKey, ...]:
        """Keys of all frames."""
        return tuple(
            FrameKey(self.scenario, self.first_number + index)
            for index in range(self.n_frames)
        )

    def __repr__(self) -> str:
        return (
            f"Drive(scenario {self.scenario}, {self.vru_class}, {self.n_frames} frames)"
        )


def cut_drives(
    world: Mapping[FrameKey, RecordedWorld], form: RecordingFormat
) -> tuple[list[Drive], Counter[str]]:
    """Cut the frames of a recording into drives, and count the others by reason.

    Within a scenario a drive is a sequence of frames with the same target speeds. Where
    the distance rises by more than these allow, the bodies were put back and another
    drive begins, as it does where many frames are missing. The impact is the frame of
    the smallest distance; what follows does not belong to the drive, nor do frames
    after a reset in which the bodies still stand. Classes are still "unseen".
    """
    drives: list[Drive] = []
    left_out: Counter[str] = Counter()
    # Frames of a scenario with the same target speeds.
    for _, group in groupby(
        sorted(world), key=lambda key: (key.scenario, *world[key][1:])
    ):
        frames = list(group)
        for part, is_after_reset in _between_resets(frames, world, form):
            result = _drive(part, world, form, is_after_reset=is_after_reset)
            if isinstance(result, Drive):
                drives.append(result)
                left_out[RESETS] += len(part) - (result.n_frames - result.n_missing)
            else:
                left_out[result] += len(part)
    return drives, +left_out


def with_class(drive: Drive, votes: Counter[str]) -> Drive:
    """The drive with the class of VRU that most of its labels have.

    A rider may be labelled as well as the bicycle: if both are as frequent it is a
    bicycle's drive.
    """
    if not votes:
        return drive
    most = max(votes, key=lambda name: (votes[name], name == "bicycle"))
    return replace(drive, vru_class=most)


def _between_resets(
    frames: list[FrameKey],
    world: Mapping[FrameKey, RecordedWorld],
    form: RecordingFormat,
) -> Iterator[tuple[list[FrameKey], bool]]:
    """Parts of a sequence of frames, and whether another part comes before."""
    distance, numbers = _laid_out(frames, world)
    _, vut_speed, vru_speed = world[frames[0]]
    # A cut where the distance rises too much, or many frames are missing.
    fastest_m = (vut_speed + vru_speed) * np.diff(numbers) / form.frame_rate_hz
    is_cut = np.diff(distance) > fastest_m + form.jump_m
    is_cut |= np.diff(numbers) > form.max_gap_s * form.frame_rate_hz
    for first, last in pairwise(
        [0, *(np.flatnonzero(is_cut) + 1).tolist(), len(frames)]
    ):
        yield frames[first:last], first > 0


def _drive(
    frames: list[FrameKey],
    world: Mapping[FrameKey, RecordedWorld],
    form: RecordingFormat,
    *,
    is_after_reset: bool,
) -> Drive | str:
    """The drive in a part, or the reason why there is none."""
    distance, numbers = _laid_out(frames, world)
    _, vut_speed, vru_speed = world[frames[0]]
    impact = int(np.argmin(distance))
    first = 0
    # Without the frames in which the bodies stand at their starts, but the last.
    if is_after_reset:
        has_moved = np.abs(distance - distance[0]) > form.standing_m
        if has_moved.any():
            first = int(np.argmax(has_moved)) - 1
        else:
            first = len(distance) - 1
    # Motion is read from the last frames before the impact.
    n_window = round(form.window_s * form.frame_rate_hz)
    is_near = (numbers >= numbers[impact] - n_window) & (numbers < numbers[impact])
    is_near[:first] = False
    if is_near.sum() + 1 < form.min_frames:
        never_nears = impact <= first and len(frames) >= form.min_frames
        if is_after_reset:
            return RESETS
        if never_nears:
            return NO_APPROACH
        return TOO_SHORT
    # Without the frame of the impact: there the bodies have pushed each other already.
    closing = closing_speed_mps(
        numbers[is_near] / form.frame_rate_hz, distance[is_near]
    )
    if closing < form.min_closing_speed_mps:
        if is_after_reset:
            return RESETS
        return NO_APPROACH
    # The closing speed must fit the target speeds.
    slowest = abs(vut_speed - vru_speed)
    fastest = vut_speed + vru_speed
    tolerance = form.speed_tolerance
    if not (1.0 - tolerance) * slowest <= closing <= (1.0 + tolerance) * fastest:
        return MISFITS
    # Missing frames are NaN.
    laid_out = np.full(numbers[impact] - numbers[first] + 1, np.nan)
    laid_out[numbers[first : impact + 1] - numbers[first]] = distance[
        first : impact + 1
    ]
    return Drive(
        scenario=frames[0].scenario,
        vru_class=UNSEEN,
        vut_speed_mps=vut_speed,
        vru_speed_mps=vru_speed,
        closing_speed_mps=closing,
        first_number=int(numbers[first]),
        distance_m=laid_out,
    )


def _laid_out(
    frames: list[FrameKey], world: Mapping[FrameKey, RecordedWorld]
) -> tuple[FloatArray, IntArray]:
    """Distances and numbers of frames."""
    distance = np.array([world[key].distance_m for key in frames])
    return distance, np.array([key.number for key in frames], dtype=np.int64)


def closing_speed_mps(time_s: FloatArray, distance_m: FloatArray) -> float:
    """Speed at which a distance falls, by least squares.

    It is minus the slope of the line through the distances.

    >>> round(closing_speed_mps(np.array([-0.2, -0.1]), np.array([6.0, 5.5])), 9)
    5.0
    """
    time = time_s - time_s.mean()
    return -float(time @ (distance_m - distance_m.mean()) / (time @ time))


# ---------- the folder
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
    detections : mapping of str to mapping of FrameKey to list of Detection
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
    detections: Mapping[str, Mapping[FrameKey, list[Detection]]]
    n_frames: int
    skipped: Mapping[str, int]

    @property
    def n_missing(self) -> int:
        """Frames that are missing within drives."""
        return sum(drive.n_missing for drive in self.drives)

    def __repr__(self) -> str:
        return (
            f"Recording({self.folder.name!r}: {len(self.units)} units,"
            f" {len(self.drives)} drives, {self.n_frames} frames)"
        )


def read_recording(folder: Path) -> Recording:
    """Read a folder in the format of the released CarlaNCAP data.

    What is left out is counted. It has unit folders ``0``, ``1``.. and ``car``,
    ``WorldData`` and ``Eval``. In ``Eval``, cam_index is the name of a unit's
    folder; where there is no unit folder ``12``, that number means the VUT's
    camera, as -1 does: the release does not say which it uses. Raises InputError if
    a folder is missing or holds no frame, a line is not what it should be, Eval
    names a unit that has no folder, or nothing remains that could be judged.
    """
    name = find_format(folder)
    if name != STUDY:
        expected = (
            "the study's folder, which has a car that brakes (detector fit reads"
            " others)"
        )
        raise InputError(str(folder), Unquoted(name), expected)
    form = load_format()
    skipped: Counter[str] = Counter()
    units, has_vut = _find_units(folder, form, skipped)
    if has_vut:
        names = [*units, form.vut_folder]
    else:
        names = [*units]
    # WorldData tells the distance in every frame.
    world = {}
    for key, path in _frames(folder / form.world_folder, skipped):
        world[key], n_repeated = read_world(path, form)
        skipped[REPEATED] += n_repeated
    labels = {name: _read_all_labels(folder / name, form, skipped) for name in names}
    detections, evaluated = _read_all_detections(folder, names, form, skipped)
    skipped[NO_WORLD] += len(set(evaluated).union(*labels.values()).difference(world))
    # Drives follow from the distances alone; labels tell their class.
    drives, left_out = cut_drives(world, form)
    skipped += left_out
    if not drives:
        raise InputError(
            str(folder),
            Unquoted(
                "no drive; " + ", ".join(f"{n} {why}" for why, n in skipped.items())
            ),
            "frames in which the VUT and a VRU come together",
        )

    def votes(drive: Drive) -> Counter[str]:
        of_units = [
            frames.get(key, ()) for frames in labels.values() for key in drive.frames
        ]
        return Counter(label.class_name for found in of_units for label in found)

    return Recording(
        folder=folder,
        units=tuple(units),
        has_vut=has_vut,
        drives=tuple(with_class(drive, votes(drive)) for drive in drives),
        labels=labels,
        detections=detections,
        n_frames=len(world),
        skipped=dict(+skipped),
    )


def _find_units(
    folder: Path, form: RecordingFormat, skipped: Counter[str]
) -> tuple[list[str], bool]:
    """Names of the unit folders, and if the VUT's camera is recorded."""
    entries = entries_of(folder, "a folder with a recording")
    names = {entry.name for entry in entries if entry.is_dir()}
    for name in (form.world_folder, form.eval_folder):
        if name not in names:
            raise InputError(
                str(folder / name), Unquoted("nothing"), "a folder with frames"
            )
    units = sorted((name for name in names if _UNIT_NAME.fullmatch(name)), key=int)
    if not units:
        raise InputError(
            str(folder),
            Unquoted("no unit"),
            "a folder named 0, 1 .. for each roadside unit",
        )
    # Anything else in the folder is counted.
    known = {*units, form.vut_folder, form.world_folder, form.eval_folder}
    skipped[OTHER_NAMES] += len({entry.name for entry in entries} - (known & names))
    return units, form.vut_folder in names


def _frames(folder: Path, skipped: Counter[str]) -> Iterator[tuple[FrameKey, Path]]:
    """Frames of a folder, in order."""
    found = {}
    for path in entries_of(folder, "a folder that can be read"):
        match = _FRAME_NAME.fullmatch(path.name)
        if match:
            found[FrameKey(int(match[1]), int(match[2]))] = path
        elif path.suffix not in _OF_FRAMES:
            skipped[OTHER_NAMES] += 1
    if not found:
        raise InputError(str(folder), Unquoted("no frame"), "files SCENARIO_FRAME.txt")
    for key in sorted(found):
        yield key, found[key]


def _read_all_labels(
    folder: Path, form: RecordingFormat, skipped: Counter[str]
) -> dict[FrameKey, list[Label]]:
    """Labels of VRUs; a frame without any has an empty list."""
    frames: dict[FrameKey, list[Label]] = {}
    for key, path in _frames(folder, skipped):
        labels, n_repeated = read_labels(path, form)
        skipped[REPEATED] += n_repeated
        frames[key] = list(_of_vrus(labels, OTHER_LABELS, form, skipped))
    return frames


def _read_all_detections(
    folder: Path, names: list[str], form: RecordingFormat, skipped: Counter[str]
) -> tuple[dict[str, dict[FrameKey, list[Detection]]], list[FrameKey]]:
    """Detections of VRUs per unit, and the frames for which there is a file."""
    by_unit: dict[str, dict[FrameKey, list[Detection]]] = {name: {} for name in names}
    unit_of = {name: name for name in names}
    if form.vut_folder in names:
        unit_of = dict.fromkeys(form.vut_indices, form.vut_folder) | unit_of
    frames = []
    # Detections must be of units that have a folder.
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
        for detection in _of_vrus(detections, OTHER_DETECTIONS, form, skipped):
            by_unit[unit_of[detection.unit]].setdefault(key, []).append(detection)
    return by_unit, frames


def _of_vrus(
    boxes: Iterable[Any], others: str, form: RecordingFormat, skipped: Counter[str]
) -> Iterator[Any]:
    """Boxes of VRUs, clipped to the image.

    Anything else is counted and left out.
    """
    for one in boxes:
        box = one.box_px
        low = max(box[0], 0.0), max(box[1], 0.0)
        high = min(box[2], float(form.width_px)), min(box[3], float(form.height_px))
        if one.class_name not in VRU_CLASSES:
            skipped[others] += 1
        elif box[0] == box[2] or box[1] == box[3]:
            skipped[NO_AREA] += 1
        elif low[0] >= high[0] or low[1] >= high[1]:
            skipped[OUTSIDE] += 1
        else:
            yield one._replace(box_px=(*low, *high))
