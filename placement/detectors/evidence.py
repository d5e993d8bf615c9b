"""Image evidence and detections, detectors' interface, matching of boxes."""

from collections.abc import Callable, Collection, Hashable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from geometry.actors import Actor
from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.image_boxes import iou
from geometry.phrases import Phrase
from geometry.tables import read_table, take, take_number
from geometry.text_formats import load_data

VRU_CLASSES = ("pedestrian", "child", "cyclist", "motorcyclist", "car")
# Between the heights of Euro NCAP's child (1.154 m) and adult (1.8 m) targets.
_ADULT_FROM_M = 1.4

Image = NDArray[np.uint8]


def vru_class(actor: Actor) -> str:
    """Class of a road user, one of ``VRU_CLASSES``.

    A pedestrian below 1.4 m is a child.
    """
    if actor.class_name == "pedestrian" and actor.height_m < _ADULT_FROM_M:
        return "child"
    return actor.class_name


def aspects_deg(sightline_m: FloatArray, yaw_deg: FloatArray) -> FloatArray:
    """Angle between the line of sight and the VRU's heading.

    Parameters
    ----------
    sightline_m : (n, 2) float
        From the sensor to the VRU, on the ground. [m]
    yaw_deg : (n,) float
        Heading of the VRU. [deg]

    Returns
    -------
    aspect_deg : (n,) float
        0 from behind or ahead, 90 from the side. [deg]

    Examples
    --------
    >>> sightline_m = np.array([[1.0, 0.0], [1.0, 0.0]])
    >>> aspects_deg(sightline_m, np.array([180.0, 80.0])).round(9)
    array([ 0., 80.])
    """
    turned = yaw_deg - np.degrees(np.arctan2(sightline_m[:, 1], sightline_m[:, 0]))
    return np.abs((turned + 90.0) % 180.0 - 90.0)


@dataclass(frozen=True, slots=True)
class Interval:
    """A figure with its 95 % interval.

    Attributes
    ----------
    value : float
        The figure.
    low, high : float
        Ends of the interval.
    """

    value: float
    low: float
    high: float

    def times(self, factor: float) -> "Interval":
        """The figure and its interval, multiplied by a factor that is not negative."""
        return Interval(factor * self.value, factor * self.low, factor * self.high)


class Crop(NamedTuple):
    """A part of an image, perhaps at a lower resolution.

    Attributes
    ----------
    pixels : (h, w, 3) uint8
        RGB.
    left_px, top_px : float
        Its corner from the middle of the image, in pixels of the crop. [px]
    scale : float
        Pixels of the image per pixel of the crop.
    middle_px : (float, float)
        Middle of the image. [px]
    """

    pixels: Image
    left_px: float
    top_px: float
    scale: float
    middle_px: tuple[float, float]

    def to_image(self, boxes_px: FloatArray) -> FloatArray:
        """Boxes of the image, from boxes of the crop.

        Parameters
        ----------
        boxes_px : (n, 4) float
            In pixels of the crop. [px]

        Returns
        -------
        boxes_px : (n, 4) float
            In pixels of the image. [px]
        """
        corner = np.array([self.left_px, self.top_px] * 2)
        return np.asarray(
            (boxes_px + corner) * self.scale + np.array(self.middle_px * 2)
        )


class Crops(Protocol):
    """Crops around road users, by row of the evidence."""

    def key(self, row: int) -> Hashable:
        """Key of a row: equal for rows whose crops look the same."""

    def draw_all(self, rows: Sequence[int]) -> Iterable[tuple[int, Crop]]:
        """Rows and their crops, in any order."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """Image evidence: a row for each VRU in a unit's image in a frame.

    Attributes
    ----------
    visible_px, amodal_px : (n, 4) float
        Box of what is seen, and of the whole VRU inside the image; zeros where there
        is none. [px]
    contrast : (n,) or (1,) float
        Of the VRU against what is behind it, as light and air leave it.
    visible_share : (n,) or (1,) float
        Share that nothing occludes, of what the VRU covers inside the image.
    inside_share : (n,) or (1,) float
        Share of the VRU that the image's edges do not cut off.
    aspect_deg : (n,) or (1,) float
        Angle between the line of sight and the VRU's heading: 0 from behind or ahead,
        90 from the side. [deg]
    vru_class : (n,) or (1,) int
        Into ``VRU_CLASSES``.
    draw_index : (n,) int
        Rows with the same number share their random draw: the same frame of the same
        run in different weathers. Consecutive numbers are consecutive frames.
    picture : callable, optional
        From a row to its image, (h, w, 3) uint8, RGB.
    crops : Crops, optional
        Crops of the images around the VRUs.
    """

    visible_px: FloatArray
    amodal_px: FloatArray
    contrast: FloatArray = field(default_factory=lambda: np.ones(1))
    visible_share: FloatArray = field(default_factory=lambda: np.ones(1))
    inside_share: FloatArray = field(default_factory=lambda: np.ones(1))
    aspect_deg: FloatArray
    vru_class: IntArray
    draw_index: IntArray
    picture: Callable[[int], Image] | None = None
    crops: Crops | None = None

    def __len__(self) -> int:
        return len(self.visible_px)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Detections:
    """Boxes that a detector finds: several in an image, or none.

    Attributes
    ----------
    row_index : (m,) int
        Row of the evidence in whose image each box lies.
    boxes_px : (m, 4) float
        [px]
    confidence : (m,) float
        0 to 1.
    """

    row_index: IntArray
    boxes_px: FloatArray
    confidence: FloatArray


_FILE = "detectors.toml"


@cache
def load_min_iou() -> float:
    """Overlap (IoU) that a box must exceed to count, from ``data/detectors.toml``."""
    table = detector_defaults()
    return take_number(table["box_rule"], "min_iou", f"{_FILE}: box_rule")


def is_matched(
    detections: Detections, truth_px: FloatArray, *, min_iou: float
) -> BoolArray:
    """Mask of rows in which a detection overlaps the VRU's box enough.

    Parameters
    ----------
    detections : Detections
        Boxes in the images of the rows.
    truth_px : (n, 4) float
        Box of the VRU's visible part, as in the study. [px]
    min_iou : float
        Overlap that a box must exceed.

    Returns
    -------
    matched : (n,) bool
    """
    matched = np.zeros(len(truth_px), dtype=bool)
    hits = iou(detections.boxes_px, truth_px[detections.row_index]) > min_iou
    matched[detections.row_index[hits]] = True
    return matched


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarTable:
    """Probability that a detector finds a VRU in the points of a LiDAR.

    Of the VRUs with enough points on them. The tuples have one entry for each class, in
    the order of ``VRU_CLASSES``.

    Attributes
    ----------
    name : str
        Of the table.
    distance_m : tuple of tuple of float
        Distances on the ground. [m]
    recall : tuple of tuple of float
        Shares found at these distances; straight lines between.
    frame_correlation : tuple of float
        Correlation between the random draws of consecutive frames.
    plan_probability : float
        A plan counts on a detection from this probability on.
    """

    name: str
    distance_m: tuple[tuple[float, ...], ...]
    recall: tuple[tuple[float, ...], ...]
    frame_correlation: tuple[float, ...]
    plan_probability: float

    @property
    def description(self) -> Phrase:
        """When it detects, in a sentence."""
        return Phrase(
            "For LiDARs, {name} draws at random which road users with enough points "
            "are detected, by class and distance. The detection table counts a frame "
            "as detected if its probability is at least {least:g}.",
            name=self.name,
            least=self.plan_probability,
        )

    def probability(self, distance_m: FloatArray, vru_class: IntArray) -> FloatArray:
        """Probability of a detection.

        Parameters
        ----------
        distance_m : (n,) float
            On the ground, from the LiDAR to the VRU. [m]
        vru_class : (n,) int
            Into ``VRU_CLASSES``.

        Returns
        -------
        probability : (n,) float
        """
        curves = zip(self.distance_m, self.recall, strict=True)
        by_class = [np.interp(distance_m, far, shares) for far, shares in curves]
        return np.choose(vru_class, by_class)

    def is_expected(self, distance_m: FloatArray, vru_class: IntArray) -> BoolArray:
        """Mask of rows that are detected with at least `plan_probability`, (n,)."""
        return self.probability(distance_m, vru_class) >= self.plan_probability

    def detect(
        self,
        distance_m: FloatArray,
        vru_class: IntArray,
        draw_index: IntArray,
        rng: np.random.Generator,
    ) -> BoolArray:
        """Draw which rows are detected.

        Parameters
        ----------
        distance_m : (n,) float
            On the ground, from the LiDAR to the VRU. [m]
        vru_class : (n,) int
            Into ``VRU_CLASSES``.
        draw_index : (n,) int
            Rows with the same number share their draw.
        rng : Generator
            Of the draws.

        Returns
        -------
        detected : (n,) bool
        """
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
    """Standard normal numbers, each correlated with that of the frame before.

    Parameters
    ----------
    draws : (n,) int
        Numbers of the frames, ascending. A frame is linked to the one before only if
        its number is the next one.
    correlation : float or (n,) float
        With the frame before.
    rng : Generator
        Of the numbers.

    Returns
    -------
    noise : (n,) float
    """
    fresh = rng.standard_normal(len(draws))
    linked = fresh.copy()
    links = np.broadcast_to(correlation, len(draws))
    steps = np.sqrt(1.0 - links**2)
    for index in np.flatnonzero(np.diff(draws) == 1) + 1:
        linked[index] = links[index] * linked[index - 1] + steps[index] * fresh[index]
    return linked


class Detector(Protocol):
    """What every detector does: image evidence in, boxes with confidence out."""

    @property
    def lidar(self) -> LidarTable | None:
        """Table of what LiDARs find; None: enough points are a detection."""

    @property
    def name(self) -> str:
        """Name in reports."""

    @property
    def description(self) -> Phrase:
        """When it detects, in a sentence or two."""

    @property
    def min_box_height_px(self) -> float:
        """Height below which nothing is ever detected, in pixels."""

    @property
    def needs_pictures(self) -> bool:
        """True if it looks at images."""

    @property
    def plans_with(self) -> str:
        """Name of the detector by which poses are chosen; empty: itself."""

    @property
    def seconds_per_picture(self) -> float:
        """Processor seconds to draw a picture and look at it; 0: it needs none."""

    @property
    def figures_words(self) -> Phrase:
        """How many of its figures are measured; empty where it has none."""

    def check_classes(self, classes: Iterable[str]) -> None:
        """Raise InputError where it does not know a class of ``VRU_CLASSES``."""

    def assumed_words(self, classes: Collection[str]) -> Phrase:
        """That nothing is measured of some of `classes`; empty where it is of all."""

    def detect(self, evidence: Evidence, rng: np.random.Generator) -> Detections:
        """Find VRUs; what is left to chance is drawn from `rng`."""


class PlanningDetector(Detector, Protocol):
    """A detector whose success can be predicted without an image."""

    @property
    def is_drawn(self) -> bool:
        """True if it finds people with a probability, not by a rule."""

    def is_expected(self, evidence: Evidence) -> BoolArray:
        """Mask of rows in which a plan may count on a detection, (n,)."""

    def least_height_px(self, evidence: Evidence) -> FloatArray:
        """Height of the visible box from which on `is_expected` is true.

        Parameters
        ----------
        evidence : Evidence
            VRUs of which nothing is hidden. The boxes are not looked at.

        Returns
        -------
        least_px : (n,) float
            Infinite if no height is enough. [px]
        """

    def fingerprint(self) -> tuple[Any, ...]:
        """Values that `is_expected` depends on."""


# ---------- numbers of the defaults
@cache
def detector_defaults() -> dict[str, Any]:
    """Document ``data/detectors.toml``."""
    return load_data(__package__, _FILE)


def limits_of(section: str) -> dict[str, Any]:
    """Numbers of a section, by the detector's fields."""
    return read_table(
        take(detector_defaults(), section, _FILE),
        dict[str, float],
        f"{_FILE}: {section}",
    )
