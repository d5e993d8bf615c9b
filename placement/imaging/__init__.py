"""Pictures by ray casting: a run's frames in colour, instances and depths.

``mesh`` gathers a frame's triangles and scans them with a LiDAR, ``ground`` draws the
road plane; ``materials`` says what surfaces send back, ``light`` what falls on them;
``picture`` casts the rays of one frame, ``stills`` those of many frames of one camera,
or of a part; ``exposure`` adds glare and drops, and exposes.
"""

from .mesh import PointCloud
from .picture import Backdrop, RenderedPicture, build_backdrop, draw_picture

__all__ = [
    "Backdrop",
    "PointCloud",
    "RenderedPicture",
    "build_backdrop",
    "draw_picture",
]
