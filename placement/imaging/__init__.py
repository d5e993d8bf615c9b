"""Pictures by ray casting: what a camera sees of a run, in colour, by instance, in depth.

``mesh`` gathers a frame's triangles, ``ground`` and ``markings`` draw the road plane;
``materials``, ``surfaces`` and ``bodies`` say what is sent back, ``sky``, ``lamps`` and ``light``
what falls on it; ``shading`` puts them together, ``edges`` smooths stairs, ``air`` adds drops and
glare, ``imager`` exposes.
``cloud`` scans the same mesh with a LiDAR.
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
