"""Layout -> Evaluation, by rendering every frame: independent of the detection table.

``surroundings`` holds everything there is to see, and the place of the VUT's camera; ``solids``
keeps its triangles; ``pixels`` draws the VRU's at pixel centres and takes away what others hide,
which ``trees`` find; ``perceive`` gives the visible and the amodal box of the VRU in every frame;
``scan`` counts LiDAR points, by rays; ``watch`` detects from every unit, and draws pictures for
networks; ``evaluate`` adds what VRUs announce themselves, confirms, brakes and looks for contact.
"""

from geometry.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
