"""Boxes of recordings in other formats, and which format it is.

MOT challenge: https://motchallenge.net/instructions; frames count from 1 in files, from
0 here. KITTI: A. Geiger et al., "Vision meets robotics: the KITTI dataset", 2013, and
its development kit; RRC as in DeepFusionMOT, PointRCNN as in AB3DMOT. CVML: T. List, R.
Fisher, "CVML - an XML-based computer vision markup language", 2004. WILDTRACK: T.
Chavdarova et al., "WILDTRACK: a multi-camera HD dataset for dense unscripted pedestrian
detection", 2018; places are cells of a grid.
"""

import re
import stat
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.errors import InputError, Unquoted, check_one_of
from geometry.opening import read_text, reading
from geometry.tables import read_table
from geometry.xml_files import read_xml

from .files import Box, Fields, entries_of, json_of, load_format, read_lines

IGNORE = "ignore"
"""Class of a region without annotations: what is found there does not count."""

JUMPS = "tracks that jump"
_MOST_HEIGHTS = 8.0
"""Most of its heights that a box's middle moves on in a frame; more is a jump.

An assumption: the most in PETS (7 Hz) is 0.1, in KITTI's even sequences (10 Hz) 3.2, in
WILDTRACK (2 Hz) 5.8.
"""

_NOWHERE = (np.nan, np.nan, np.nan)


class BoxRow(NamedTuple):
    """A box in a file, and where it stands there: a line, or words.

    Attributes
    ----------
    place : str
        File, and line or words.
    frame : int
        Number of the frame, from 0.
    class_name : str
        "pedestrian", "cyclist", "car", "other" or "ignore".
    box_px : Box
        Left, upper, right, lower side. [px]
    track : int
        Number of the track; -1: not said.
    score : float
        Score of a detector; NaN where the box is annotated.
    seen_share : float
        Share that nothing hides, 0 .. 1; NaN: not said.
    hidden_level : int
        KITTI's: 0 in view, 1 partly, 2 largely hidden; -1: not said.
    position_m : (float, float, float)
        Middle of the body's foot in the recording's frame; NaN: not said. [m]
    """

    place: str
    frame: int
    class_name: str
    box_px: Box
    track: int = -1
    score: float = np.nan
    seen_share: float = np.nan
    hidden_level: int = -1
    position_m: tuple[float, float, float] = _NOWHERE


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedBoxes:
    """Boxes (n) in a camera's frames: annotated, or found by a detector.

    Attributes
    ----------
    source : str
        File that they come from.
    frame : (n,) int
        From 0; consecutive numbers are consecutive frames.
    class_name : tuple of str
        Class of each box, as of :class:`BoxRow`.
    box_px : (n, 4) float
        Left, upper, right, lower side; without area: not in view. [px]
    track : (n,) int
        Whose box it is; -1: not said.
    score : (n,) float
        A detector's; not a number where it is annotated.
    seen_share : (n,) float
        That nothing hides; not a number where it is not said.
    hidden_level : (n,) int
        KITTI's: 0 in view, 1 partly, 2 largely hidden; -1: not said.
    position_m : (n, 3) float
        Middle of the body's foot in the recording's own frame; not a number:
        not said. [m]
    left_out : mapping of str to int
        What is not among them, how often.
    """

    source: str
    frame: IntArray
    class_name: tuple[str, ...]
    box_px: FloatArray
    track: IntArray
    score: FloatArray
    seen_share: FloatArray
    hidden_level: IntArray
    position_m: FloatArray
    left_out: Mapping[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.frame)

    def is_class(self, *names: str) -> BoolArray:
        """Boxes of some classes, (n,)."""
        return np.isin(np.array(self.class_name, dtype=str), names)

    def take(self, rows: IntArray | BoolArray) -> "RecordedBoxes":
        """Some of the boxes, by index or mask."""
        index = np.arange(len(self))[rows]
        values = {name: getattr(self, name) for name in self.__slots__}
        arrays: dict[str, Any] = {
            name: one[index]
            for name, one in values.items()
            if isinstance(one, np.ndarray)
        }
        names = tuple(self.class_name[one] for one in index.tolist())
        return replace(self, class_name=names, **arrays)


def gather_boxes(path: Path, rows: Iterable[BoxRow]) -> RecordedBoxes:
    """The boxes of a file's rows, in their order, without tracks that jump.

    Raises InputError, with the row's place: a frame before that of the row above (of
    the same track, where there are tracks), a negative width or height, numbers out of
    range.
    """
    # Rows are checked in the order of the file.
    kept = list(rows)
    last: dict[int, int] = {}
    for row in kept:
        before = last.get(row.track, -1)
        # A track is once in a frame; a detector finds several things in one.
        if row.frame < before or (row.track >= 0 and row.frame == before):
            if row.track >= 0:
                what = f"of track {row.track}, once each, "
            else:
                what = ""
            raise InputError(
                row.place, Unquoted(f"frame {row.frame}"), f"frames {what}in order"
            )
        last[row.track] = row.frame
        left, top, right, bottom = row.box_px
        if right < left or bottom < top:
            got = Unquoted(f"{right - left:g} x {bottom - top:g} px")
            raise InputError(
                f"{row.place}: box", got, "a width and a height, at least 0"
            )

    def column(name: str, kind: type, *size: int) -> Any:
        return freeze(
            np.array([getattr(row, name) for row in kept], kind).reshape(-1, *size)
        )

    boxes = RecordedBoxes(
        source=str(path),
        class_name=tuple(row.class_name for row in kept),
        **{name: column(name, np.int64) for name in ("frame", "track", "hidden_level")},
        **{name: column(name, np.float64) for name in ("score", "seen_share")},
        box_px=column("box_px", np.float64, 4),
        position_m=column("position_m", np.float64, 3),
    )
    jumping = _jumping(boxes)
    if not len(jumping):
        return boxes
    return replace(
        boxes.take(~np.isin(boxes.track, jumping)), left_out={JUMPS: len(jumping)}
    )


def _jumping(boxes: RecordedBoxes) -> IntArray:
    """Tracks that move on too far between two of their boxes."""
    left, top, right, bottom = boxes.box_px.T
    # Boxes of tracks with an area, track by track.
    rows = np.flatnonzero((boxes.track >= 0) & (right > left) & (bottom > top))
    rows = rows[np.argsort(boxes.track[rows], kind="stable")]
    before = rows[:-1]
    after = rows[1:]
    # How far the middle moved, compared with the height and the frames between.
    moved = 0.5 * np.hypot(np.diff((left + right)[rows]), np.diff((top + bottom)[rows]))
    height = np.maximum((bottom - top)[before], (bottom - top)[after])
    is_same = boxes.track[before] == boxes.track[after]
    is_far = moved > _MOST_HEIGHTS * height * (boxes.frame[after] - boxes.frame[before])
    return np.unique(boxes.track[after[is_same & is_far]])


# ---------- MOT challenge: annotated tracks (gt.txt) and detections (det.txt)
_MOT = (
    "frame",
    "id",
    "left",
    "top",
    "width",
    "height",
    "conf",
    "class",
    "visibility",
    "z",
)
# The rest is -1, or missing.
_MOT_LEAST = 7
# Fields from 2016 on; in 2015 there were x, y, z in their place.
_WITH_CLASSES = 9
_PEDESTRIAN = 1
# Ignored: riders, statues, reflections.
_MOT_OTHERS = {3: "car", 2: IGNORE, 7: IGNORE, 8: IGNORE, 12: IGNORE}


def mot_rows(path: Path) -> Iterator[BoxRow]:
    """Rows of a file of MOT challenge.

    Boxes with an id are annotated, and ignored if their flag is 0; others were
    found.
    """
    for fields in read_lines(path, _MOT, separator=",", least=_MOT_LEAST):
        frame = fields.whole("frame", least=1)
        track = fields.whole("id")
        left = fields.number("left")
        top = fields.number("top")
        box = (left, top, left + fields.number("width"), top + fields.number("height"))
        conf = fields.number("conf")
        if track < 0:
            yield BoxRow(fields.place, frame - 1, "pedestrian", box, score=conf)
            continue
        name = "pedestrian"
        seen = float("nan")
        if len(fields.words) == _WITH_CLASSES:
            kind = fields.whole("class", least=-1, most=100)
            if kind not in (_PEDESTRIAN, -1):
                name = _MOT_OTHERS.get(kind, "other")
            seen = fields.number("visibility", least=-1.0, most=1.0)
            if not (seen >= 0.0):
                seen = float("nan")
        if conf not in (0.0, 1.0):
            raise InputError(
                f"{fields.place}: conf", conf, "0 or 1 where there is an id"
            )
        if not conf:
            name = IGNORE
        yield BoxRow(fields.place, frame - 1, name, box, track=track, seen_share=seen)


# ---------- KITTI: annotated tracks, and two detectors' output
_SIDES = ("left", "top", "right", "bottom")
_PLACE = ("height", "width", "length", "x", "y", "z", "yaw")
_LABEL = ("frame", "track", "type", "truncated", "occluded", "alpha", *_SIDES, *_PLACE)
_RRC = ("frame", *_SIDES, "score")
_POINTRCNN = ("frame", "type", *_SIDES, "score", *_PLACE, "alpha")
_CLASSES = {
    "Pedestrian": "pedestrian",
    "Cyclist": "cyclist",
    "Car": "car",
    "DontCare": IGNORE,
}
_OTHERS = ("Van", "Truck", "Person", "Person_sitting", "Tram", "Misc")
_POINTRCNN_CLASSES = {1: "pedestrian", 2: "car", 3: "cyclist"}


def kitti_rows(path: Path) -> Iterator[BoxRow]:
    """Annotated road users; positions are in the frame of the rectified camera 0."""
    for fields in read_lines(path, _LABEL, separator=None):
        word = fields.words["type"]
        check_one_of(f"{fields.place}: type", word, (*_CLASSES, *_OTHERS))
        level = fields.whole("occluded", most=3)
        # The level 3 means unknown.
        if level == 3:
            level = -1
        name = _CLASSES.get(word, "other")
        yield BoxRow(
            fields.place,
            fields.whole("frame", least=0),
            name,
            fields.box(_SIDES),
            track=-1 if name == IGNORE else fields.whole("track"),
            hidden_level=level,
            position_m=_position(fields),
        )


def _position(fields: Fields) -> tuple[float, float, float]:
    x, y, z = (fields.number(name) for name in ("x", "y", "z"))
    return x, y, z


def rrc_rows(path: Path) -> Iterator[BoxRow]:
    """Pedestrians found by RRC in a sequence, a file a class: frame, box, score."""
    for fields in read_lines(path, _RRC, separator=","):
        frame = fields.whole("frame", least=0)
        score = fields.number("score", least=0.0, most=1.0)
        yield BoxRow(fields.place, frame, "pedestrian", fields.box(_SIDES), score=score)


def pointrcnn_rows(path: Path) -> Iterator[BoxRow]:
    """Road users found by PointRCNN in a sequence; scores are logits, 0 is a half."""
    for fields in read_lines(path, _POINTRCNN, separator=","):
        kind = fields.whole("type", least=1, most=3)
        yield BoxRow(
            fields.place,
            fields.whole("frame", least=0),
            _POINTRCNN_CLASSES[kind],
            fields.box(_SIDES),
            score=fields.number("score"),
            position_m=_position(fields),
        )


# ---------- CVML
def cvml_rows(path: Path) -> Iterator[BoxRow]:
    """Rows of a CVML file: annotated people.

    Frames are in order, and all as far apart (one frame rate).
    """
    root = read_xml(path, expected="CVML")
    if root.tag != "dataset":
        raise InputError(str(path), root.tag, "CVML: an element <dataset> with frames")
    step: int | None = None
    last: int | None = None
    # Frames must be equally far apart.
    for frame in root.iter("frame"):
        place = f"{path}: frame {frame.get('number')}"
        number = Fields(place, frame.attrib).whole("number", least=0)
        if last is not None:
            if step is None:
                step = number - last
            if number - last != step or step <= 0:
                expected = (
                    f"{last + max(step, 1)} after frame {last}: frames in order, all as"
                    " far apart"
                )
                raise InputError(place, number, expected)
        last = number
        for thing in frame.iter("object"):
            here = f"{place}, object {thing.get('id')}"
            track = Fields(here, thing.attrib).whole("id", least=0)
            box = thing.find("box")
            if box is None:
                raise InputError(here, Unquoted("no box"), "<box xc= yc= w= h=>")
            x, y, w, h = map(Fields(here, box.attrib).number, ("xc", "yc", "w", "h"))
            sides = (x - 0.5 * w, y - 0.5 * h, x + 0.5 * w, y + 0.5 * h)
            yield BoxRow(here, number, "pedestrian", sides, track=track)


# ---------- WILDTRACK: people on a square who are annotated in seven calibrated views
N_VIEWS = 7
_CELL_M = 0.025
_COLUMNS = 480
_ORIGIN_M = (-3.0, -9.0)
_NAME = re.compile(r"(\d{1,8})\.json", re.ASCII)
_Pixel = Annotated[int, Meta(ge=-100_000, le=100_000)]


class _View(msgspec.Struct, frozen=True):
    """A person's box in one view of WILDTRACK."""

    viewNum: Annotated[int, Meta(ge=0, lt=N_VIEWS)]
    xmin: _Pixel
    ymin: _Pixel
    xmax: _Pixel
    ymax: _Pixel


class _Person(msgspec.Struct, frozen=True):
    personID: Annotated[int, Meta(ge=0, le=1_000_000)]
    positionID: Annotated[int, Meta(ge=0, le=10_000_000)]
    views: tuple[_View, ...]


def read_wildtrack(folder: Path) -> tuple[RecordedBoxes, ...]:
    """Annotated people of WILDTRACK, view by view.

    A box without area means that the person is not in this view. Frames are
    numbered 0, 1, .. in the order of their files. Raises InputError if a file is
    not what it should be, views are missing, or the files' numbers are not all as
    far apart (mixed frame rates).
    """
    rows: list[list[BoxRow]] = [[] for _ in range(N_VIEWS)]
    # Each person has one entry in every view.
    for frame, path in enumerate(_files(folder)):
        for person in read_table(json_of(path), tuple[_Person, ...], str(path)):
            if sorted(view.viewNum for view in person.views) != [*range(N_VIEWS)]:
                got = Unquoted(f"{len(person.views)} views")
                expected = f"views 0 to {N_VIEWS - 1}, once each"
                raise InputError(f"{path}: person {person.personID}", got, expected)
            row, column = divmod(person.positionID, _COLUMNS)
            at_m = _ORIGIN_M[0] + _CELL_M * column, _ORIGIN_M[1] + _CELL_M * row, 0.0
            for view in person.views:
                sides = (view.xmin, view.ymin, view.xmax, view.ymax)
                is_seen = sides != (-1, -1, -1, -1)
                left, top, right, bottom = map(
                    float, sides if is_seen else (0, 0, 0, 0)
                )
                rows[view.viewNum].append(
                    BoxRow(
                        f"{path}: person {person.personID}, view {view.viewNum}",
                        frame,
                        "pedestrian",
                        (left, top, right, bottom),
                        track=person.personID,
                        position_m=at_m,
                    )
                )
    return tuple(gather_boxes(folder, of_view) for of_view in rows)


def _files(folder: Path) -> list[Path]:
    """Frames of a folder of WILDTRACK, in the order of their numbers.

    Raises InputError if there are none, two of a number, or if steps differ.
    """
    entries = entries_of(folder, "a folder with frames")
    named = [(int(m[1]), path) for path in entries if (m := _NAME.fullmatch(path.name))]
    found = dict(named)
    if len(found) < len(named):
        raise InputError(
            str(folder), Unquoted("two files of one frame"), "each frame once"
        )
    if not found:
        raise InputError(str(folder), Unquoted("no frame"), "files FRAME.json")
    numbers = sorted(found)
    steps = np.diff(numbers)
    odd = np.flatnonzero(steps != steps[:1])
    if len(odd):
        wrong = numbers[int(odd[0]) + 1]
        expected = f"numbers all {steps[0]} apart: one frame rate"
        raise InputError(str(found[wrong]), Unquoted(f"frame {wrong}"), expected)
    return [found[number] for number in numbers]


# ---------- any of them
STUDY = "study"
MOT_FOLDER = "MOT challenge's folder"
WILDTRACK = "WILDTRACK"
COCO = "COCO"
MOT_FILES = (Path("gt/gt.txt"), Path("det/det.txt"))
"""In a folder of MOT challenge: who was annotated, and what was found."""

_READERS = {
    "CVML": cvml_rows,
    "MOT challenge": mot_rows,
    "KITTI": kitti_rows,
    "RRC": rrc_rows,
    "PointRCNN": pointrcnn_rows,
}
_BY_FIELDS = {6: "RRC", 15: "PointRCNN"} | dict.fromkeys(range(7, 11), "MOT challenge")


def find_format(path: Path) -> str:
    """Name of the format of a recording, by its content.

    A folder's files, or the beginning of a file, tell it. Raises InputError, with
    the formats that are known, if it is in none of them.
    """
    with reading(path, "a recording", OSError):
        is_folder = stat.S_ISDIR(path.stat().st_mode)
        if is_folder:
            name = _of_folder(path)
        else:
            name = None
    if is_folder and name is None:
        raise _unknown(str(path), "a folder without their files")
    if name is not None:
        return name
    # The first line with words tells the format of a file.
    first = next(
        (one for one in read_text(path, "text").splitlines() if one.strip()), ""
    )
    if first.lstrip("\ufeff \t").startswith("<"):
        return "CVML"
    if first.lstrip().startswith(("{", "[")):
        return COCO
    if not first:
        # A detector that found nothing.
        return "MOT challenge"
    n_fields = len(first.split(","))
    words = first.split()
    if n_fields == 1 and len(words) > 2 and not words[2][0].isdigit():
        return "KITTI"
    if n_fields not in _BY_FIELDS:
        raise _unknown(
            f"{path}:1", f"{n_fields if n_fields > 1 else len(words)} fields"
        )
    return _BY_FIELDS[n_fields]


def _of_folder(path: Path) -> str | None:
    """Name of the format of a folder; None if it is of no known format."""
    form = load_format()
    if any((path / name).is_dir() for name in (form.world_folder, form.eval_folder)):
        return STUDY
    if (path / MOT_FILES[0]).is_file():
        return MOT_FOLDER
    if any(_NAME.fullmatch(one.name) for one in path.iterdir()):
        return WILDTRACK
    return None


def _unknown(where: str, got: str) -> InputError:
    names = ", ".join((*_READERS, MOT_FOLDER, WILDTRACK, COCO))
    return InputError(where, Unquoted(got), f"the study's folder, or one of {names}")


def read_boxes(path: Path) -> RecordedBoxes:
    """Boxes of a file in any of the known formats.

    The file itself says in which one. Raises InputError, with line or frame, if it
    is none of them, or not what its format asks for.
    """
    name = find_format(path)
    if name not in _READERS:
        raise InputError(str(path), Unquoted(name), "a file of " + ", ".join(_READERS))
    return gather_boxes(path, _READERS[name](path))
