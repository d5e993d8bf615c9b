"""Annotated boxes next to what a detector found, and how long it takes to confirm a track."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.errors import InputError, Unquoted

from ..detectors import VRU_CLASSES
from ..detectors.fitting import LabelledPicture
from .formats import RecordedBoxes

HIDDEN_SHARES = (1.0, 0.75, 0.25)
"""Share seen at KITTI's levels in view, partly and largely hidden: assumed, half of it or more."""

_FROM_THE_SIDE_DEG = 90.0
_MOSTLY = 0.5  # a box of which more lies in a region to ignore does not count
_LEAST_FRAMES = 10  # with boxes, to tell a frame rate
_OUTSIDE_FRAMES = (
    10  # detections may go on for so long where nobody is annotated any more
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairedBoxes:
    """Pictures of a recording, and which of its boxes their labels are."""

    pictures: tuple[LabelledPicture, ...]
    label_index: (
        IntArray  # (n,): into the annotated boxes, in the order of the pictures' labels
    )


def pair_boxes(
    annotated: RecordedBoxes,
    found: RecordedBoxes,
    *,
    classes: Mapping[str, str],
    min_score: float,
    first_track: int = 0,
    n_frames: int | None = None,
) -> PairedBoxes:
    """Pictures with labels of some classes, and the boxes of at least `min_score` found in them.

    `classes` are those that are annotated, and the road users that they are. Boxes
    mostly in a region to ignore, or on other annotated things, are no false alarms.
    Tracks are numbered from `first_track` on. `n_frames` were recorded; by default as
    many as have boxes. Raises InputError if nobody of these classes is annotated, or
    frames of the two files do not belong together.
    """
    is_label = annotated.is_class(*classes) & (annotated.track >= 0)
    if not is_label.any():
        got = Unquoted("nobody")
        raise InputError(
            annotated.source, got, "boxes with an id of " + ", ".join(classes)
        )
    last = int(annotated.frame.max())
    if len(found) and found.frame.max() > max(last, n_frames or 0) + _OUTSIDE_FRAMES:
        got = Unquoted(f"frames up to {found.frame.max()}")
        expected = f"up to {last}, as in {annotated.source}: the same frame rate"
        raise InputError(found.source, got, expected)
    steps = _step(annotated.frame), _step(found.frame)
    if 0 not in steps and steps[0] != steps[1]:
        got = Unquoted(f"a frame in {steps[1]}")
        expected = f"one in {steps[0]}, as in {annotated.source}: the same frame rate"
        raise InputError(found.source, got, expected)
    shares = seen_shares(annotated)
    tracks = np.unique(annotated.track, return_inverse=True)[1]
    kinds = np.array(
        [VRU_CLASSES.index(classes.get(n, "car")) for n in annotated.class_name]
    )
    counts = found.is_class(*classes) & (found.score >= min_score)
    pictures = []
    index = []
    for frame in range(last + 1 if n_frames is None else n_frames):
        here = np.flatnonzero(annotated.frame == frame)
        labels = here[is_label[here]]
        others = here[~is_label[here]]
        boxes = found.box_px[counts & (found.frame == frame)]
        index.append(labels)
        is_aside = (_overlap(boxes, annotated.box_px[others]) > _MOSTLY).any(axis=1)
        pictures.append(
            LabelledPicture(
                track=first_track,
                frame=frame,
                label_px=annotated.box_px[labels],
                label_class=kinds[labels],
                seen_share=shares[labels],
                contrast=np.ones(len(labels)),
                aspect_deg=np.full(len(labels), _FROM_THE_SIDE_DEG),
                found_px=boxes,
                alone_px=boxes[~is_aside],
                label_track=first_track + tracks[labels],
            )
        )
    return PairedBoxes(pictures=tuple(pictures), label_index=np.concatenate(index))


def _step(frame: IntArray) -> int:
    """How far apart frames with boxes are, at least; 0 where there are too few to tell."""
    frames = np.unique(frame)
    if len(frames) >= _LEAST_FRAMES:
        return int(np.gcd.reduce(np.diff(frames)))
    return 0


def seen_shares(annotated: RecordedBoxes) -> FloatArray:
    """Share of each annotated box (n,) that is seen, as well as the recording tells it.

    As annotated; else by KITTI's level (see ``HIDDEN_SHARES``); else what the box of no
    single nearer person covers. A box whose lower side is further down is nearer.
    """
    shares = np.ones(len(annotated))
    for frame in np.unique(annotated.frame).tolist():
        rows = np.flatnonzero((annotated.frame == frame) & (annotated.track >= 0))
        boxes = annotated.box_px[rows]
        is_nearer = boxes[:, None, 3] < boxes[None, :, 3]
        shares[rows] -= np.where(is_nearer, _overlap(boxes, boxes), 0.0).max(
            axis=1, initial=0.0
        )
    level = annotated.hidden_level
    by_level = np.array([*HIDDEN_SHARES, 1.0])[level]
    shares = np.where(level >= 0, by_level, shares)
    return np.where(np.isnan(annotated.seen_share), shares, annotated.seen_share)


def _overlap(boxes: FloatArray, others: FloatArray) -> FloatArray:
    """Share of each box (n, 4) inside each of the others (m, 4), (n, m)."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    area = np.prod(np.maximum(high - low, 0.0), axis=2)
    whole = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)[:, None]
    return np.asarray(
        np.divide(area, whole, out=np.zeros_like(area), where=whole > 0.0)
    )


def frames_to_confirm(
    is_found: BoolArray, track: IntArray, frame: IntArray, *, n_confirmations: int
) -> IntArray:
    """Frames from each row (n,) on until its track is confirmed, both included.

    So many consecutive frames in which it is found confirm a track; 0: that never
    happens. Rows of a track are in the order of their frames.

    >>> found = np.array([True, False, True, True, True])
    >>> frames_to_confirm(found, np.zeros(5, int), np.arange(5), n_confirmations=3)
    array([5, 4, 3, 0, 0])
    """
    waits = np.zeros(len(is_found), dtype=np.int64)
    last_frame = -1
    last_track = -1
    end = 0
    n_row = 0
    # From the end: a row's own frames are the first of a stretch that is known by then.
    for row in range(len(is_found) - 1, -1, -1):
        if track[row] != last_track:
            end = 0
            n_row = 0
        is_next = track[row] == last_track and frame[row] + 1 == last_frame
        if is_found[row]:
            n_row = (n_row if is_next else 0) + 1
        else:
            n_row = 0
        last_frame = int(frame[row])
        last_track = int(track[row])
        if n_row >= n_confirmations:
            end = last_frame + n_confirmations
        if end:
            waits[row] = end - last_frame
        else:
            waits[row] = 0
    return waits
