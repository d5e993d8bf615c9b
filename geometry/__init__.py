"""A junction as it stands: scenes, sensors, bodies, frames, and rays through them.

``load_scene()`` loads a junction: the study's, one that was imported, or one of a map file.
``load_cameras()`` and ``load_lidars()`` give the catalogue of sensors, ``load_actors()`` that of
bodies. ``frames`` is the only module that flips a sign: everything else is right-handed
east-north-up, in metres.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .actors import Actor, load_actors
    from .catalogue import load_cameras, load_catalogue
    from .errors import InputError
    from .lidar import LidarModel, load_lidars
    from .poses import Pose
    from .scene import Scene, Site
    from .scene_files import load_scene, save_scene
    from .sensors import CameraModel

__all__ = [
    "Actor",
    "CameraModel",
    "InputError",
    "LidarModel",
    "Pose",
    "Scene",
    "Site",
    "load_actors",
    "load_cameras",
    "load_catalogue",
    "load_lidars",
    "load_scene",
    "save_scene",
]

# Loaded when first used: numpy and what reads files take a while, and not everybody needs them.
_HOMES = {
    "actors": ("Actor", "load_actors"),
    "catalogue": ("load_cameras", "load_catalogue"),
    "errors": ("InputError",),
    "lidar": ("LidarModel", "load_lidars"),
    "poses": ("Pose",),
    "scene": ("Scene", "Site"),
    "scene_files": ("load_scene", "save_scene"),
    "sensors": ("CameraModel",),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return __all__
