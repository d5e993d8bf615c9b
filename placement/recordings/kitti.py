"""KITTI tracking: labels, calibration, a car's own motion, and two detectors' output on it.

The formats: A. Geiger et al., "Vision meets robotics: the KITTI dataset", 2013, and its
development kit; RRC as in DeepFusionMOT, PointRCNN as in AB3DMOT.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geometry.arrays import FloatArray
from geometry.errors import InputError, Unquoted
from geometry.lenses import CalibratedCamera

from .boxes import IGNORE, BoxRow, Fields, RecordedBoxes, gather_boxes, read_lines

_SIDES = ("left", "top", "right", "bottom")
_PLACE = ("height", "width", "length", "x", "y", "z", "yaw")
_LABEL = ("frame", "track", "type", "truncated", "occluded", "alpha", *_SIDES, *_PLACE)
_RRC = ("frame", *_SIDES, "score")
_POINTRCNN = ("frame", "type", *_SIDES, "score", *_PLACE, "alpha")
_CLASSES = {"Pedestrian": "pedestrian", "Cyclist": "cyclist", "Car": "car", "DontCare": IGNORE}
_OTHERS = ("Van", "Truck", "Person", "Person_sitting", "Tram", "Misc")
_POINTRCNN_CLASSES = {1: "pedestrian", 2: "car", 3: "cyclist"}
_MOTION = ("lat", "lon", "alt", "roll", "pitch", "yaw", "vn", "ve", "vf", "vl", "vu")
_N_MOTION = 30  # fields, of which those above are the first


def read_kitti_labels(path: Path) -> RecordedBoxes:
    """Annotated road users; positions are in the frame of the rectified camera 0.

    Raises InputError as :func:`placement.recordings.boxes.gather_boxes` does, or for an unknown
    type.
    """
    return gather_boxes(path, _labels(path))


def _labels(path: Path) -> Iterator[BoxRow]:
    for fields in read_lines(path, _LABEL, separator=None):
        word = fields.words["type"]
        if word not in _CLASSES and word not in _OTHERS:
            expected = "one of " + ", ".join((*_CLASSES, *_OTHERS))
            raise InputError(f"{fields.place}: type", word, expected)
        level = fields.whole("occluded", most=3)
        name = _CLASSES.get(word, "other")
        yield BoxRow(
            fields.place,
            fields.whole("frame", least=0),
            name,
            fields.box(_SIDES),
            track=-1 if name == IGNORE else fields.whole("track"),
            hidden_level=level if level < 3 else -1,
            position_m=_position(fields),
        )


def _position(fields: Fields) -> tuple[float, float, float]:
    x, y, z = (fields.number(name) for name in ("x", "y", "z"))
    return x, y, z


def read_rrc(path: Path) -> RecordedBoxes:
    """Pedestrians found by RRC in a sequence, a file a class: frame, box, score."""
    return gather_boxes(
        path,
        (
            BoxRow(
                fields.place,
                fields.whole("frame", least=0),
                "pedestrian",
                fields.box(_SIDES),
                score=fields.number("score", least=0.0, most=1.0),
            )
            for fields in read_lines(path, _RRC, separator=",")
        ),
    )


def read_pointrcnn(path: Path) -> RecordedBoxes:
    """Road users found by PointRCNN in a sequence; scores are logits, 0 is a half."""
    return gather_boxes(path, _in_points(path))


def _in_points(path: Path) -> Iterator[BoxRow]:
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


def read_kitti_camera(
    path: Path, *, width_px: int, height_px: int, matrix: str = "P2"
) -> CalibratedCamera:
    """A camera of a calibration file, in the frame of the rectified camera 0.

    The file does not say how large the pictures are. Raises InputError if the matrix is missing, or
    is no camera's.
    """
    names = ("name", *(f"number {index}" for index in range(1, 13)))
    for fields in read_lines(path, names, separator=None, least=2):
        if fields.words["name"].rstrip(":") == matrix:
            break
    else:
        raise InputError(str(path), Unquoted(f"no {matrix}"), f"a line {matrix}: with 12 numbers")
    if len(fields.words) != len(names):
        got = Unquoted(f"{len(fields.words) - 1} numbers")
        raise InputError(f"{fields.place}: {matrix}", got, "12 numbers")
    P = np.array([fields.number(name) for name in names[1:]]).reshape(3, 4)
    K = P[:, :3]
    is_camera = K[0, 0] > 1.0e-3 and K[1, 1] > 1.0e-3
    if not (is_camera and np.array_equal(K[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]], [0, 0, 0, 0, 1])):
        raise InputError(f"{fields.place}: {matrix}", K.tolist(), "fx 0 cx, 0 fy cy, 0 0 1")
    return CalibratedCamera(
        width_px=width_px,
        height_px=height_px,
        fx_px=K[0, 0],
        fy_px=K[1, 1],
        cx_px=K[0, 2],
        cy_px=K[1, 2],
        R_camera_world=np.eye(3),
        position_m=-np.linalg.solve(K, P[:, 3]),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OwnMotion:
    """How the recording car moves, by frame (n)."""

    latitude_deg: FloatArray
    longitude_deg: FloatArray
    yaw_rad: FloatArray  # counter-clockwise from east
    speed_mps: FloatArray  # ahead


def read_kitti_motion(path: Path) -> OwnMotion:
    """A car's own motion (``oxts``), a line a frame.

    Raises InputError if a line is cut off, or no place on the earth.
    """
    names = (*_MOTION, *(f"number {index}" for index in range(len(_MOTION) + 1, _N_MOTION + 1)))
    rows = []
    for fields in read_lines(path, names, separator=None):
        rows.append(
            (
                fields.number("lat", least=-90.0, most=90.0),
                fields.number("lon", least=-180.0, most=180.0),
                fields.number("yaw", least=-7.0, most=7.0),
                fields.number("vf", least=-150.0, most=150.0),
            )
        )
    columns = np.array(rows, dtype=np.float64).reshape(-1, 4).T
    return OwnMotion(
        latitude_deg=columns[0], longitude_deg=columns[1], yaw_rad=columns[2], speed_mps=columns[3]
    )
