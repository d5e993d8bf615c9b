"""Recorded boxes of a file in any known format."""

from pathlib import Path

from geometry.errors import InputError, Unquoted
from geometry.files import read_text

from .boxes import RecordedBoxes
from .cvml import read_cvml
from .kitti import read_kitti_labels, read_pointrcnn, read_rrc
from .mot import read_mot


def read_boxes(path: Path) -> RecordedBoxes:
    """Boxes of a file in any of the formats that are known; the file itself says in which.

    ``.xml`` is CVML; lines of numbers with commas are MOT challenge, or a detector's of KITTI
    (RRC 6, PointRCNN 15 fields), with blanks KITTI's labels. Raises InputError if it is none of
    them, or not what its format asks for.
    """
    if path.suffix.lower() == ".xml":
        return read_cvml(path)
    first = next((one for one in read_text(path, "text").splitlines() if one.strip()), "")
    n_fields = len(first.split(","))
    reader = {1: read_kitti_labels, 6: read_rrc, 15: read_pointrcnn}.get(n_fields)
    if reader is not None:
        return reader(path)
    if 7 <= n_fields <= 10:
        return read_mot(path)
    what = "CVML, or lines of MOT challenge, KITTI, RRC or PointRCNN"
    raise InputError(f"{path}:1", Unquoted(f"{n_fields} fields"), what)
