"""Detectors: image evidence in, boxes with confidence out.

``evidence`` says what they get and give; ``geometric`` looks at boxes, ``response`` misses with a
probability, ``network`` shows rendered pictures to an ONNX file, which ``onnx_model`` runs,
``onnx_exports`` recognises and ``letterbox`` fits images to; ``files`` finds detectors by name.
"""

from .box_rule import GeometricDetector
from .evidence import (
    VRU_CLASSES,
    Detections,
    Detector,
    Evidence,
    PlanningDetector,
    aspects_deg,
    is_matched,
    vru_class,
)
from .loading import (
    DETECTOR_NAMES,
    load_detector,
    load_min_iou,
    load_planning_detector,
)
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
