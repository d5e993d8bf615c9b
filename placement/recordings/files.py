"""The study's folder layout: files read line by line, folders written.

Reading is strict: every error names file, line and field.
"""

import itertools
import math
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from uuid import uuid4

from geometry.arrays import FloatArray, float_array
from geometry.errors import InputError, Unquoted, check_one_of
from geometry.opening import read_bytes, read_text, reading
from geometry.tables import read_table
from geometry.text_formats import load_data, parse_json, parse_number
from geometry.writing import write_new

# That are read; other road users are only written.
VRU_CLASSES = (
    "pedestrian",
    "bicycle",
)
_MOST_FRAMES = 100_000_000
_SIDES = ("min_x", "min_y", "max_x", "max_y")
_WRITTEN = (*VRU_CLASSES, "motorcycle", "car")
Box = tuple[float, float, float, float]


class FrameKey(NamedTuple):
    """Scenario and number of a frame, as in a file's name SCENARIO_FRAME.txt.

    Attributes
    ----------
    scenario : int
        Index of the scenario in the recording.
    number : int
        Runs on over all drives of the scenario.
    """

    scenario: int
    number: int

    @property
    def file_name(self) -> str:
        """Name of the frame's text files."""
        return f"{self.scenario}_{self.number}.txt"


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingFormat:
    """The study's folder layout, and how motion is read from it.

    It is the content of ``carla_ncap_format.toml``.

    Attributes
    ----------
    width_px : int
        Width of the images. [px]
    height_px : int
        Height of the images. [px]
    frame_rate_hz : float
        Frames per second. [Hz]
    n_reset_frames : int
        Between two drives.
    vut_folder : str
        All other folders are units and have a number for a name.
    world_folder : str
        Folder of the distances and speeds.
    eval_folder : str
        Folder of the detections.
    vut_indices : tuple of str
        What stands for the VUT in Eval.
    label_fields : tuple of str
        Fields of a line with a label.
    world_fields : tuple of str
        Fields of a line in the world folder.
    eval_fields : tuple of str
        Fields of a line with a detection.
    actor_types : mapping of str to str
        Spelling to "pedestrian", "bicycle" or "other".
    window_s : float
        Time before the impact in which motion is read. This and the following
        are those of the section `motion`. [s]
    min_frames : int
        Least frames in that window, the impact included.
    min_closing_speed_mps : float
        Least speed at which the distance falls; else nothing approaches. [m/s]
    max_same_direction_deg : float
        Largest angle between the paths of a VRU that goes the VUT's way. [deg]
    speed_tolerance : float
        Deviation of the closing speed from the target speeds, relative.
    jump_m : float
        The bodies were put back if the distance rises by this more than the
        speeds allow. [m]
    max_gap_s : float
        Longest gap of missing frames within a drive. [s]
    standing_m : float
        The bodies stand while the distance has changed by less since the reset.
        [m]
    """

    width_px: int
    height_px: int
    frame_rate_hz: float
    n_reset_frames: int
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
    file = "carla_ncap_format.toml"
    table = load_data(__package__, file)
    return read_table({**table, **table["motion"]}, RecordingFormat, file)


class Label(NamedTuple):
    """Where an actor is in a unit's image.

    Attributes
    ----------
    class_name : str
        "pedestrian", "bicycle" or "other".
    box_px : Box
        Of the visible pixels.
    distance_m : float
        From the unit.
    """

    class_name: str
    box_px: Box
    distance_m: float


class Detection(NamedTuple):
    """A detection in a unit's image.

    Attributes
    ----------
    unit : str
        As in the file.
    class_name : str
        "pedestrian", "bicycle" or "other".
    box_px : Box
        Box around what was found. [px]
    confidence : float
        0 .. 1.
    line_number : int
        Line of the file, from 1.
    """

    unit: str
    class_name: str
    box_px: Box
    confidence: float
    line_number: int


class RecordedWorld(NamedTuple):
    """How the bodies move in a frame.

    Attributes
    ----------
    distance_m : float
        Between the origins of VUT and VRU.
    vut_speed_mps : float
        Target speed of the VUT in the drive: the bodies may still stand. [m/s]
    vru_speed_mps : float
        Target speed of the VRU. [m/s]
    """

    distance_m: float
    vut_speed_mps: float
    vru_speed_mps: float


# ---------- folders, JSON, lines of text
def entries_of(folder: Path, expected: str) -> list[Path]:
    """Entries of a folder.

    Raises InputError, with what is expected, where it cannot be read.
    """
    with reading(folder, expected, OSError):
        return list(folder.iterdir())


def json_of(path: Path, **limits: int) -> Any:
    """Content of a JSON file.

    `limits` are those of :func:`geometry.opening.read_bytes`.
    """
    return parse_json(read_bytes(path, **limits), str(path), "a JSON file")


@dataclass(frozen=True, slots=True)
class Fields:
    """The fields of a line, or of an element of XML, taken by name.

    Attributes
    ----------
    place : str
        File and line, or file and words.
    words : mapping of str to str
        Text of each field, by its name.
    line : int
        Of a file that has lines.
    """

    place: str
    words: Mapping[str, str]
    line: int = 0

    def number(self, name: str, *, least: float = -1.0e9, most: float = 1.0e9) -> float:
        """Number of a field.

        Raises InputError unless it lies between `least` and `most`.
        """
        where = f"{self.place}: {name}"
        if name not in self.words:
            raise InputError(where, Unquoted("nothing"), "a number")
        return parse_number(self.words[name], where, least=least, most=most)

    def whole(self, name: str, *, least: int = -1, most: int = _MOST_FRAMES) -> int:
        """A field's whole number; raises InputError as :meth:`number` does."""
        value = self.number(name, least=least, most=most)
        if value != int(value):
            raise InputError(
                f"{self.place}: {name}", self.words[name], "a whole number"
            )
        return int(value)

    def box(self, names: Sequence[str], *, most: float = 1.0e9) -> Box:
        """A box of the four fields that are named."""
        left, top, right, bottom = (
            self.number(name, least=-most, most=most) for name in names
        )
        return left, top, right, bottom


def read_lines(
    path: Path, names: Sequence[str], *, separator: str | None, least: int | None = None
) -> Iterator[Fields]:
    """Lines of a text file that are not empty, cut into fields.

    Raises InputError where a line has fewer than `least` fields (by default all that
    are named), or more than are named: a file that was cut off ends in such a line.
    """
    if least is None:
        fewest = len(names)
    else:
        fewest = least
    # Lines count from 1.
    for line, text in enumerate(read_text(path, "text").splitlines(), start=1):
        words = [word.strip() for word in text.strip().split(separator)]
        if not any(words):
            continue
        if not fewest <= len(words) <= len(names):
            if fewest == len(names):
                count = f"{fewest}"
            else:
                count = f"{fewest} to {len(names)}"
            what = f"{count} fields: {(separator or ' ').join(names)}"
            raise InputError(f"{path}:{line}", Unquoted(f"{len(words)} fields"), what)
        yield Fields(f"{path}:{line}", dict(zip(names, words, strict=False)), line)


def read_labels(path: Path, form: RecordingFormat) -> tuple[list[Label], int]:
    """Labels of a unit's frame, and how many lines repeat others.

    The file is ``UNIT/SCENARIO_FRAME.txt``. The file is empty where nothing is in
    view; boxes may extend beyond the image. Lines repeat because the generator
    opens its files for appending.
    """
    rows, n_repeated = _distinct(path, form.label_fields)
    return [
        Label(
            _class(row, form), _box(row), row.number("dist", least=0.0, most=math.inf)
        )
        for row in rows
    ], n_repeated


def read_detections(path: Path, form: RecordingFormat) -> tuple[list[Detection], int]:
    """Detections of all units, and how many lines repeat others.

    The file is ``Eval/SCENARIO_FRAME.txt``.
    """
    rows, n_repeated = _distinct(path, form.eval_fields)
    return [
        Detection(
            unit=row.words["cam_index"],
            class_name=_class(row, form),
            box_px=_box(row),
            confidence=row.number("confidence", least=0.0, most=1.0),
            line_number=row.line,
        )
        for row in rows
    ], n_repeated


def read_world(path: Path, form: RecordingFormat) -> tuple[RecordedWorld, int]:
    """Distance and speeds of a frame, and how often they repeat.

    The file is ``WorldData/SCENARIO_FRAME.txt``. The generator ends the line
    without a line break: a frame that is recorded twice reads ``12.5 5.6 1.412.5
    5.6 1.4``. Different numbers in a file are an error.
    """
    text = read_text(path, "text").strip()
    once, n_repeated = _once(text, len(form.world_fields))
    fields = once.split()
    if len(fields) != len(form.world_fields):
        raise InputError(
            f"{path}:1",
            text,
            f"{' '.join(form.world_fields)}, once or repeated exactly",
        )
    distance, vut_speed, vru_speed = fields
    world = RecordedWorld(
        distance_m=parse_number(distance, f"{path}:1: dist", least=0.0),
        vut_speed_mps=parse_number(vut_speed, f"{path}:1: car_speed"),
        vru_speed_mps=parse_number(vru_speed, f"{path}:1: vru_speed", least=0.0),
    )
    if world.vut_speed_mps <= 0.0:
        raise InputError(
            f"{path}:1: car_speed", world.vut_speed_mps, "m/s, more than 0"
        )
    return world, n_repeated


def _once(text: str, n_fields: int) -> tuple[str, int]:
    """First `n_fields` words of a text that may repeat them.

    The second value says how often it does.
    """
    lines = [line.strip() for line in text.splitlines()]
    if len(lines) > 1 and len(set(lines)) == 1:
        return lines[0], len(lines) - 1
    # The text may be a whole number of repetitions without a break between.
    for n_times in range(2, len(text.split())):
        length, rest = divmod(len(text), n_times)
        part = text[:length]
        if rest == 0 and part * n_times == text and len(part.split()) == n_fields:
            return part, n_times - 1
    return text, 0


def _distinct(path: Path, names: Sequence[str]) -> tuple[list[Fields], int]:
    """Distinct lines of a file, cut into fields, and how many lines repeat others."""
    rows = list(read_lines(path, names, separator=None))
    first: dict[tuple[str, ...], Fields] = {}
    for row in rows:
        first.setdefault(tuple(row.words.values()), row)
    return list(first.values()), len(rows) - len(first)


def _class(row: Fields, form: RecordingFormat) -> str:
    word = row.words["actor_type"]
    check_one_of(f"{row.place}: actor_type", word, form.actor_types)
    return form.actor_types[word]


def _box(row: Fields) -> Box:
    """Box of a row; InputError if a side is on the wrong side."""
    x_min, y_min, x_max, y_max = row.box(_SIDES, most=math.inf)
    if x_max < x_min or y_max < y_min:
        got = Unquoted(" ".join(row.words[name] for name in _SIDES))
        raise InputError(f"{row.place}: box", got, "min_x <= max_x and min_y <= max_y")
    return x_min, y_min, x_max, y_max


# ---------- writing
# As the study's paper spells it.
_BICYCLE = "bycicle"
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
        "pedestrian", "bicycle", "motorcycle" or "car".
    vut_speed_mps, vru_speed_mps : float
        Target speeds. [m/s]
    distance_m : (n_frames,) float
        Between the origins of VUT and VRU; the last frame is that of the
        impact. [m]
    labels_px, detections_px : mapping of str to (n_frames, 4) float
        Per unit, by the name of its folder, the VRU's box and what was found; a
        box without area stands for none. [px]
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
        check_one_of("vru_class", self.vru_class, _WRITTEN)
        object.__setattr__(
            self, "distance_m", float_array(self.distance_m, (-1,), "distance_m")
        )
        n_frames = len(self.distance_m)
        units = list(self.labels_px)
        for name, shape in (
            ("labels_px", (n_frames, 4)),
            ("detections_px", (n_frames, 4)),
            ("label_distance_m", (n_frames,)),
        ):
            arrays = getattr(self, name)
            if list(arrays) != units:
                raise InputError(name, list(arrays), f"the units of labels_px: {units}")
            checked = {
                unit: float_array(array, shape, f"{name}[{unit}]")
                for unit, array in arrays.items()
            }
            object.__setattr__(self, name, checked)


def write_recording(
    folder: Path,
    drives: Sequence[WrittenDrive],
    *,
    n_reset_frames: int | None = None,
    also: Mapping[str, str] | None = None,
) -> None:
    """Write drives as the study's generator does, whole or not at all.

    All drives have the same units. Frame numbers run on over all drives. After each
    drive there are `n_reset_frames` frames, by default as many as the generator's,
    with the bodies back at their starts, as in its first frame. `also` are other
    files that shall be there, with their text. Raises InputError if units differ,
    or the folder is not empty or not writable.
    """
    form = load_format()
    if not drives:
        raise InputError("drives", Unquoted("none"), "at least one")
    units = list(drives[0].labels_px)
    for drive in drives:
        if list(drive.labels_px) != units:
            raise InputError(
                "units", list(drive.labels_px), f"those of the first drive: {units}"
            )
    if n_reset_frames is None:
        n_resets = form.n_reset_frames
    else:
        n_resets = n_reset_frames
    write_folder(
        folder,
        itertools.chain(_files(drives, form, n_resets), (also or {}).items()),
        folders=(*units, form.world_folder, form.eval_folder),
    )


def write_folder(
    folder: Path, texts: Iterable[tuple[str, str]], *, folders: Iterable[str] = ()
) -> None:
    """Write a new folder of text files, whole or not at all.

    `folders` are made in it before. Raises InputError if the folder is not empty or
    not writable.
    """
    temporary = folder.with_name(f".{folder.name}.{uuid4().hex}.tmp")
    with ExitStack() as stack, reading(folder, "a folder that can be written", OSError):
        if folder.exists() and any(folder.iterdir()):
            raise InputError(
                str(folder), Unquoted("a folder that is not empty"), "a new one"
            )
        # Write into a temporary folder, and rename it at the end.
        stack.callback(shutil.rmtree, temporary, ignore_errors=True)
        temporary.mkdir(parents=True)
        for name in folders:
            (temporary / name).mkdir(parents=True)
        for file_name, text in texts:
            write_new(temporary / file_name, text)
        # Onto an empty folder, too.
        temporary.rename(folder)


def _files(
    drives: Sequence[WrittenDrive], form: RecordingFormat, n_resets: int
) -> Iterator[tuple[str, str]]:
    """Names relative to the folder, and contents."""
    number = 0
    for drive in drives:
        if drive.vru_class == "bicycle":
            actor = _BICYCLE
        else:
            actor = drive.vru_class
        # After the drive, the frames in which the bodies are back at their starts.
        for frame in [*range(len(drive.distance_m)), *[0] * n_resets]:
            name = FrameKey(drive.scenario, number).file_name
            number += 1
            yield (
                f"{form.world_folder}/{name}",
                _words(
                    drive.distance_m[frame], drive.vut_speed_mps, drive.vru_speed_mps
                ),
            )
            found = []
            for unit, labels_px in drive.labels_px.items():
                label = labels_px[frame]
                detection = drive.detections_px[unit][frame]
                distance_m = drive.label_distance_m[unit][frame]
                if _has_area(label):
                    text = f"{actor} {_words(*label, distance_m)}\n"
                else:
                    text = ""
                yield f"{unit}/{name}", text
                if _has_area(detection):
                    found.append(f"{unit} {actor} {_words(*detection, CONFIDENCE)}\n")
            yield f"{form.eval_folder}/{name}", "".join(found)


def _words(*numbers: float) -> str:
    return " ".join(str(float(number)) for number in numbers)


def _has_area(box_px: FloatArray) -> bool:
    return bool(box_px[2] > box_px[0] and box_px[3] > box_px[1])
