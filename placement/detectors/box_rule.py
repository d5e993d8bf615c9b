"""The box rule: a detection counts if its box and the true one overlap with IoU > 0.5."""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.errors import InputError
from geometry.files import load_toml, take_number
from geometry.image_boxes import box_height_px, iou

from .evidence import Detections, Evidence


@dataclass(frozen=True, slots=True, kw_only=True)
class GeometricDetector:
    """Detects by boxes alone: the same evidence always gives the same answer."""

    # the box of the visible part must overlap that of the whole VRU (amodal) by more than this
    min_iou: float
    min_box_height_px: float  # the visible box must be at least this high. [px]
    min_contrast: float = 0.0  # the VRU must stand out by at least this much

    name = "geometric"
    needs_shares = False
    needs_pictures = False

    def __post_init__(self) -> None:
        if not 0.0 <= self.min_iou < 1.0:
            raise InputError("detector.min_iou", self.min_iou, "0 <= IoU < 1")
        if not (np.isfinite(self.min_box_height_px) and self.min_box_height_px >= 0.0):
            raise InputError(
                "detector.min_box_height_px", self.min_box_height_px, "pixels, at least 0"
            )
        if not 0.0 <= self.min_contrast <= 1.0:
            raise InputError("detector.min_contrast", self.min_contrast, "0 .. 1")

    @property
    def description(self) -> str:
        """When it detects."""
        return (
            "A road user counts as detected in a frame if the box around its visible part overlaps "
            f"the box around all of it by more than {self.min_iou:g} (intersection over union), is "
            f"at least {self.min_box_height_px:g} pixels high, and light and air leave it a "
            f"contrast of at least {100.0 * self.min_contrast:g} %."
        )

    def is_expected(self, evidence: Evidence) -> BoolArray:
        """Rows that it detects, (n,)."""
        expected: BoolArray = (
            (iou(evidence.visible_px, evidence.amodal_px) > self.min_iou)
            & (box_height_px(evidence.visible_px) >= self.min_box_height_px)
            & (evidence.contrast >= self.min_contrast)
        )
        return expected

    def least_height_px(self, evidence: Evidence) -> FloatArray:
        """The least height where the contrast is enough, infinite elsewhere, (n,)."""
        is_clear = np.broadcast_to(evidence.contrast >= self.min_contrast, len(evidence))
        return np.where(is_clear, self.min_box_height_px, np.inf)

    def detect(self, evidence: Evidence, rng: np.random.Generator) -> Detections:
        """The visible boxes of what it detects; `rng` is not used."""
        rows = np.flatnonzero(self.is_expected(evidence))
        return Detections(
            row_index=rows, boxes_px=evidence.visible_px[rows], confidence=np.ones(len(rows))
        )

    def fingerprint(self) -> tuple[object, ...]:
        """Everything that it depends on."""
        return (self.name, self.min_iou, self.min_box_height_px, self.min_contrast)


@cache
def load_min_iou() -> float:
    """Overlap (IoU) that a box must exceed to count, from ``data/detectors.toml``."""
    file = "detectors.toml"
    table = load_toml(files(__package__) / "data" / file)
    return take_number(table["box_rule"], "min_iou", f"{file}: box_rule")


def is_matched(detections: Detections, truth_px: FloatArray, *, min_iou: float) -> BoolArray:
    """Rows in which some detection overlaps the VRU's box by more than `min_iou`, (n,).

    `truth_px` (n, 4) is the box of the VRU's visible part, as in the study.
    """
    matched = np.zeros(len(truth_px), dtype=bool)
    hits = iou(detections.boxes_px, truth_px[detections.row_index]) > min_iou
    matched[detections.row_index[hits]] = True
    return matched
