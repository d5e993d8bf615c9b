"""Detectors: image evidence in, boxes with confidence out.

``evidence`` says what they get and give. ``built_in`` has one that looks at boxes alone
and one that misses with a probability, and finds detectors by name or file. ``network``
shows rendered pictures to an ONNX file. ``fitting`` makes a response table of what a
detector really found.
"""

from .built_in import DETECTOR_NAMES as DETECTOR_NAMES
from .built_in import GeometricDetector as GeometricDetector
from .built_in import ResponseDetector as ResponseDetector
from .built_in import load_detector as load_detector
from .built_in import load_planning_detector as load_planning_detector
from .evidence import VRU_CLASSES as VRU_CLASSES
from .evidence import Detections as Detections
from .evidence import Detector as Detector
from .evidence import Evidence as Evidence
from .evidence import PlanningDetector as PlanningDetector
from .evidence import aspects_deg as aspects_deg
from .evidence import is_matched as is_matched
from .evidence import load_min_iou as load_min_iou
from .evidence import vru_class as vru_class
