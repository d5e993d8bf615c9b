"""A picture or point cloud of one frame: which run, frame and unit, and the files that show it."""

from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from geometry.catalogue import Sensor
from geometry.errors import InputError
from geometry.files import check_target, write_atomically
from geometry.image_boxes import mask_box
from geometry.lidar import LidarModel
from placement.imaging import Picture, PointCloud

COLOUR_SUFFIXES = (".png", ".jpg", ".jpeg")
CLOUD_SUFFIXES = (".ply", ".bin")
_JPEG_QUALITY = 85
_MAX_CM = 65535  # what 16 bits hold


def suffixes_of(sensor: Sensor) -> tuple[str, ...]:
    """Endings of files that show what a sensor sees, the usual one first."""
    return CLOUD_SUFFIXES if isinstance(sensor, LidarModel) else COLOUR_SUFFIXES


def check_path(path: Path, sensor: Sensor) -> None:
    """Refuse a file name that ends in none of :func:`suffixes_of`, or is no regular file's."""
    known = suffixes_of(sensor)
    if path.suffix.lower() not in known:
        raise InputError("--out", str(path), "a name that ends in " + ", ".join(known))
    check_target(path)


def save(path: Path, seen: Picture | PointCloud) -> tuple[Path, ...]:
    """Write a picture or a point cloud, each file whole or not at all; returns their paths.

    A cloud is ".ply", points in the LiDAR's frame with a colour for each thing, or ".bin", float32
    x, y, z, intensity, as the study releases them. A picture's colours are ".png", or ".jpg" for a
    smaller file; "..-instances.png" has a colour for each thing; "..-depth.png" has 16 bits,
    centimetres, 0 where nothing is hit.
    """
    if isinstance(seen, PointCloud):
        import trimesh

        content = cloud_bytes(seen)
        if path.suffix.lower() != ".bin":
            colours = instance_colours(seen.names)[seen.instance]
            content = trimesh.PointCloud(seen.points_m, colours).export(file_type="ply")
        write_atomically(path, content)
        return (path,)
    from PIL import Image

    png: dict[str, Any] = {"format": "PNG"}
    is_png = path.suffix.lower() == ".png"
    images: dict[Path, tuple[NDArray[Any], dict[str, Any]]] = {
        path: (seen.rgb, png if is_png else {"format": "JPEG", "quality": _JPEG_QUALITY}),
        path.with_name(f"{path.stem}-instances.png"): (instance_image(seen), png),
        path.with_name(f"{path.stem}-depth.png"): (depth_image(seen), png),
    }
    for file, (pixels, options) in images.items():
        write_atomically(file, partial(_save, Image.fromarray(pixels), options))
    return tuple(images)


def _save(image: Any, options: dict[str, Any], file: BinaryIO) -> None:
    image.save(file, **options)


def cloud_bytes(cloud: PointCloud) -> bytes:
    """A point cloud as the study releases them: float32 x, y, z, intensity."""
    return np.column_stack([cloud.points_m, cloud.intensity]).astype("<f4").tobytes()


def instance_image(picture: Picture) -> NDArray[np.uint8]:
    """A colour for each thing, (h, w, 3)."""
    return instance_colours(picture.names)[picture.instance]


def depth_image(picture: Picture) -> NDArray[np.uint16]:
    """Depths in centimetres, 0 where nothing is hit, (h, w)."""
    centimetres = np.where(np.isfinite(picture.depth_m), picture.depth_m * 100.0, 0.0)
    return np.clip(np.rint(centimetres), 0, _MAX_CM).astype(np.uint16)


def instance_colours(names: tuple[str, ...]) -> NDArray[np.uint8]:
    """Colours (n + 1, 3) of things, sRGB, that differ in hue and in lightness.

    The VRU's is the lightest; the last one, for sky, is black.
    """
    import colorsys

    golden = 0.6180339887498949  # multiples of it fill a circle evenly, however many there are
    colours = []
    for index, name in enumerate(names):
        if name == "vru":
            colours.append((1.0, 1.0, 0.2))
        elif name == "vut":
            colours.append((1.0, 0.45, 0.45))
        else:
            lightness = 0.2 + 0.45 * (index * golden * golden % 1.0)
            colours.append(colorsys.hls_to_rgb(index * golden % 1.0, lightness, 0.6))
    colours.append((0.0, 0.0, 0.0))
    return np.rint(255.0 * np.array(colours)).astype(np.uint8)


def vru_sentence(seen: Picture | PointCloud) -> str:
    """A sentence that says if, and where, the VRU is in view."""
    is_vru = seen.instance == seen.names.index("vru")
    if isinstance(seen, PointCloud):
        return f"VRU: {int(is_vru.sum())} of {len(is_vru)} points."
    box = mask_box(is_vru)
    if not box.any():
        return "VRU: not in view."
    x_min, y_min, x_max, y_max = box.astype(int).tolist()
    return (
        f"VRU: in view, visible box x {x_min} to {x_max}, y {y_min} to {y_max} px "
        f"({x_max - x_min} x {y_max - y_min})."
    )
