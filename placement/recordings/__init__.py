"""Detections from elsewhere: recordings in the folder layout of the CarlaNCAP study.

``read`` reads a folder strictly, cuts its frames into drives that end at the impact, and counts
what it leaves out; ``evaluate`` matches, confirms and brakes. ``files`` knows the layout, from
``data/carla_ncap_format.toml``, and writes such a folder.
"""

from .evaluate import (
    RecordedEvaluation,
    evaluate_recording,
    is_longitudinal,
    recorded_table,
    take_units,
)
from .files import FrameKey, WrittenDrive, load_format, write_folder, write_recording
from .read import Drive, Recording, read_recording

__all__ = [
    "Drive",
    "FrameKey",
    "RecordedEvaluation",
    "Recording",
    "WrittenDrive",
    "evaluate_recording",
    "is_longitudinal",
    "load_format",
    "read_recording",
    "recorded_table",
    "take_units",
    "write_folder",
    "write_recording",
]
