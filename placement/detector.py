"""What counts as a detection, from the visible and the whole (amodal) box."""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import BoolArray
from geometry.errors import InputError
from geometry.image_boxes import box_height_px, iou
from geometry.toml_files import load_toml, take_number


@dataclass(frozen=True, slots=True, kw_only=True)
class Detector:
    """A detector that finds what is visible enough and large enough.

    Attributes
    ----------
    min_iou : float
        The visible box must overlap the amodal box by more than this.
    min_box_height_px : float
        The visible box must be at least this high. [px]
    """

    min_iou: float
    min_box_height_px: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.min_iou < 1.0:
            raise InputError("detector.min_iou", self.min_iou, "0 <= IoU < 1")
        if not (np.isfinite(self.min_box_height_px) and self.min_box_height_px >= 0.0):
            raise InputError(
                "detector.min_box_height_px", self.min_box_height_px, "pixels, at least 0"
            )

    def is_detected(self, visible_box_px: ArrayLike, amodal_box_px: ArrayLike) -> BoolArray:
        """Whether a VRU is detected.

        Parameters
        ----------
        visible_box_px, amodal_box_px : (..., 4) float
            Box of what is seen, and of the whole VRU clipped to the image. [px]

        Returns
        -------
        detected : (...,) bool
            IoU of the two is above the limit and the visible box is high enough.
        """
        detected: BoolArray = (iou(visible_box_px, amodal_box_px) > self.min_iou) & (
            box_height_px(visible_box_px) >= self.min_box_height_px
        )
        return detected


@cache
def load_detector() -> Detector:
    """The default detector, from ``data/detectors.toml``."""
    table = load_toml(files(__package__) / "data" / "detectors.toml")["geometric"]
    return Detector(
        min_iou=take_number(table, "min_iou", "detectors.toml: geometric"),
        min_box_height_px=take_number(table, "min_box_height_px", "detectors.toml: geometric"),
    )
