"""MOT challenge: annotated tracks (``gt.txt``) and detections (``det.txt``), with commas.

The format: https://motchallenge.net/instructions. Frames count from 1 in files, from 0 here.
"""

from collections.abc import Iterator
from pathlib import Path

from geometry.errors import InputError

from .boxes import IGNORE, BoxRow, RecordedBoxes, gather_boxes, read_lines

_NAMES = ("frame", "id", "left", "top", "width", "height", "conf", "class", "visibility", "z")
_LEAST = 7  # the rest is -1, or missing
_WITH_CLASSES = 9  # fields from 2016 on; in 2015 there were x, y, z in their place
_PEDESTRIAN = 1
_OTHERS = {3: "car", 2: IGNORE, 7: IGNORE, 8: IGNORE, 12: IGNORE}  # riders, statues, reflections


def read_mot(path: Path) -> RecordedBoxes:
    """Boxes of a MOT challenge file; those with an id are annotated, others were found.

    An annotated box whose flag is 0 is to be ignored. Raises InputError as
    :func:`placement.recordings.boxes.gather_boxes` does, or if a line is cut off.
    """
    return gather_boxes(path, _rows(path))


def _rows(path: Path) -> Iterator[BoxRow]:
    for fields in read_lines(path, _NAMES, separator=",", least=_LEAST):
        frame = fields.whole("frame", least=1)
        track = fields.whole("id")
        left, top = fields.number("left"), fields.number("top")
        box = (left, top, left + fields.number("width"), top + fields.number("height"))
        conf = fields.number("conf")
        if track < 0:
            yield BoxRow(fields.place, frame - 1, "pedestrian", box, score=conf)
            continue
        name, seen = "pedestrian", float("nan")
        if len(fields.words) == _WITH_CLASSES:
            kind = fields.whole("class", least=-1, most=100)
            name = name if kind in (_PEDESTRIAN, -1) else _OTHERS.get(kind, "other")
            seen = fields.number("visibility", least=-1.0, most=1.0)
            seen = seen if seen >= 0.0 else float("nan")
        if conf not in (0.0, 1.0):
            raise InputError(f"{fields.place}: conf", conf, "0 or 1 where there is an id")
        name = name if conf else IGNORE
        yield BoxRow(fields.place, frame - 1, name, box, track=track, seen_share=seen)
