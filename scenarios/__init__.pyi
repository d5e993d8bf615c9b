"""The public names of scenarios, each once.

Type checkers read this file, and so does the package when a name is used.
"""

from .aeb import AebRule as AebRule
from .aeb import last_brake_time_s as last_brake_time_s
from .aeb import load_aeb_rule as load_aeb_rule
from .cases import Case as Case
from .cases import load_cases as load_cases
from .cases import load_own_cases as load_own_cases
from .cases import pick_cases as pick_cases
from .positions import Position as Position
from .positions import build_positions as build_positions
from .runs import FrameAxis as FrameAxis
from .runs import Refusal as Refusal
from .runs import Run as Run
from .runs import build_frame_axis as build_frame_axis
from .runs import build_runs as build_runs
from .weights import weigh as weigh
from .weights import weight_by_function as weight_by_function
