"""What to mount: candidate poses -> detection table -> optimiser -> layout -> evaluation.

``build_setting()`` says what is driven and how it is judged, ``place()`` goes all the way to a
proven layout, ``evaluate_layout()`` judges any layout by full perception and emergency braking.
Every stage can be entered with its own values: ``visibility`` builds the table, ``optimiser``
solves it, ``layout`` loads and checks layouts.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geometry.scene_files import load_scene

    from .candidates import (
        CandidateGrid,
        CandidatePose,
        build_candidates,
        load_candidate_grid,
    )
    from .detection_table import DetectionTable
    from .detectors import Detector, load_detector
    from .evaluation import (
        Evaluation,
        Verdict,
        apr,
        apr_by_case,
    )
    from .evaluator import evaluate_layout, evaluate_layouts
    from .layout import (
        Certificate,
        Layout,
        Stage,
        load_layout,
    )
    from .optimiser import Effort
    from .pipeline import Placement, place
    from .question import Question
    from .setting import Links, Setting, build_setting
    from .wishes import Wishes

__all__ = [
    "CandidateGrid",
    "CandidatePose",
    "Certificate",
    "DetectionTable",
    "Detector",
    "Effort",
    "Evaluation",
    "Layout",
    "Links",
    "Placement",
    "Question",
    "Setting",
    "Stage",
    "Verdict",
    "Wishes",
    "apr",
    "apr_by_case",
    "build_candidates",
    "build_setting",
    "evaluate_layout",
    "evaluate_layouts",
    "load_candidate_grid",
    "load_detector",
    "load_layout",
    "load_scene",
    "place",
]

# Loaded when first used: solvers and rays take seconds, and not everybody needs them.
_HOMES = {
    "candidates": ("CandidateGrid", "CandidatePose", "build_candidates", "load_candidate_grid"),
    "detection_table": ("DetectionTable",),
    "detectors": ("Detector", "load_detector"),
    "evaluation": ("Evaluation", "Verdict", "apr", "apr_by_case"),
    "evaluator": ("evaluate_layout", "evaluate_layouts"),
    "layout": ("Certificate", "Layout", "Stage", "load_layout"),
    "optimiser": ("Effort",),
    "pipeline": ("Placement", "place"),
    "question": ("Question",),
    "setting": ("Links", "Setting", "build_setting", "load_scene"),
    "wishes": ("Wishes",),
}


def __getattr__(name: str) -> Any:
    for module, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f".{module}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
