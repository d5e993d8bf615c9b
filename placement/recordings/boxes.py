"""Boxes of recordings in the formats of others: annotated tracks, and what detectors found.

Readers of single formats make :class:`RecordedBoxes` of rows.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.errors import InputError, Unquoted
from geometry.files import parse_number

from .files import Box

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

IGNORE = "ignore"
"""Class of a region in which nothing is annotated: what is found there does not count."""

JUMPS = "tracks that jump"
_MOST_HEIGHTS = 8.0
"""A box's middle that moves on by more of its heights in a frame jumps: assumption. The most in
PETS (7 Hz) is 0.1, in KITTI's even sequences (10 Hz) 3.2, in WILDTRACK (2 Hz) 5.8."""

_NOWHERE = (np.nan, np.nan, np.nan)


class BoxRow(NamedTuple):
    """A box in a file, and where it stands there: a line, or words."""

    place: str
    frame: int
    class_name: str  # "pedestrian", "cyclist", "car", "other" or "ignore"
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
        Number of the frame, from 0; consecutive numbers are consecutive frames.
    box_px : (n, 4) float
        Left, upper, right, lower side. Without area: not in view. [px]
    track : (n,) int
        Whose box it is; -1: not said.
    score : (n,) float
        A detector's; not a number where it is annotated.
    seen_share : (n,) float
        Share that nothing hides; not a number where it is not said.
    hidden_level : (n,) int
        KITTI's: 0 in view, 1 partly, 2 largely hidden; -1: not said.
    position_m : (n, 3) float
        Middle of the body's foot in the recording's own frame; not a number where not said. [m]
    left_out : mapping of str to int
        What is not among them, and how often.
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
            name: one[index] for name, one in values.items() if isinstance(one, np.ndarray)
        }
        names = tuple(self.class_name[one] for one in index.tolist())
        return replace(self, class_name=names, **arrays)


def gather_boxes(path: Path, rows: Iterable[BoxRow]) -> RecordedBoxes:
    """The boxes of a file's rows, in their order, without tracks that jump.

    Raises InputError, with the row's place: a frame before that of the row above (of the same
    track, where there are tracks), a negative width or height, numbers out of range.
    """
    kept = list(rows)
    last: dict[int, int] = {}
    for row in kept:
        before = last.get(row.track, -1)
        # A track is once in a frame; a detector finds several things in one.
        if row.frame < before or (row.track >= 0 and row.frame == before):
            what = f"of track {row.track}, once each, " if row.track >= 0 else ""
            raise InputError(row.place, Unquoted(f"frame {row.frame}"), f"frames {what}in order")
        last[row.track] = row.frame
        left, top, right, bottom = row.box_px
        if right < left or bottom < top:
            got = Unquoted(f"{right - left:g} x {bottom - top:g} px")
            raise InputError(f"{row.place}: box", got, "a width and a height, at least 0")

    def column(name: str, kind: type, *size: int) -> Any:
        return freeze(np.array([getattr(row, name) for row in kept], kind).reshape(-1, *size))

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
    return replace(boxes.take(~np.isin(boxes.track, jumping)), left_out={JUMPS: len(jumping)})


def _jumping(boxes: RecordedBoxes) -> IntArray:
    """Tracks that move on too far between two of their boxes."""
    left, top, right, bottom = boxes.box_px.T
    rows = np.flatnonzero((boxes.track >= 0) & (right > left) & (bottom > top))
    rows = rows[np.argsort(boxes.track[rows], kind="stable")]
    before, after = rows[:-1], rows[1:]
    moved = 0.5 * np.hypot(np.diff((left + right)[rows]), np.diff((top + bottom)[rows]))
    height = np.maximum((bottom - top)[before], (bottom - top)[after])
    is_same = boxes.track[before] == boxes.track[after]
    is_far = moved > _MOST_HEIGHTS * height * (boxes.frame[after] - boxes.frame[before])
    return np.unique(boxes.track[after[is_same & is_far]])


# ---------- attributes of XML


def xml_number(element: "Element", name: str, place: str) -> float:
    """Number of an attribute."""
    word = element.get(name)
    if word is None:
        raise InputError(f"{place}: {name}", Unquoted("nothing"), "a number")
    return parse_number(word, f"{place}: {name}", least=-1.0e9, most=1.0e9)


def xml_whole(element: "Element", name: str, place: str) -> int:
    """Whole number of an attribute, at least 0."""
    value = xml_number(element, name, place)
    if value != int(value) or value < 0.0:
        raise InputError(f"{place}: {name}", element.get(name), "a whole number, at least 0")
    return int(value)
