"""Pictures by ray casting: what a camera sees of a run in colour, by instance and in depth.

``mesh`` gathers a frame's triangles, ``ground`` draws the road plane; ``materials`` says what
surfaces send back, ``light`` what falls on them; ``picture`` casts the rays and exposes,
``rain_and_glare`` draws drops and glare. ``point_cloud`` scans the same mesh with a LiDAR.
"""

from .picture import (
    Backdrop,
    Picture,
    build_backdrop,
    draw_picture,
    render_picture,
)
from .point_cloud import PointCloud, scan_cloud

__all__ = [
    "Backdrop",
    "Picture",
    "PointCloud",
    "build_backdrop",
    "draw_picture",
    "render_picture",
    "scan_cloud",
]
