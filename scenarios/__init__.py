"""What happens there: Euro NCAP cases, where they are driven, and the braking that may help.

``cases.load_cases()`` reads what is driven, ``runs.load_placements()`` where, and
``runs.build_runs()`` lays every run on a grid of frames that ends at the unbraked impact.
``aeb`` says when braking is too late; ``exposure`` says how much each run counts.
"""

from .aeb import AebRule, load_aeb_rule
from .cases import Case, load_cases
from .exposure import weight_per_run, weight_share
from .runs import FrameAxis, Run, build_frame_axis, build_runs, load_placements

__all__ = [
    "AebRule",
    "Case",
    "FrameAxis",
    "Run",
    "build_frame_axis",
    "build_runs",
    "load_aeb_rule",
    "load_cases",
    "load_placements",
    "weight_per_run",
    "weight_share",
]
