"""What to mount: candidate poses -> detection table -> optimiser -> layout -> evaluation.

``pipeline.place()`` goes all the way to a proven layout; ``evaluator.evaluate_layout()`` judges any
layout by full perception and emergency braking. Every stage can be entered with its own values:
``visibility`` builds the table, ``optimiser`` solves it, ``layout`` loads and checks layouts.
"""

from .candidates import CandidateGrid, CandidatePose, build_candidates, load_candidate_grid
from .detection_table import DetectionTable
from .detectors import Detector, load_detector
from .evaluation import Evaluation, Verdict, apr, apr_by_case
from .layout import Certificate, Layout, Stage, load_layout
from .links import Links
from .setting import Setting

__all__ = [
    "CandidateGrid",
    "CandidatePose",
    "Certificate",
    "DetectionTable",
    "Detector",
    "Evaluation",
    "Layout",
    "Links",
    "Setting",
    "Stage",
    "Verdict",
    "apr",
    "apr_by_case",
    "build_candidates",
    "load_candidate_grid",
    "load_detector",
    "load_layout",
]
