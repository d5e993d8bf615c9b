"""Types of image evidence and detections, the interface of detectors, and the matching of boxes."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from geometry.actors import Actor
from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.image_boxes import iou
from geometry.tables import take_number
from geometry.text_formats import load_data

VRU_CLASSES = ("pedestrian", "child", "cyclist", "motorcyclist", "car")
_ADULT_FROM_M = (
    1.4  # between the heights of Euro NCAP's child (1.154 m) and adult (1.8 m) targets
)

Image = NDArray[np.uint8]


def vru_class(actor: Actor) -> str:
    """One of ``VRU_CLASSES``: a pedestrian below 1.4 m is a child."""
    if actor.class_name == "pedestrian" and actor.height_m < _ADULT_FROM_M:
        return "child"
    return actor.class_name


def aspects_deg(sightline_m: FloatArray, yaw_deg: FloatArray) -> FloatArray:
    """Angle between the line of sight (n, 2) on the ground and the VRU's heading (n,), in degrees.

    0 from behind or ahead, 90 from the side.

    >>> aspects_deg(np.array([[1.0, 0.0], [1.0, 0.0]]), np.array([180.0, 80.0])).round(9)
    array([ 0., 80.])
    """
    turned = yaw_deg - np.degrees(np.arctan2(sightline_m[:, 1], sightline_m[:, 0]))
    return np.abs((turned + 90.0) % 180.0 - 90.0)


@dataclass(frozen=True, slots=True)
class Interval:
    """A figure with its 95 % interval."""

    value: float
    low: float
    high: float

    def times(self, factor: float) -> "Interval":
        """All three multiplied by a factor that is not negative."""
        return Interval(factor * self.value, factor * self.low, factor * self.high)


class Crop(NamedTuple):
    """A part of an image, perhaps at a lower resolution."""

    pixels: Image  # (h, w, 3)
    # left_px, top_px: its corner from the middle of the image, in pixels of the crop
    left_px: float
    top_px: float
    scale: float  # pixels of the image per pixel of the crop
    middle_px: tuple[float, float]  # of the image

    def to_image(self, boxes_px: FloatArray) -> FloatArray:
        """Boxes (n, 4) of the crop in pixels of the image."""
        corner = np.array([self.left_px, self.top_px] * 2)
        return np.asarray(
            (boxes_px + corner) * self.scale + np.array(self.middle_px * 2)
        )


class Crops(Protocol):
    """Crops around road users, by row of the evidence."""

    def key(self, row: int) -> Hashable:
        """Equal for rows whose crops look the same."""

    def draw_all(self, rows: Sequence[int]) -> Iterable[tuple[int, Crop]]:
        """Rows and their crops."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """Image evidence: a row for each VRU in a unit's image in a frame."""

    # visible_px, amodal_px: (n, 4): box of what is seen, and of the whole VRU inside
    # the image; zeros where there is none. [px]
    visible_px: FloatArray
    amodal_px: FloatArray
    # (n,) or (1,): of the VRU against what is behind it, as light and air leave it
    contrast: FloatArray = field(default_factory=lambda: np.ones(1))
    # (n,) or (1,): share that nothing hides, of what the VRU covers inside the image
    visible_share: FloatArray = field(default_factory=lambda: np.ones(1))
    # (n,) or (1,): share of the VRU that the image's edges do not cut off
    inside_share: FloatArray = field(default_factory=lambda: np.ones(1))
    # (n,) or (1,): between the line of sight and the VRU's heading: 0 from behind or
    # ahead, 90 from the side
    aspect_deg: FloatArray
    vru_class: IntArray  # (n,) or (1,): into ``VRU_CLASSES``
    # (n,): rows with the same number share their random draw: the same frame of the
    # same run in different weathers. Consecutive numbers are consecutive frames.
    draw_index: IntArray
    picture: Callable[[int], Image] | None = (
        None  # from a row to its image, (h, w, 3) uint8, RGB
    )
    crops: Crops | None = None

    def __len__(self) -> int:
        return len(self.visible_px)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Detections:
    """Boxes that a detector finds; there may be several in an image, or none."""

    row_index: IntArray  # (m,): row of the evidence in whose image each box lies
    boxes_px: FloatArray  # (m, 4): boxes. [px]
    confidence: FloatArray  # (m,): 0 .. 1.


@cache
def load_min_iou() -> float:
    """Overlap (IoU) that a box must exceed to count, from ``data/detectors.toml``."""
    table = load_data(__package__, "detectors.toml")
    return take_number(table["box_rule"], "min_iou", "detectors.toml: box_rule")


def is_matched(
    detections: Detections, truth_px: FloatArray, *, min_iou: float
) -> BoolArray:
    """Rows in which some detection overlaps the VRU's box by more than `min_iou`, (n,).

    `truth_px` (n, 4) is the box of the VRU's visible part, as in the study.
    """
    matched = np.zeros(len(truth_px), dtype=bool)
    hits = iou(detections.boxes_px, truth_px[detections.row_index]) > min_iou
    matched[detections.row_index[hits]] = True
    return matched


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarTable:
    """What a detector finds in the points of a LiDAR, of those on whom there are enough of them.

    Of each class, in the order of ``VRU_CLASSES``: shares found at `distance_m`,
    straight lines between, and the correlation between the random draws of consecutive
    frames.
    """

    name: str
    distance_m: tuple[tuple[float, ...], ...]
    recall: tuple[tuple[float, ...], ...]
    frame_correlation: tuple[float, ...]
    plan_probability: float  # a plan counts on a detection from this probability on

    @property
    def description(self) -> str:
        """When it detects, in a sentence."""
        return (
            " What LiDARs find of those on whom there are enough points is drawn by"
            f" {self.name}, by class and distance; the detection table counts on frames"
            f" with a probability of at least {self.plan_probability:g}."
        )

    def probability(self, distance_m: FloatArray, vru_class: IntArray) -> FloatArray:
        """Probability of a detection on the ground so far away, (n,)."""
        curves = zip(self.distance_m, self.recall, strict=True)
        by_class = [np.interp(distance_m, far, shares) for far, shares in curves]
        return np.choose(vru_class, by_class)

    def is_expected(self, distance_m: FloatArray, vru_class: IntArray) -> BoolArray:
        """Rows that are detected with at least `plan_probability`, (n,)."""
        return self.probability(distance_m, vru_class) >= self.plan_probability

    def detect(
        self,
        distance_m: FloatArray,
        vru_class: IntArray,
        draw_index: IntArray,
        rng: np.random.Generator,
    ) -> BoolArray:
        """Draw which rows are detected, (n,); those of the same `draw_index` share their draw."""
        from scipy.special import ndtr

        draws, first, row_draw = np.unique(
            draw_index, return_index=True, return_inverse=True
        )
        links = np.array(self.frame_correlation)[vru_class[first]]
        chance = ndtr(linked_noise(draws, links, rng))[row_draw]
        return chance < self.probability(distance_m, vru_class)


def linked_noise(
    draws: IntArray, correlation: float | FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Standard normal numbers, each correlated with that of the frame before, (n,)."""
    fresh = rng.standard_normal(len(draws))
    linked = fresh.copy()
    links = np.broadcast_to(correlation, len(draws))
    steps = np.sqrt(1.0 - links**2)
    for index in np.flatnonzero(np.diff(draws) == 1) + 1:
        linked[index] = links[index] * linked[index - 1] + steps[index] * fresh[index]
    return linked


class Detector(Protocol):
    """Image evidence in, boxes with confidence out."""

    @property
    def lidar(self) -> LidarTable | None:
        """What LiDARs find beyond the rule that enough points are found; None: just that."""

    @property
    def name(self) -> str:
        """Its name in reports."""

    @property
    def description(self) -> str:
        """When it detects, in a sentence or two."""

    @property
    def min_box_height_px(self) -> float:
        """Height below which nothing is ever detected, in pixels."""

    @property
    def needs_pictures(self) -> bool:
        """True if it looks at images."""

    def detect(self, evidence: Evidence, rng: np.random.Generator) -> Detections:
        """Find VRUs; what is left to chance is drawn from `rng`."""


class PlanningDetector(Detector, Protocol):
    """A detector whose success can be predicted without an image."""

    def is_expected(self, evidence: Evidence) -> BoolArray:
        """Rows in which a plan may count on a detection, (n,)."""

    def least_height_px(self, evidence: Evidence) -> FloatArray:
        """Height of the visible box from which on `is_expected` is true, (n,); infinite if none is.

        Of VRUs whose visible box is that of the whole; the boxes of the evidence are
        not looked at.
        """

    def fingerprint(self) -> tuple[Any, ...]:
        """Everything that `is_expected` depends on."""
