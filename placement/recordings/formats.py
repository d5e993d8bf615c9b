"""Which format a recording is in, and the boxes of a file in any of them."""

import stat
from pathlib import Path

from geometry.errors import InputError, Unquoted
from geometry.files import read_text

from .boxes import RecordedBoxes
from .cvml import read_cvml
from .files import load_format
from .kitti import read_kitti_labels, read_pointrcnn, read_rrc
from .mot import read_mot
from .wildtrack import is_wildtrack

STUDY, MOT_FOLDER, WILDTRACK, COCO = "study", "MOT challenge's folder", "WILDTRACK", "COCO"
MOT_FILES = (Path("gt/gt.txt"), Path("det/det.txt"))
"""In a folder of MOT challenge: who was annotated, and what was found."""

_READERS = {
    "CVML": read_cvml,
    "MOT challenge": read_mot,
    "KITTI": read_kitti_labels,
    "RRC": read_rrc,
    "PointRCNN": read_pointrcnn,
}
_BY_FIELDS = {6: "RRC", 15: "PointRCNN"} | dict.fromkeys(range(7, 11), "MOT challenge")


def find_format(path: Path) -> str:
    """Name of the format of a recording, by its content: a folder's files, a file's beginning.

    Raises InputError, with the formats that are known, if it is in none of them.
    """
    try:
        is_folder = stat.S_ISDIR(path.stat().st_mode)
        name = _of_folder(path) if is_folder else None
    except OSError as error:
        raise InputError(str(path), Unquoted(error.strerror or error), "a recording") from None
    if is_folder and name is None:
        raise _unknown(str(path), "a folder without their files")
    if name is not None:
        return name
    first = next((one for one in read_text(path, "text").splitlines() if one.strip()), "")
    if first.lstrip("\ufeff \t").startswith("<"):
        return "CVML"
    if first.lstrip().startswith(("{", "[")):
        return COCO
    if not first:
        return "MOT challenge"  # a detector that found nothing
    n_fields = len(first.split(","))
    words = first.split()
    if n_fields == 1 and len(words) > 2 and not words[2][0].isdigit():
        return "KITTI"
    if n_fields not in _BY_FIELDS:
        raise _unknown(f"{path}:1", f"{n_fields if n_fields > 1 else len(words)} fields")
    return _BY_FIELDS[n_fields]


def _of_folder(path: Path) -> str | None:
    form = load_format()
    if any((path / name).is_dir() for name in (form.world_folder, form.eval_folder)):
        return STUDY
    if (path / MOT_FILES[0]).is_file():
        return MOT_FOLDER
    return WILDTRACK if is_wildtrack(path) else None


def _unknown(where: str, got: str) -> InputError:
    names = ", ".join((*_READERS, MOT_FOLDER, WILDTRACK, COCO))
    return InputError(where, Unquoted(got), f"the study's folder, or one of {names}")


def read_boxes(path: Path) -> RecordedBoxes:
    """Boxes of a file in any of the formats that are known; the file itself says in which.

    Raises InputError if it is none of them, or not what its format asks for.
    """
    name = find_format(path)
    if name not in _READERS:
        raise InputError(str(path), Unquoted(name), "a file of " + ", ".join(_READERS))
    return _READERS[name](path)
