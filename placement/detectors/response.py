"""A detector that misses with a probability: by height, share seen, class, aspect and contrast."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from geometry.arrays import BoolArray, FloatArray, IntArray, float_array
from geometry.errors import InputError
from geometry.image_boxes import box_height_px

from .evidence import VRU_CLASSES, Detections, Evidence

_POSITIVES = (
    "height_half_px",
    "height_steepness",
    "min_box_height_px",
    "contrast_half",
    "contrast_steepness",
)
_PROBABILITIES = ("cyclist_end_on", "box_noise_share", "frame_correlation", "plan_probability")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ResponseDetector:
    """Detects with a probability; each frame is drawn at random.

    Attributes
    ----------
    name : str
        "response", or the file that it comes from.
    seen_share, recall : (n,) float
        Share of the VRU that is seen, ascending from 0 to 1, and the probability of a correct
        detection there; linear between.
    height_half_px, height_steepness : float
        Factor 1 / (1 + (half / height)^steepness) of the visible box. [px]
    min_box_height_px : float
        Smaller boxes are never detected. [px]
    class_factor : (n_classes,) float
        In the order of ``VRU_CLASSES``.
    cyclist_end_on : float
        Factor for a cyclist seen from straight behind or ahead; 1 from the side.
    contrast_half, contrast_steepness : float
        Factor 1 / (1 + (half / contrast)^steepness), relative to that at full contrast.
    box_noise_share : float
        Standard deviation of each side, as a share of the box's width or height.
    frame_correlation : float
        Between the random draws of consecutive frames.
    plan_probability : float
        A plan counts on a detection from this probability on.
    """

    name: str
    seen_share: FloatArray
    recall: FloatArray
    height_half_px: float
    height_steepness: float
    min_box_height_px: float
    class_factor: FloatArray
    cyclist_end_on: float
    contrast_half: float
    contrast_steepness: float
    box_noise_share: float
    frame_correlation: float
    plan_probability: float

    needs_shares = True
    needs_pictures = False

    @property
    def description(self) -> str:
        """When it detects."""
        return (
            "Whether a road user is detected in a frame is drawn by the response model "
            f"{self.name}: the probability depends on its height in pixels, the share that is "
            "seen, its class, the side that it shows and its contrast in light and weather. The "
            "detection table counts on frames with a probability of at least "
            f"{self.plan_probability:g}."
        )

    def __post_init__(self) -> None:
        for field, length in (
            ("seen_share", len(self.seen_share)),
            ("recall", len(self.seen_share)),
            ("class_factor", len(VRU_CLASSES)),
        ):
            object.__setattr__(self, field, float_array(getattr(self, field), (length,), field))
        share = self.seen_share
        if len(share) < 2 or (share[0], share[-1]) != (0.0, 1.0) or (np.diff(share) <= 0.0).any():
            raise InputError("seen_share", share.tolist(), "shares that ascend from 0 to 1")
        for field in (*_PROBABILITIES, "recall", "class_factor"):
            values = np.atleast_1d(getattr(self, field))
            outside = values[~((values >= 0.0) & (values <= 1.0))]
            if len(outside):
                raise InputError(field, float(outside[0]), "0 .. 1")
        for field in _POSITIVES:
            value = getattr(self, field)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(field, value, "a number, > 0")

    def probability(self, evidence: Evidence) -> FloatArray:
        """Probability of a correct detection, (n,); 0 where nothing is seen."""
        height = box_height_px(evidence.visible_px)
        seen = evidence.visible_share * evidence.inside_share
        probability: FloatArray = (
            np.interp(seen, self.seen_share, self.recall)
            * _rising(height, half=self.height_half_px, steepness=self.height_steepness)
            * self.class_factor[evidence.vru_class]
            * self._aspect_factor(evidence.aspect_deg, evidence.vru_class)
            * self._contrast_factor(evidence.contrast)
        )
        return np.where(height >= max(self.min_box_height_px, 1.0e-9), probability, 0.0)

    def is_expected(self, evidence: Evidence) -> BoolArray:
        """Rows that are detected with at least `plan_probability`, (n,)."""
        expected: BoolArray = self.probability(evidence) >= self.plan_probability
        return expected

    def detect(self, evidence: Evidence, rng: np.random.Generator) -> Detections:
        """Draw which rows are detected, and the errors of their boxes."""
        draws, row_draw = np.unique(evidence.draw_index, return_inverse=True)
        chance = ndtr(_linked_noise(draws, self.frame_correlation, rng))[row_draw]
        noise = rng.standard_normal((len(draws), 4))[row_draw]
        probability = self.probability(evidence)
        rows = np.flatnonzero(chance < probability)
        boxes = evidence.visible_px[rows]
        size = np.tile(boxes[:, 2:] - boxes[:, :2], 2)
        return Detections(
            row_index=rows,
            boxes_px=boxes + self.box_noise_share * size * noise[rows],
            confidence=probability[rows],
        )

    def fingerprint(self) -> tuple[object, ...]:
        """Everything that `is_expected` depends on."""
        return (
            "response",
            *(getattr(self, name).tobytes() for name in ("seen_share", "recall", "class_factor")),
            *(getattr(self, name) for name in (*_POSITIVES, "cyclist_end_on", "plan_probability")),
        )

    def _aspect_factor(self, aspect_deg: FloatArray, vru_class: IntArray) -> FloatArray:
        end_on = np.cos(np.radians(aspect_deg)) ** 2
        factor = 1.0 - (1.0 - self.cyclist_end_on) * end_on
        return np.where(vru_class == VRU_CLASSES.index("cyclist"), factor, 1.0)

    def _contrast_factor(self, contrast: FloatArray) -> FloatArray:
        half, steepness = self.contrast_half, self.contrast_steepness
        full = _rising(np.ones(1), half=half, steepness=steepness)
        return _rising(contrast, half=half, steepness=steepness) / full


def _rising(values: FloatArray, *, half: float, steepness: float) -> FloatArray:
    """A curve that rises from 0 to 1 and is 0.5 at `half`."""
    powers = np.maximum(values, 0.0) ** steepness
    rising: FloatArray = powers / (powers + half**steepness)
    return rising


def _linked_noise(draws: IntArray, correlation: float, rng: np.random.Generator) -> FloatArray:
    """Standard normal numbers, each correlated with that of the frame before, (n,)."""
    fresh = rng.standard_normal(len(draws))
    linked = fresh.copy()
    step = np.sqrt(1.0 - correlation**2)
    for index in np.flatnonzero(np.diff(draws) == 1) + 1:
        linked[index] = correlation * linked[index - 1] + step * fresh[index]
    return linked
