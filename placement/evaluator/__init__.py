"""Layout -> Evaluation, by rendering every frame.

Independent of the detection table. ``surroundings`` holds everything there is to see,
with its triangles, and the place of the VUT's camera; ``perceive`` gives the visible
and the amodal box of the VRU in every frame, which ``pixels`` draws, and counts LiDAR
points; ``pictures`` draws for networks; ``evaluate`` detects from every unit, adds the
messages that VRUs send themselves, confirms, brakes and looks for contact.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
