"""A junction as it stands: scenes, sensors, bodies, frames, and rays through them.

``load_scene()`` loads a junction: the study's, one that was imported, or one of a map
file. ``load_cameras()`` and ``load_lidars()`` give the catalogue of sensors,
``load_actors()`` that of bodies. ``frames`` is the only module that flips a sign:
everything else is right-handed east-north-up, in metres.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
