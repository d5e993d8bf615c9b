"""Detectors: image evidence in, boxes with confidence out.

``evidence`` says what they get and give. ``registry`` finds them by name or file.
``geometric`` looks at boxes alone, ``response`` misses with a probability, ``network``
shows rendered pictures to an ONNX file. ``fitting`` makes a response table of what a
detector really found.
"""

from .evidence import VRU_CLASSES as VRU_CLASSES
from .evidence import Detections as Detections
from .evidence import Detector as Detector
from .evidence import Evidence as Evidence
from .evidence import PlanningDetector as PlanningDetector
from .evidence import aspects_deg as aspects_deg
from .evidence import is_matched as is_matched
from .evidence import load_min_iou as load_min_iou
from .evidence import vru_class as vru_class
from .registry import DETECTOR_NAMES as DETECTOR_NAMES
from .registry import load_detector as load_detector
from .registry import load_planning_detector as load_planning_detector
