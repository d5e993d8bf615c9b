"""Public names of placement.evaluator; see :mod:`geometry.lazy_names`."""

from .evaluate import evaluate_again as evaluate_again
from .evaluate import evaluate_layout as evaluate_layout
from .evaluate import evaluate_layouts as evaluate_layouts
from .evaluate import received as received
from .evaluate import with_sight as with_sight
from .perceive import perceive_frames as perceive_frames
from .surroundings import Surroundings as Surroundings
from .surroundings import VutCamera as VutCamera
from .surroundings import build_surroundings as build_surroundings
from .surroundings import load_vut_camera as load_vut_camera
