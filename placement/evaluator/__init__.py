"""Layout -> Evaluation, by rendering every frame: independent of the detection table.

``surroundings`` holds everything there is to see, and the place of the VUT's camera; ``solids``
keeps its triangles; ``pixels`` draws the VRU's at pixel centres and takes away what others hide,
which ``trees`` find; ``perceive`` gives the visible and the amodal box of the VRU in every frame;
``scan`` counts LiDAR points, by rays; ``watch`` detects from every unit, and draws pictures for
networks; ``evaluate`` adds what VRUs announce themselves, confirms, brakes and looks for contact.
"""

from .evaluate import evaluate_layout, evaluate_layouts
from .perceive import perceive_from_roadside, perceive_from_vut
from .surroundings import Surroundings, VutCamera, build_surroundings, load_vut_camera

__all__ = [
    "Surroundings",
    "VutCamera",
    "build_surroundings",
    "evaluate_layout",
    "evaluate_layouts",
    "load_vut_camera",
    "perceive_from_roadside",
    "perceive_from_vut",
]
