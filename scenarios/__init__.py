"""What happens there: Euro NCAP cases, where they are driven, and the braking that may help.

``cases`` reads what is driven, ``selection`` picks it by a user's words. ``runs.build_runs()`` lays
it on the arms of a junction: by the study's own start points (``published``) where there are any,
else by the rules of the ``protocol``; every run lies on a grid of frames that ends at the unbraked
impact. ``aeb`` says when braking is too late; ``exposure`` says how much each run counts.
"""

from .aeb import AebRule, load_aeb_rule
from .cases import Case, load_cases, pick_cases
from .exposure import weight_per_run, weight_share
from .runs import (
    FrameAxis,
    Refusal,
    Run,
    build_frame_axis,
    build_runs,
)

__all__ = [
    "AebRule",
    "Case",
    "FrameAxis",
    "Refusal",
    "Run",
    "build_frame_axis",
    "build_runs",
    "load_aeb_rule",
    "load_cases",
    "pick_cases",
    "weight_per_run",
    "weight_share",
]
