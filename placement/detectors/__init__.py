"""Detectors: image evidence in, boxes with confidence out.

``evidence`` says what they get and give. ``built_in`` has one that looks at boxes alone and one
that misses with a probability, and finds detectors by name or file. ``network`` shows rendered
pictures to an ONNX file. ``fitting`` makes a response table of what a detector really found.
"""

from .built_in import (
    DETECTOR_NAMES,
    GeometricDetector,
    ResponseDetector,
    load_detector,
    load_planning_detector,
)
from .evidence import (
    VRU_CLASSES,
    Detections,
    Detector,
    Evidence,
    PlanningDetector,
    aspects_deg,
    is_matched,
    load_min_iou,
    vru_class,
)

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
