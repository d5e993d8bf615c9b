"""An image in the middle of a larger grey one, as networks of a fixed size want it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from geometry.arrays import FloatArray

from .onnx_exports import onnx_setting


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Letterbox:
    """An image scaled without distortion and padded around.

    Attributes
    ----------
    pixels : (h, w, 3) uint8
        RGB.
    scale : (2,) float
        Pixels per pixel of the given image, across and down.
    offset_px : (2,) float
        Padding on the left and on top. [px]
    """

    pixels: NDArray[np.uint8]
    scale: FloatArray
    offset_px: FloatArray

    def to_image(self, boxes_px: FloatArray) -> FloatArray:
        """Boxes (n, 4) of the letterbox in pixels of the given image."""
        corners = (boxes_px.reshape(-1, 2, 2) - self.offset_px) / self.scale
        return corners.reshape(-1, 4)


def letterbox(
    image: NDArray[np.uint8], *, width_px: int, height_px: int, scale: float
) -> Letterbox:
    """Scale an image and put it into the middle of a grey one.

    Parameters
    ----------
    image : (h, w, 3) uint8
        RGB.
    width_px, height_px : int
        Of the result.
    scale : float
        At most what lets the image fit.

    Returns
    -------
    letterbox : Letterbox
        The image, and the way back.
    """
    height, width = image.shape[:2]
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    if size != (width, height):
        image = np.asarray(Image.fromarray(image).resize(size, Image.Resampling.BILINEAR))
    left, top = (width_px - size[0]) // 2, (height_px - size[1]) // 2
    pixels = np.full((height_px, width_px, 3), onnx_setting("fill"), dtype=np.uint8)
    pixels[top : top + size[1], left : left + size[0]] = image
    return Letterbox(
        pixels=pixels,
        scale=np.array([size[0] / width, size[1] / height]),
        offset_px=np.array([left, top], dtype=np.float64),
    )
