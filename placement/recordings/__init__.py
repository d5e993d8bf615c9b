"""Detections from elsewhere: recordings of the CarlaNCAP study, and in the formats of others.

``read`` reads a folder strictly, cuts its frames into drives that end at the impact,
and counts what it leaves out; ``evaluate`` matches, confirms and brakes. ``files``
knows the layout, from ``data/carla_ncap_format.toml``, and writes such a folder.
``formats`` has annotated tracks and detections in other formats, ``calibrations`` reads
cameras; ``pairs`` lays annotations and detections side by side.
"""

from .evaluate import RecordedEvaluation as RecordedEvaluation
from .evaluate import evaluate_recording as evaluate_recording
from .evaluate import is_longitudinal as is_longitudinal
from .evaluate import recorded_table as recorded_table
from .evaluate import take_units as take_units
from .files import FrameKey as FrameKey
from .files import WrittenDrive as WrittenDrive
from .files import load_format as load_format
from .files import write_folder as write_folder
from .files import write_recording as write_recording
from .formats import RecordedBoxes as RecordedBoxes
from .formats import find_format as find_format
from .formats import read_boxes as read_boxes
from .read import Drive as Drive
from .read import Recording as Recording
from .read import read_recording as read_recording
