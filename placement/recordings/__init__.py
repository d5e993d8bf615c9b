"""Detections from elsewhere: recordings in the folder layout of the CarlaNCAP study.

``read.read_recording()`` reads a folder strictly and counts what it leaves out; ``drives`` cuts the
frames into drives that end at the impact, ``motion`` tells from them when braking is too late;
``evaluate.evaluate_recording()`` matches, confirms and brakes; ``write.write_recording()`` writes
such a folder. All that is known of the layout stands in ``data/carla_ncap_format.toml``.
"""

from .drives import Drive
from .evaluate import (
    RecordedEvaluation,
    evaluate_recording,
    is_longitudinal,
    recorded_table,
    take_units,
)
from .read import Recording, read_recording
from .write import WrittenDrive, write_recording

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
