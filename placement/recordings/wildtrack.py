"""WILDTRACK: people on a square who are annotated in seven calibrated views.

The format: T. Chavdarova et al., "WILDTRACK: a multi-camera HD dataset for dense unscripted
pedestrian detection", 2018. Places are cells of a grid; calibrations are in centimetres.
"""

import re
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from scipy.spatial.transform import Rotation

from geometry.arrays import FloatArray
from geometry.errors import InputError, Unquoted
from geometry.files import read_bytes, read_table
from geometry.lenses import BrownConrady, CalibratedCamera
from geometry.untrusted_files import read_xml

from .boxes import BoxRow, RecordedBoxes, gather_boxes

N_VIEWS = 7
_CELL_M, _COLUMNS, _ORIGIN_M = 0.025, 480, (-3.0, -9.0)
_CM = 0.01
_NAME = re.compile(r"(\d{1,8})\.json", re.ASCII)
_Pixel = Annotated[int, Meta(ge=-100_000, le=100_000)]


class _View(msgspec.Struct, frozen=True):
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
    """Everybody who is annotated, view by view; a box without area means: not in this view.

    Frames are numbered 0, 1, .. in the order of their files. Raises InputError if a file is not
    what it should be, views are missing, or the files' numbers are not all as far apart (mixed
    frame rates).
    """
    rows: list[list[BoxRow]] = [[] for _ in range(N_VIEWS)]
    for frame, path in enumerate(_files(folder)):
        try:
            found = msgspec.json.decode(read_bytes(path))
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise InputError(str(path), Unquoted(error), "a JSON file") from None
        for person in read_table(found, tuple[_Person, ...], str(path)):
            if sorted(view.viewNum for view in person.views) != [*range(N_VIEWS)]:
                got = Unquoted(f"{len(person.views)} views")
                expected = f"views 0 to {N_VIEWS - 1}, once each"
                raise InputError(f"{path}: person {person.personID}", got, expected)
            for view in person.views:
                sides = (view.xmin, view.ymin, view.xmax, view.ymax)
                is_seen = sides != (-1, -1, -1, -1)
                left, top, right, bottom = map(float, sides if is_seen else (0, 0, 0, 0))
                rows[view.viewNum].append(
                    BoxRow(
                        f"{path}: person {person.personID}, view {view.viewNum}",
                        frame,
                        "pedestrian",
                        (left, top, right, bottom),
                        track=person.personID,
                        position_m=_position_m(person.positionID),
                    )
                )
    return tuple(gather_boxes(folder, of_view) for of_view in rows)


def is_wildtrack(folder: Path) -> bool:
    """True for a folder with files that are named as those of frames."""
    return any(_NAME.fullmatch(path.name) for path in folder.iterdir())


def _files(folder: Path) -> list[Path]:
    """Files of the frames, in order."""
    try:
        found = {int(m[1]): path for path in folder.iterdir() if (m := _NAME.fullmatch(path.name))}
    except OSError as error:
        reason = Unquoted(error.strerror or error)
        raise InputError(str(folder), reason, "a folder with frames") from None
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


def _position_m(position_id: int) -> tuple[float, float, float]:
    row, column = divmod(position_id, _COLUMNS)
    return _ORIGIN_M[0] + _CELL_M * column, _ORIGIN_M[1] + _CELL_M * row, 0.0


def read_opencv_camera(
    intrinsic: Path, extrinsic: Path, *, width_px: int, height_px: int
) -> CalibratedCamera:
    """A camera of OpenCV's XML: matrix and distortion in one file, rvec and tvec (cm) in another.

    Raises InputError if numbers are missing or no camera's.
    """
    K = _numbers(intrinsic, "camera_matrix/data", 9)
    k1, k2, p1, p2, k3 = _numbers(intrinsic, "distortion_coefficients/data", 5).tolist()
    turn = Rotation.from_rotvec(_numbers(extrinsic, "rvec", 3)).as_matrix()
    shift_m = _CM * _numbers(extrinsic, "tvec", 3)
    try:
        return CalibratedCamera(
            width_px=width_px,
            height_px=height_px,
            fx_px=K[0],
            fy_px=K[4],
            cx_px=K[2],
            cy_px=K[5],
            R_camera_world=turn,
            position_m=-turn.T @ shift_m,
            lens=BrownConrady(k1=k1, k2=k2, p1=p1, p2=p2, k3=k3),
        )
    except InputError as error:
        raise InputError(f"{intrinsic}: {error.where}", error.got, error.expected) from None


def _numbers(path: Path, tag: str, count: int) -> FloatArray:
    element = read_xml(path, expected="a calibration of OpenCV").find(tag)
    words = ("" if element is None else element.text or "").split()
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        numbers = np.full(0, np.nan)
    if len(numbers) != count or not (abs(numbers) < 1.0e9).all():
        raise InputError(f"{path}: {tag}", " ".join(words), f"{count} finite numbers")
    return numbers
