"""A detector by boxes alone."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.errors import check_field
from geometry.image_boxes import box_height_px, iou
from geometry.phrases import Phrase, join_phrases

from .evidence import Detections, Evidence, LidarTable, limits_of, load_min_iou


@dataclass(frozen=True, slots=True, kw_only=True)
class GeometricDetector:
    """Detects by boxes alone: the same evidence always gives the same answer.

    Attributes
    ----------
    min_iou : float
        The box of the visible part must overlap that of the whole VRU (amodal) by more
        than this.
    min_box_height_px : float
        Least height of the visible box. [px]
    min_contrast : float
        Least contrast of the VRU.
    name : str
        In reports.
    lidar : LidarTable, optional
        What LiDARs find.

    Raises
    ------
    InputError
        A limit is out of range.
    """

    min_iou: float
    min_box_height_px: float
    min_contrast: float = 0.0
    name: str = "geometric"
    lidar: LidarTable | None = None

    needs_pictures = False
    plans_with = ""
    seconds_per_picture = 0.0
    is_drawn = False

    def __post_init__(self) -> None:
        for field, is_valid, expected in (
            ("min_iou", 0.0 <= self.min_iou < 1.0, "0 <= IoU < 1"),
            (
                "min_box_height_px",
                0.0 <= self.min_box_height_px < np.inf,
                "pixels, at least 0",
            ),
            ("min_contrast", 0.0 <= self.min_contrast <= 1.0, "0 .. 1"),
        ):
            check_field(self, "detector", field, is_valid, expected)

    @property
    def description(self) -> Phrase:
        """When it detects."""
        words = Phrase(
            "A road user counts as detected in a frame if the box around its visible "
            "part overlaps the box around the whole road user by more than {iou:g} "
            "(intersection over union) and is at least {height:g} pixels high, and "
            "if the contrast that remains in the light and air is at least "
            "{contrast:g} %.",
            iou=self.min_iou,
            height=self.min_box_height_px,
            contrast=100.0 * self.min_contrast,
        )
        if self.lidar is None:
            return words
        return join_phrases([words, self.lidar.description], " ")

    @property
    def figures_words(self) -> Phrase:
        """Empty: it has no figures that are measured."""
        return Phrase("")

    def check_classes(self, classes: Iterable[str]) -> None:
        """Accept all classes: it looks at boxes alone."""

    def assumed_words(self, classes: Collection[str]) -> Phrase:
        """Empty: it has no figures."""
        return Phrase("")

    def is_expected(self, evidence: Evidence) -> BoolArray:
        """Mask of rows that it detects, (n,)."""
        return (
            (iou(evidence.visible_px, evidence.amodal_px) > self.min_iou)
            & (box_height_px(evidence.visible_px) >= self.min_box_height_px)
            & (evidence.contrast >= self.min_contrast)
        )

    def least_height_px(self, evidence: Evidence) -> FloatArray:
        """Least height where the contrast is enough, infinite elsewhere, (n,)."""
        is_clear = np.broadcast_to(
            evidence.contrast >= self.min_contrast, len(evidence)
        )
        return np.where(is_clear, self.min_box_height_px, np.inf)

    def detect(self, evidence: Evidence, rng: np.random.Generator) -> Detections:
        """Visible boxes of the rows that it detects; `rng` is not used."""
        rows = np.flatnonzero(self.is_expected(evidence))
        return Detections(
            row_index=rows,
            boxes_px=evidence.visible_px[rows],
            confidence=np.ones(len(rows)),
        )

    def fingerprint(self) -> tuple[object, ...]:
        """Values that it depends on."""
        numbers = (self.min_iou, self.min_box_height_px, self.min_contrast)
        # Nothing is added without a table for LiDARs, so that cached tables stay valid.
        if self.lidar:
            return ("geometric", *numbers, self.lidar)
        return ("geometric", *numbers)


@cache
def load_geometric(name: str) -> GeometricDetector:
    """The detector with the limits of a section of ``data/detectors.toml``."""
    return GeometricDetector(min_iou=load_min_iou(), **limits_of(name))
