"""CVML, an XML format of annotated tracks, and Tsai's calibrations as PETS has them.

The format: T. List, R. Fisher, "CVML - an XML-based computer vision markup language", 2004.
"""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from geometry.arrays import FloatArray
from geometry.errors import InputError, Unquoted
from geometry.files import parse_number
from geometry.lenses import CalibratedCamera, TsaiRadial
from geometry.untrusted_files import read_xml

from .boxes import BoxRow, RecordedBoxes, gather_boxes

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_MM = 1.0e-3
_GEOMETRY = ("width", "height", "dpx", "dpy")
_INTRINSIC = ("focal", "kappa1", "cx", "cy", "sx")
_EXTRINSIC = ("tx", "ty", "tz", "rx", "ry", "rz")


def read_cvml(path: Path) -> RecordedBoxes:
    """Annotated people of a CVML file.

    Raises InputError, with frame and object: a number is missing or wrong, frames are not in
    order, or not all as far apart (mixed frame rates).
    """
    return gather_boxes(path, _rows(path))


def _rows(path: Path) -> Iterator[BoxRow]:
    root = read_xml(path, expected="CVML")
    if root.tag != "dataset":
        raise InputError(str(path), root.tag, "CVML: an element <dataset> with frames")
    step: int | None = None
    last: int | None = None
    for frame in root.iter("frame"):
        number = _whole(frame, "number", f"{path}: frame {frame.get('number')}")
        place = f"{path}: frame {number}"
        if last is not None:
            step = number - last if step is None else step
            if number - last != step or step <= 0:
                expected = f"{last + step} after frame {last}: frames in order, all as far apart"
                raise InputError(place, number, expected)
        last = number
        for thing in frame.iter("object"):
            here = f"{place}, object {thing.get('id')}"
            track = _whole(thing, "id", here)
            box = thing.find("box")
            if box is None:
                raise InputError(here, Unquoted("no box"), "<box xc= yc= w= h=>")
            x, y, w, h = (_number(box, name, here) for name in ("xc", "yc", "w", "h"))
            sides = (x - 0.5 * w, y - 0.5 * h, x + 0.5 * w, y + 0.5 * h)
            yield BoxRow(here, number, "pedestrian", sides, track=track)


def _number(element: "Element", name: str, place: str) -> float:
    word = element.get(name)
    if word is None:
        raise InputError(f"{place}: {name}", Unquoted("nothing"), "a number")
    return parse_number(word, f"{place}: {name}", least=-1.0e9, most=1.0e9)


def _whole(element: "Element", name: str, place: str) -> int:
    value = _number(element, name, place)
    if value != int(value) or value < 0.0:
        raise InputError(f"{place}: {name}", element.get(name), "a whole number, at least 0")
    return int(value)


def read_tsai(path: Path) -> CalibratedCamera:
    """A camera of Tsai's calibration in XML; lengths in the file are millimetres.

    Raises InputError if something is missing or impossible.
    """
    root = read_xml(path, expected="a Tsai calibration")
    g = _attributes(root, "Geometry", _GEOMETRY, path)
    i = _attributes(root, "Intrinsic", _INTRINSIC, path)
    e = _attributes(root, "Extrinsic", _EXTRINSIC, path)
    for name, values in {"dpx": g, "dpy": g, "focal": i, "sx": i}.items():
        if not values[name] > 1.0e-9:
            raise InputError(f"{path}: {name}", values[name], "more than 0")
    turn = _turns(e["rx"], e["ry"], e["rz"])
    shift_m = _MM * np.array([e["tx"], e["ty"], e["tz"]])
    try:
        return CalibratedCamera(
            width_px=round(g["width"]),
            height_px=round(g["height"]),
            fx_px=i["focal"] * i["sx"] / g["dpx"],
            fy_px=i["focal"] / g["dpy"],
            cx_px=i["cx"],
            cy_px=i["cy"],
            R_camera_world=turn,
            position_m=-turn.T @ shift_m,
            lens=TsaiRadial(kappa=i["kappa1"] * i["focal"] ** 2),
        )
    except InputError as error:
        raise InputError(f"{path}: {error.where}", error.got, error.expected) from None


def _attributes(
    root: "Element", tag: str, names: tuple[str, ...], path: Path
) -> Mapping[str, float]:
    element = root.find(tag)
    if element is None:
        raise InputError(f"{path}: {tag}", Unquoted("nothing"), f"<{tag} {'= '.join(names)}=>")
    return {name: _number(element, name, f"{path}: {tag}") for name in names}


def _turns(x: float, y: float, z: float) -> FloatArray:
    """Rotation about x, then y, then z, in radians, as Tsai's program has it."""
    cx, cy, cz = math.cos(x), math.cos(y), math.cos(z)
    sx, sy, sz = math.sin(x), math.sin(y), math.sin(z)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    turn: FloatArray = about_z @ about_y @ about_x
    return turn
