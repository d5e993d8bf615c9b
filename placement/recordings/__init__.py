"""Detections from elsewhere: recordings of the CarlaNCAP study, and in the formats of others.

``read`` reads a folder strictly, cuts its frames into drives that end at the impact, and counts
what it leaves out; ``evaluate`` matches, confirms and brakes. ``files`` knows the layout, from
``data/carla_ncap_format.toml``, and writes such a folder. ``formats`` has annotated tracks and
detections in other formats, ``calibrations`` reads cameras;
``pairs`` lays annotations and detections side by side.
"""

from .evaluate import (
    RecordedEvaluation,
    evaluate_recording,
    is_longitudinal,
    recorded_table,
    take_units,
)
from .files import FrameKey, WrittenDrive, load_format, write_folder, write_recording
from .formats import RecordedBoxes, find_format, read_boxes
from .read import Drive, Recording, read_recording

__all__ = [
    "Drive",
    "FrameKey",
    "RecordedBoxes",
    "RecordedEvaluation",
    "Recording",
    "WrittenDrive",
    "evaluate_recording",
    "find_format",
    "is_longitudinal",
    "load_format",
    "read_boxes",
    "read_recording",
    "recorded_table",
    "take_units",
    "write_folder",
    "write_recording",
]
