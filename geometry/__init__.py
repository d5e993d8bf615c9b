"""What is there: frames, poses, sensors, bodies, scenes, and rays through them.

Start with ``scene_files.load_study_scene()`` for a junction, ``catalogue.load_cameras()`` for
sensors, ``actors.load_actors()`` for bodies and ``raycast.build_caster()`` for rays. ``frames`` is
the only module that flips a sign: everything else is right-handed east-north-up, in metres.
"""

from .actors import (
    Actor,
    PlacedActor,
    Shape,
    load_actors,
)
from .catalogue import load_cameras
from .errors import InputError
from .poses import Pose
from .raycast import build_caster
from .scene import Scene, Site
from .scene_files import load_scene, load_study_scene
from .sensors import CameraModel

__all__ = [
    "Actor",
    "CameraModel",
    "InputError",
    "PlacedActor",
    "Pose",
    "Scene",
    "Shape",
    "Site",
    "build_caster",
    "load_actors",
    "load_cameras",
    "load_scene",
    "load_study_scene",
]
