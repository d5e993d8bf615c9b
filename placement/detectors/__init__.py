"""Detectors: image evidence in, boxes with confidence out.

``evidence`` says what they get and give. ``box_rule`` looks at boxes alone, ``response`` misses
with a probability, ``network`` shows rendered pictures to an ONNX file, whose outputs
``onnx_exports`` recognises. ``loading`` finds detectors by name.
"""

from .box_rule import GeometricDetector, is_matched, load_min_iou
from .evidence import (
    VRU_CLASSES,
    Detections,
    Detector,
    Evidence,
    PlanningDetector,
    aspects_deg,
    vru_class,
)
from .loading import DETECTOR_NAMES, load_detector, load_planning_detector
from .response import ResponseDetector

__all__ = [
    "DETECTOR_NAMES",
    "VRU_CLASSES",
    "Detections",
    "Detector",
    "Evidence",
    "GeometricDetector",
    "PlanningDetector",
    "ResponseDetector",
    "aspects_deg",
    "is_matched",
    "load_detector",
    "load_min_iou",
    "load_planning_detector",
    "vru_class",
]
