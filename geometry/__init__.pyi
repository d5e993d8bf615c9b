"""The public names of geometry, each once.

Type checkers read this file, and so does the package when a name is used.
"""

from .actors import Actor as Actor
from .actors import load_actors as load_actors
from .catalogue import load_cameras as load_cameras
from .catalogue import load_catalogue as load_catalogue
from .errors import InputError as InputError
from .lidar import LidarModel as LidarModel
from .lidar import load_lidars as load_lidars
from .poses import Pose as Pose
from .scene import Scene as Scene
from .scene import Site as Site
from .scene_files import save_scene as save_scene
from .scene_sources import load_scene as load_scene
from .sensors import CameraModel as CameraModel
