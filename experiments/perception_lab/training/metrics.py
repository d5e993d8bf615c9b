"""How well boxes with confidence match labels.

Average precision, miss rate, recall by group.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.image_boxes import iou

_MISS_RATES_AT = np.logspace(-2.0, 0.0, 9)
"""False alarms per picture at which miss rates are averaged."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scored:
    """Boxes of one class in descending confidence, and what they are."""

    # (n,).
    confidence: FloatArray
    # (n,): first to overlap a label; others are false alarms.
    is_true: BoolArray
    # Labels that count.
    n_labels: int
    # Whole pictures' worth of pixels.
    n_pictures: float


def match_boxes(
    boxes_px: Sequence[FloatArray],
    confidence: Sequence[FloatArray],
    labels_px: Sequence[FloatArray],
    counts: Sequence[BoolArray],
    *,
    min_iou: float,
    n_pictures: float,
) -> Scored:
    """Match boxes (n, 4) of each image with labels (m, 4), the surest first.

    Labels that do not count (`counts` (m,)) are neither found nor missed, and boxes on
    them are no false alarms. Matching follows PASCAL VOC: a second box on a label is a
    false alarm.
    """
    rows: list[tuple[float, bool]] = []
    for found, sure, labels, valid in zip(
        boxes_px, confidence, labels_px, counts, strict=True
    ):
        is_taken = np.zeros(len(labels), dtype=bool)
        for index in np.argsort(-sure, kind="stable").tolist():
            if len(labels):
                overlap = iou(found[index][None], labels)
            else:
                overlap = np.zeros(0)
            if len(overlap):
                best = int(overlap.argmax())
            else:
                best = -1
            if best < 0 or overlap[best] <= min_iou:
                rows.append((float(sure[index]), False))
            elif valid[best]:
                rows.append((float(sure[index]), not is_taken[best]))
                is_taken[best] = True
    rows.sort(key=lambda row: -row[0])
    return Scored(
        confidence=np.array([row[0] for row in rows]),
        is_true=np.array([row[1] for row in rows], dtype=bool),
        n_labels=int(sum(valid.sum() for valid in counts)),
        n_pictures=n_pictures,
    )


def average_precision(scored: Scored) -> float:
    """Area below the curve of precision over recall, precision made to fall.

    References
    ----------
    .. [1] M. Everingham et al., "The PASCAL Visual Object Classes Challenge", 2015
       (from 2010 on:
       the area at all recalls).
    """
    if not scored.n_labels:
        return float("nan")
    n_true = np.cumsum(scored.is_true)
    precision = n_true / np.arange(1, len(n_true) + 1)
    falling = np.maximum.accumulate(precision[::-1])[::-1]
    return float((falling * scored.is_true).sum() / scored.n_labels)


def log_average_miss_rate(scored: Scored) -> float:
    """Geometric mean of miss rates at nine rates of false alarms.

    The rates are 0.01 to 1 per picture.

    References
    ----------
    .. [1] P. Dollar et al., "Pedestrian Detection: An Evaluation of the State of the
       Art", 2012.
    """
    if not scored.n_labels:
        return float("nan")
    alarms = np.cumsum(~scored.is_true) / scored.n_pictures
    missed = 1.0 - np.cumsum(scored.is_true) / scored.n_labels
    at = np.searchsorted(alarms, _MISS_RATES_AT, side="right") - 1
    if len(missed):
        rates = np.where(at >= 0, missed[np.maximum(at, 0)], 1.0)
    else:
        rates = np.ones(len(at))
    return float(np.exp(np.log(np.maximum(rates, 1.0e-10)).mean()))
