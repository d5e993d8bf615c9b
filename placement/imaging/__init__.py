"""Pictures by ray casting: what a camera sees of a run in colour, by instance and in depth.

``mesh`` gathers a frame's triangles and scans them with a LiDAR, ``ground`` draws the road plane;
``materials`` says what surfaces send back, ``light`` what falls on them, and draws glare and drops;
``picture`` casts the rays and exposes.
"""

from .mesh import PointCloud, scan_cloud
from .picture import Backdrop, Picture, build_backdrop, draw_picture, render_picture

__all__ = [
    "Backdrop",
    "Picture",
    "PointCloud",
    "build_backdrop",
    "draw_picture",
    "render_picture",
    "scan_cloud",
]
