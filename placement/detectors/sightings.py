"""Boxes that a detector found beside the labels of the same pictures: sightings, false alarms."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray, float_array
from geometry.errors import InputError
from geometry.image_boxes import box_height_px, iou

from .box_rule import load_min_iou
from .evidence import Evidence, Interval

_SAME_ALARM_IOU = 0.3  # boxes of consecutive frames that overlap by more are of one thing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sightings:
    """Frames in which a detector could have found a road user, a row for each.

    Attributes
    ----------
    height_px : (n,) float
        Of the visible box. [px]
    seen_share : (n,) float
        Share of the road user that is seen: not hidden, and inside the image.
    contrast : (n,) float
        Against what is behind it, as light and air leave it.
    aspect_deg : (n,) float
        Between line of sight and heading: 0 from behind or ahead, 90 from the side. [deg]
    vru_class : (n,) int
        Into ``VRU_CLASSES``.
    is_found : (n,) bool
        Whether a box of the detector overlaps the visible box by more than the study's IoU.
    box_error : (n, 4) float
        Left, upper, right and lower side of that box minus those of the visible one, as shares of
        its width or height; NaN where nothing is found.
    track : (n,) int
        Equal for frames of one camera and one run.
    frame : (n,) int
        Number of the frame: consecutive numbers of one track are consecutive frames.
    """

    height_px: FloatArray
    seen_share: FloatArray
    contrast: FloatArray
    aspect_deg: FloatArray
    vru_class: IntArray
    is_found: BoolArray
    box_error: FloatArray
    track: IntArray
    frame: IntArray

    def __post_init__(self) -> None:
        n = len(self.height_px)
        for name, low, high in (
            ("height_px", 0.0, np.inf),
            ("seen_share", 0.0, 1.0),
            ("contrast", 0.0, np.inf),
            ("aspect_deg", 0.0, 90.0),
        ):
            values = float_array(getattr(self, name), (n,), name)
            outside = values[~((values >= low) & (values <= high + 1.0e-9))]
            if len(outside):
                raise InputError(name, float(outside[0]), f"{low:g} .. {high:g}")

    def __len__(self) -> int:
        return len(self.height_px)

    def take(self, rows: IntArray) -> "Sightings":
        """Some of the rows, in the given order."""
        return Sightings(**{name: getattr(self, name)[rows] for name in self.__slots__})

    def evidence(self) -> Evidence:
        """As a detector is shown it; only the height of the boxes is known."""
        box = np.zeros((len(self), 4))
        box[:, 2], box[:, 3] = 0.4 * self.height_px, self.height_px
        return Evidence(
            visible_px=box,
            amodal_px=box,
            contrast=self.contrast,
            visible_share=self.seen_share,
            inside_share=np.ones(len(self)),
            aspect_deg=self.aspect_deg,
            vru_class=self.vru_class,
            draw_index=np.arange(len(self)),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabelledPicture:
    """A picture with its labels (n) and the boxes (m) that a detector found in it.

    Attributes
    ----------
    track : int
        Equal for pictures of one camera and one run.
    frame : int
        Its number: consecutive numbers of one track are consecutive frames.
    label_px : (n, 4) float
        Boxes around what is visible of the road users. [px]
    label_class : (n,) int
        Into ``VRU_CLASSES``.
    seen_share, contrast, aspect_deg : (n,) float
        As in :class:`Sightings`.
    found_px : (m, 4) float
        Boxes of the detector that count, of any class of road user. [px]
    finds : (n, m) bool, optional
        Which box is of a class that counts for which label; by default all are.
    alone_px : (k, 4) float, optional
        The boxes that are false alarms where they overlap no label; by default all. A box around a
        person and a bicycle, say, is none beside these two.
    is_whole : bool
        Whether all of the picture was looked at: otherwise its false alarms are not counted.
    """

    track: int
    frame: int
    label_px: FloatArray
    label_class: IntArray
    seen_share: FloatArray
    contrast: FloatArray
    aspect_deg: FloatArray
    found_px: FloatArray
    finds: BoolArray | None = None
    alone_px: FloatArray | None = None
    is_whole: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class FalseAlarms:
    """Boxes on nothing, and tracks of them."""

    pictures: int  # looked at
    alarms: int  # boxes in them that overlap no label at all
    per_picture: Interval
    chances: int  # pictures with enough consecutive ones before them to confirm a track
    confirmed: int  # false tracks that were confirmed there
    per_hour: Interval | None  # of these, by one unit; None without consecutive pictures


@dataclass(slots=True)
class _Open:
    """Alarms of a track's last picture, and how many pictures each has lasted."""

    frame: int
    boxes_px: FloatArray
    lasted: list[int] = field(default_factory=list)


def gather_sightings(
    pictures: Iterable[LabelledPicture], *, n_confirmations: int, frame_rate_hz: float
) -> tuple[Sightings, FalseAlarms]:
    """Match boxes with labels, picture by picture.

    Parameters
    ----------
    pictures : iterable of LabelledPicture
        Those of a track in the order of their frames.
    n_confirmations : int
        Frames in a row that confirm a track.
    frame_rate_hz : float
        Of consecutive pictures. [Hz]

    Returns
    -------
    sightings : Sightings
        A row for each label.
    alarms : FalseAlarms
        A false track lasts while its boxes of consecutive frames overlap by an IoU of more than
        0.3, and is counted once.
    """
    rows: list[FloatArray] = []
    n_pictures = n_alarms = n_chances = n_confirmed = 0
    in_a_row: dict[int, tuple[int, int]] = {}  # by track: last frame, and frames in a row
    open_: dict[int, _Open] = {}
    for one in pictures:
        overlap = iou(one.label_px[:, None], one.found_px[None])
        n_labels = len(one.label_px)
        rows.append(
            np.column_stack(
                [
                    box_height_px(one.label_px),
                    *(one.seen_share, one.contrast, one.aspect_deg, one.label_class),
                    *(np.full(n_labels, number) for number in (one.track, one.frame)),
                    _errors(one, overlap),
                ]
            )
        )
        if not one.is_whole:
            continue
        n_pictures += 1
        alone = one.found_px if one.alone_px is None else one.alone_px
        alarms = alone[~(iou(one.label_px[:, None], alone[None]) > 0.0).any(axis=0)]
        n_alarms += len(alarms)
        last, n_before = in_a_row.get(one.track, (one.frame, 0))
        n_row = n_before + 1 if one.frame == last + 1 else 1
        in_a_row[one.track] = (one.frame, n_row)
        n_chances += n_row >= n_confirmations
        lasted = _lasting(open_.get(one.track), one.frame, alarms)
        n_confirmed += lasted.count(n_confirmations)
        open_[one.track] = _Open(one.frame, alarms, lasted)
    columns = np.concatenate([np.empty((0, 11)), *rows]).T
    is_found: BoolArray = np.isfinite(columns[7:]).all(axis=0)
    return Sightings(
        height_px=columns[0],
        seen_share=columns[1],
        contrast=columns[2],
        aspect_deg=columns[3],
        vru_class=columns[4].astype(np.int64),
        is_found=is_found,
        box_error=columns[7:].T,
        track=columns[5].astype(np.int64),
        frame=columns[6].astype(np.int64),
    ), FalseAlarms(
        pictures=n_pictures,
        alarms=n_alarms,
        per_picture=poisson(n_alarms, max(n_pictures, 1)),
        chances=n_chances,
        confirmed=n_confirmed,
        per_hour=poisson(n_confirmed, n_chances).times(3600.0 * frame_rate_hz)
        if n_chances
        else None,
    )


def _errors(picture: LabelledPicture, overlap: FloatArray) -> FloatArray:
    """Errors of the box that overlaps each label best, as shares of its size; NaN for none."""
    error = np.full((len(picture.label_px), 4), np.nan)
    if not overlap.size:
        return error
    counted = overlap if picture.finds is None else np.where(picture.finds, overlap, 0.0)
    best = counted.argmax(axis=1)
    label = np.flatnonzero(counted.max(axis=1) > load_min_iou())
    truth = picture.label_px[label]
    size = np.tile(truth[:, 2:] - truth[:, :2], 2)
    error[label] = (picture.found_px[best[label]] - truth) / size
    return error


def _lasting(before: _Open | None, frame: int, alarms_px: FloatArray) -> list[int]:
    """In how many consecutive pictures each alarm has been there, this one included."""
    lasted = [1] * len(alarms_px)
    if before is None or before.frame != frame - 1 or not len(before.boxes_px):
        return lasted
    overlap = iou(alarms_px[:, None], before.boxes_px[None])
    # The best pairs first, each box in one of them.
    for flat in np.argsort(-overlap, axis=None, kind="stable").tolist():
        new, old = divmod(flat, len(before.boxes_px))
        if overlap[new, old] <= _SAME_ALARM_IOU:
            continue
        lasted[new] = before.lasted[old] + 1
        overlap[new], overlap[:, old] = -1.0, -1.0
    return lasted


def wilson(n_found: int, n_all: int) -> Interval:
    """A share with its 95 % interval; 0 .. 1 of nothing.

    References
    ----------
    .. [1] E. B. Wilson, "Probable inference, the law of succession, and statistical inference",
       1927.

    Examples
    --------
    >>> wilson(8, 10)
    Interval(value=0.8, low=0.49..., high=0.94...)
    """
    if not n_all:
        return Interval(0.0, 0.0, 1.0)
    z = 1.959964
    share = n_found / n_all
    middle = (share + z**2 / (2.0 * n_all)) / (1.0 + z**2 / n_all)
    half = z / (1.0 + z**2 / n_all) * np.sqrt(share * (1.0 - share) / n_all + (z / n_all / 2) ** 2)
    return Interval(share, max(0.0, middle - float(half)), min(1.0, middle + float(half)))


def poisson(n_events: int, n_chances: float) -> Interval:
    """Events per chance, with the exact 95 % interval of a Poisson distribution.

    References
    ----------
    .. [1] F. Garwood, "Fiducial limits for the Poisson distribution", 1936.

    Examples
    --------
    >>> poisson(0, 100)
    Interval(value=0.0, low=0.0, high=0.036...)
    """
    from scipy.stats import chi2

    if n_chances <= 0.0:
        raise ValueError(f"n_chances: got {n_chances}; expected more than 0")
    low = float(chi2.ppf(0.025, 2 * n_events)) / 2.0 if n_events else 0.0
    high = float(chi2.ppf(0.975, 2 * n_events + 2)) / 2.0
    return Interval(n_events / n_chances, low / n_chances, high / n_chances)
