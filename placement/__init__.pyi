"""The public names of placement, each once.

Type checkers read this file, and so does the package when a name is used.
"""

from .candidates import CandidateGrid as CandidateGrid
from .candidates import CandidatePose as CandidatePose
from .candidates import build_candidates as build_candidates
from .candidates import load_candidate_grid as load_candidate_grid
from .compute import Compute as Compute
from .detection_table import DetectionTable as DetectionTable
from .detectors import Detector as Detector
from .detectors import load_detector as load_detector
from .evaluation import Evaluation as Evaluation
from .evaluation import Verdict as Verdict
from .evaluation import apr as apr
from .evaluation import apr_by_case as apr_by_case
from .evaluation import apr_by_position as apr_by_position
from .evaluator import evaluate_layout as evaluate_layout
from .evaluator import evaluate_layouts as evaluate_layouts
from .layout import Certificate as Certificate
from .layout import Layout as Layout
from .layout import Stage as Stage
from .layout import find_layout as find_layout
from .layout import load_layout as load_layout
from .optimiser import Effort as Effort
from .pipeline import Assembly as Assembly
from .pipeline import Placement as Placement
from .pipeline import assemble as assemble
from .pipeline import place as place
from .question import Question as Question
from .question import load_question as load_question
from .refinement import refine as refine
from .setting import Radio as Radio
from .setting import Setting as Setting
from .setting import build_setting as build_setting
from .verification.certificates import load_certificate as load_certificate
from .verification.instances import load_problem as load_problem
from .verification.verify import verify_certificate as verify_certificate
from .wishes import Wishes as Wishes
