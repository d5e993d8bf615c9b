"""What to mount: question -> plan -> detection table -> optimiser -> layout -> evaluation.

``build_setting()`` lays what is driven, ``build_plan()`` says what may be mounted and what is
wanted, ``place()`` goes all the way to a proven layout, ``refine()`` looks between the poses of the
grid, ``evaluate_layout()`` judges any layout by full perception and emergency braking,
``verify_certificate()`` checks a proof. Every stage can be entered with its own values:
``visibility`` builds the table, ``optimiser`` solves it, ``explain`` says why.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .candidates import CandidateGrid, CandidatePose, build_candidates, load_candidate_grid
    from .compute import Compute
    from .detection_table import DetectionTable
    from .detectors import Detector, load_detector
    from .evaluation import Evaluation, Verdict, apr, apr_by_case
    from .evaluator import evaluate_layout, evaluate_layouts
    from .layout import Certificate, Layout, Stage, load_layout
    from .optimiser import Effort
    from .pipeline import Placement, place
    from .planning import Plan, build_plan
    from .question import Question, load_question
    from .refinement.refine import refine
    from .setting import Links, Setting, build_setting
    from .verification.certificates import load_certificate, load_problem
    from .verification.verify import verify_certificate
    from .wishes import Wishes

__all__ = [
    "CandidateGrid",
    "CandidatePose",
    "Certificate",
    "Compute",
    "DetectionTable",
    "Detector",
    "Effort",
    "Evaluation",
    "Layout",
    "Links",
    "Placement",
    "Plan",
    "Question",
    "Setting",
    "Stage",
    "Verdict",
    "Wishes",
    "apr",
    "apr_by_case",
    "build_candidates",
    "build_plan",
    "build_setting",
    "evaluate_layout",
    "evaluate_layouts",
    "load_candidate_grid",
    "load_certificate",
    "load_detector",
    "load_layout",
    "load_problem",
    "load_question",
    "place",
    "refine",
    "verify_certificate",
]

# Loaded when first used: solvers and rays take seconds, and not everybody needs them.
_HOMES = {
    ".candidates": ("CandidateGrid", "CandidatePose", "build_candidates", "load_candidate_grid"),
    ".compute": ("Compute",),
    ".detection_table": ("DetectionTable",),
    ".detectors": ("Detector", "load_detector"),
    ".evaluation": ("Evaluation", "Verdict", "apr", "apr_by_case"),
    ".evaluator": ("evaluate_layout", "evaluate_layouts"),
    ".layout": ("Certificate", "Layout", "Stage", "load_layout"),
    ".optimiser": ("Effort",),
    ".pipeline": ("Placement", "place"),
    ".planning": ("Plan", "build_plan"),
    ".question": ("Question", "load_question"),
    ".refinement.refine": ("refine",),
    ".setting": ("Links", "Setting", "build_setting"),
    ".verification.certificates": ("load_certificate", "load_problem"),
    ".verification.verify": ("verify_certificate",),
    ".wishes": ("Wishes",),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name], __name__), name)


def __dir__() -> list[str]:
    return __all__
