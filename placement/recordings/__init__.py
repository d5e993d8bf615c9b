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
from .files import WrittenDrive, write_recording
from .read import Drive, Recording, read_recording

__all__ = [
    "Drive",
    "RecordedEvaluation",
    "Recording",
    "WrittenDrive",
    "evaluate_recording",
    "is_longitudinal",
    "read_recording",
    "recorded_table",
    "take_units",
    "write_recording",
]
