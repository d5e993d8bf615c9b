"""Response tables fitted to what a detector found, and its false alarms.

The probabilities of :class:`ResponseDetector` are fitted by maximum likelihood to
frames in which a road user could be detected, and was or was not. Frames of one camera
and one run resemble one another, so that intervals count such tracks, not frames.
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import astuple, dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss

from geometry.arrays import BoolArray, FloatArray, IntArray, float_array
from geometry.errors import InputError, refuse
from geometry.image_boxes import box_height_px, iou

from .evidence import VRU_CLASSES, Evidence, Interval, load_min_iou
from .response import ResponseDetector, built_in_response

# ---------- sightings and false alarms
# Boxes of consecutive frames that overlap by more are of one thing.
_SAME_ALARM_IOU = 0.3


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
        Between line of sight and heading: 0 from behind or ahead, 90 from the side.
        [deg]
    vru_class : (n,) int
        Into ``VRU_CLASSES``.
    is_found : (n,) bool
        A box of the detector overlaps the visible box by more than the study's IoU.
    box_error : (n, 4) float
        Left, upper, right and lower side of that box minus those of the visible one, as
        shares of its width or height; NaN where nothing is found.
    track : (n,) int
        Equal for frames of one camera and one run.
    frame : (n,) int
        Number of the frame: consecutive numbers of one track are consecutive frames.

    Raises
    ------
    InputError
        A value is out of range.
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
        """Sightings of some rows, in the given order."""
        return Sightings(**{name: getattr(self, name)[rows] for name in self.__slots__})

    def evidence(self) -> Evidence:
        """Evidence of a detector; only the height of the boxes is known."""
        box = np.zeros((len(self), 4))
        box[:, 2] = 0.4 * self.height_px
        box[:, 3] = self.height_px
        return Evidence(
            visible_px=box,
            amodal_px=box,
            contrast=self.contrast,
            visible_share=self.seen_share,
            aspect_deg=self.aspect_deg,
            vru_class=self.vru_class,
            draw_index=np.arange(len(self)),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabelledPicture:
    """A picture with its labels (n) and the boxes (m) found in it.

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
        Boxes that are false alarms where they overlap no label; by default all. A box
        around a person and a bicycle, say, is none next to these two. [px]
    is_whole : bool
        All of the picture was looked at: otherwise its false alarms are not counted.
    label_track : (n,) int, optional
        Track of each label, where each road user is a track of its own; by default the
        picture's.
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
    label_track: IntArray | None = None


def of_classes(
    pictures: Iterable[LabelledPicture],
    classes: Collection[str],
    left_out: Counter[str],
) -> Iterator[LabelledPicture]:
    """Pictures without the labels of classes that a detector does not report.

    A box on such a road user is no false alarm.

    Parameters
    ----------
    pictures : iterable of LabelledPicture
        Pictures with all labels.
    classes : collection of str
        Of ``VRU_CLASSES``: those that the detector reports.
    left_out : Counter of str
        Is given how many labels of which class are left out.
    """
    reported = [VRU_CLASSES.index(name) for name in classes]
    for one in pictures:
        stays = np.isin(one.label_class, reported)
        if stays.all():
            yield one
            continue
        left_out.update(VRU_CLASSES[kind] for kind in one.label_class[~stays].tolist())
        alone = one.alone_px
        if alone is None:
            alone = one.found_px
        on_others = iou(one.label_px[~stays][:, None], alone[None]) > 0.0
        is_on_other = on_others.any(axis=0)
        finds = one.finds
        if finds is not None:
            finds = finds[stays]
        label_track = one.label_track
        if label_track is not None:
            label_track = label_track[stays]
        yield replace(
            one,
            label_px=one.label_px[stays],
            label_class=one.label_class[stays],
            seen_share=one.seen_share[stays],
            contrast=one.contrast[stays],
            aspect_deg=one.aspect_deg[stays],
            finds=finds,
            alone_px=alone[~is_on_other],
            label_track=label_track,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class FalseAlarms:
    """Boxes on nothing, and tracks of them.

    Attributes
    ----------
    pictures : int
        Pictures that were looked at.
    alarms : int
        Boxes in them that overlap no label at all.
    per_picture : Interval
        Their rate.
    chances : int
        Pictures with enough consecutive ones before them to confirm a track.
    confirmed : int
        False tracks that were confirmed there.
    per_hour : Interval or None
        Of these, by one unit; None without consecutive pictures.
    """

    pictures: int
    alarms: int
    per_picture: Interval
    chances: int
    confirmed: int
    per_hour: Interval | None


class _Last(NamedTuple):
    """Last picture of a track.

    Attributes
    ----------
    frame : int
        Its number.
    n_row : int
        How many pictures there were in a row.
    alarms_px : (k, 4) float
        Its false alarms. [px]
    lasted : list of int
        For how many pictures each of them has been there.
    """

    frame: int
    n_row: int
    alarms_px: FloatArray
    lasted: list[int]


def gather_sightings(
    pictures: Iterable[LabelledPicture], *, n_confirmations: int, frame_rate_hz: float
) -> tuple[Sightings, FalseAlarms]:
    """Match boxes with labels, picture by picture, and count false alarms.

    Parameters
    ----------
    pictures : iterable of LabelledPicture
        Those of a track in the order of their frames.
    n_confirmations : int
        How many frames in a row confirm a track.
    frame_rate_hz : float
        Of the pictures. [Hz]

    Returns
    -------
    sightings : Sightings
        A row for each label, in their order; a box finds one of them.
    alarms : FalseAlarms
        A false track lasts while its boxes of consecutive frames overlap by an IoU of
        more than 0.3, and is counted once.
    """
    rows: list[FloatArray] = []
    n_pictures = n_alarms = n_chances = n_confirmed = 0
    # Last picture of each track.
    last: dict[int, _Last] = {}
    for one in pictures:
        overlap = iou(one.label_px[:, None], one.found_px[None])
        n_labels = len(one.label_px)
        track = one.label_track
        if track is None:
            track = np.full(n_labels, one.track)
        columns = [
            box_height_px(one.label_px),
            one.seen_share,
            one.contrast,
            one.aspect_deg,
            one.label_class,
            track,
            np.full(n_labels, one.frame),
            _errors(one, overlap),
        ]
        rows.append(np.column_stack(columns))
        if not one.is_whole:
            continue
        # False alarms: boxes that overlap no label.
        n_pictures += 1
        alarms = find_alarms_px(one)
        n_alarms += len(alarms)
        # False tracks go on from the picture before, if that is the one before.
        before = last.get(one.track)
        if before is None or one.frame != before.frame + 1:
            before = _Last(0, 0, alarms[:0], [])
        n_row = before.n_row + 1
        lasted = _lasting(before, alarms)
        n_chances += n_row >= n_confirmations
        n_confirmed += lasted.count(n_confirmations)
        last[one.track] = _Last(one.frame, n_row, alarms, lasted)
    # Columns in the order above; the last four are the errors of the boxes.
    table = np.concatenate([np.empty((0, 11)), *rows]).T
    height, seen, contrast, aspect = table[:4]
    kind, tracks, frames = table[4:7].astype(np.int64)
    box_error = table[7:].T
    sightings = Sightings(
        height_px=height,
        seen_share=seen,
        contrast=contrast,
        aspect_deg=aspect,
        vru_class=kind,
        is_found=np.isfinite(box_error).all(axis=1),
        box_error=box_error,
        track=tracks,
        frame=frames,
    )
    per_hour = None
    if n_chances:
        per_frame = poisson(n_confirmed, n_chances)
        per_hour = per_frame.times(3600.0 * frame_rate_hz)
    alarms_found = FalseAlarms(
        pictures=n_pictures,
        alarms=n_alarms,
        per_picture=poisson(n_alarms, max(n_pictures, 1)),
        chances=n_chances,
        confirmed=n_confirmed,
        per_hour=per_hour,
    )
    return sightings, alarms_found


def find_alarms_px(picture: LabelledPicture) -> FloatArray:
    """Boxes of a picture that are on nothing and nobody, (n, 4), in pixels."""
    alone_px = picture.alone_px
    if alone_px is None:
        alone_px = picture.found_px
    overlap = iou(picture.label_px[:, None], alone_px[None])
    return alone_px[~(overlap > 0.0).any(axis=0)]


def _errors(picture: LabelledPicture, overlap: FloatArray) -> FloatArray:
    """Errors of the box that finds each label, (n, 4); NaN for none.

    Parameters
    ----------
    picture : LabelledPicture
        Labels and boxes.
    overlap : (n, m) float
        IoU of each label with each box.

    Returns
    -------
    error : (n, 4) float
        As in :class:`Sightings`.
    """
    from scipy.optimize import linear_sum_assignment

    error = np.full((len(picture.label_px), 4), np.nan)
    counted = np.where(overlap > load_min_iou(), overlap, 0.0)
    if picture.finds is not None:
        counted = np.where(picture.finds, counted, 0.0)
    # Each box finds one at most.
    label, box = linear_sum_assignment(counted, maximize=True)
    is_match = counted[label, box] > 0.0
    label = label[is_match]
    box = box[is_match]
    truth = picture.label_px[label]
    size = np.tile(truth[:, 2:] - truth[:, :2], 2)
    error[label] = (picture.found_px[box] - truth) / size
    return error


def _lasting(before: _Last, alarms_px: FloatArray) -> list[int]:
    """For how many consecutive pictures each alarm has been there.

    This picture included.
    """
    links = link_alarms(before.alarms_px, alarms_px)
    return [before.lasted[old] + 1 if old >= 0 else 1 for old in links]


def link_alarms(before_px: FloatArray, alarms_px: FloatArray) -> list[int]:
    """Which box of the picture before (n, 4) each of some boxes goes on from.

    -1 where there is none. Boxes of the same false track overlap by an IoU of more than
    0.3.
    """
    links = [-1] * len(alarms_px)
    overlap = iou(alarms_px[:, None], before_px[None])
    # The best pairs first, each box in one of them.
    for flat in np.argsort(-overlap, axis=None, kind="stable").tolist():
        new, old = divmod(flat, len(before_px))
        if overlap[new, old] <= _SAME_ALARM_IOU:
            continue
        links[new] = old
        overlap[new] = -1.0
        overlap[:, old] = -1.0
    return links


def wilson(n_found: int, n_all: int) -> Interval:
    """A share with its 95 % interval; 0 to 1 of nothing.

    References
    ----------
    E. B. Wilson, "Probable inference, the law of succession, and statistical
    inference", 1927.

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
    spread = np.sqrt(share * (1.0 - share) / n_all + (z / n_all / 2) ** 2)
    half = float(z / (1.0 + z**2 / n_all) * spread)
    return Interval(share, max(0.0, middle - half), min(1.0, middle + half))


def share_by_track(found: BoolArray, track: IntArray) -> Interval:
    """Share of frames found, with a 95 % interval that counts tracks.

    Tracks are drawn with repetition (bootstrap); the interval is never narrower than
    Wilson's.

    Parameters
    ----------
    found : (n,) bool
        Frames that were found.
    track : (n,) int
        Track of each frame.
    """
    plain = wilson(int(found.sum()), len(found))
    _, which = np.unique(track, return_inverse=True)
    frames = np.bincount(which)
    # One track says nothing about others.
    if len(frames) < 2:
        return Interval(plain.value, 0.0, 1.0)
    draws = np.random.default_rng(0).multinomial(
        len(frames), np.full(len(frames), 1.0 / len(frames)), size=_SHARE_DRAWS
    )
    shares = draws @ np.bincount(which, weights=found) / (draws @ frames)
    drawn = _interval(shares, plain.value)
    return Interval(plain.value, min(drawn.low, plain.low), max(drawn.high, plain.high))


def poisson(n_events: int, n_chances: float) -> Interval:
    """Events per chance, with the exact 95 % interval of a Poisson distribution.

    Raises
    ------
    ValueError
        `n_chances` is not positive.

    References
    ----------
    F. Garwood, "Fiducial limits for the Poisson distribution", 1936.

    Examples
    --------
    >>> poisson(0, 100)
    Interval(value=0.0, low=0.0, high=0.036...)
    """
    from scipy.stats import chi2

    if n_chances <= 0.0:
        raise ValueError(f"n_chances: got {n_chances}; expected more than 0")
    if n_events:
        low = float(chi2.ppf(0.025, 2 * n_events)) / 2.0
    else:
        low = 0.0
    high = float(chi2.ppf(0.975, 2 * n_events + 2)) / 2.0
    return Interval(n_events / n_chances, low / n_chances, high / n_chances)


# ---------- the table
SEEN_KNOTS = (0.0, 0.25, 0.5, 0.75, 0.9, 1.0)
"""Shares of the road user that are seen, between which recall is linear; 0 at 0."""

_LEAST_FRAMES = 50
# Least number of frames found, and of frames missed.
_LEAST_OF_EACH = 5
# How often parameters are drawn.
_DRAWS = 400
# How often tracks are drawn, for the share found.
_SHARE_DRAWS = 1000
# How often tracks are drawn, for figures that are no parameters.
_MOST_DRAWS = 60
# Step of a parameter between which slopes are taken.
_STEP = 1.0e-4
_KEYS = (
    *("height_half_px", "height_steepness", "min_box_height_px", "cyclist_end_on"),
    *("contrast_half", "contrast_steepness", "box_noise_share", "frame_correlation"),
)
_OTHERS = ("min_box_height_px", "box_noise_share", "frame_correlation")
# Most frames of one draw of tracks.
_MOST_PER_DRAW = 20_000
# How many frames the built-in table weighs. It decides what no frame tells.
_PRIOR_FRAMES = 2.0
# How far parameters may go from the built-in table: logits of shares, logarithms of the
# others.
# Index of the end-on factor, after the ratios of recalls.
_END_ON = len(SEEN_KNOTS) - 1
# Parameters that are factors of classes.
_CLASSES = slice(_END_ON + 3, _END_ON + 3 + len(VRU_CLASSES))
_REACH = np.array(
    [6.0] * (_END_ON + 1) + [1.5] * 2 + [3.0] * len(VRU_CLASSES) + [1.5] * 2
)
# Contrasts that differ less say nothing about contrast.
_CONTRAST_SPREAD = 0.02
# No frame is impossible: a label may be wrong.
_PROBABILITY = (1.0e-4, 1.0 - 1.0e-4)
_MAX_CORRELATION = 0.98
_INTERVAL = (0.025, 0.975)


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Frames that have something in common.

    Attributes
    ----------
    name : str
        What they have in common.
    frames, found : int
        How many there are, and how many were found.
    recall : Interval
        Share found; its interval counts tracks.
    expected : float
        Mean probability of the fitted table.
    """

    name: str
    frames: int
    found: int
    recall: Interval
    expected: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ResponseFit:
    """A fitted response table, how sure it is, and how well it predicts.

    Attributes
    ----------
    detector : ResponseDetector
        The table.
    intervals : mapping of str to Interval
        By the table's keys; recall as "recall[2]" and so on.
    calibration : tuple of Group
        By predicted probability.
    groups : mapping of str to tuple of Group
        By height, seen share, class, aspect, contrast.
    frames, found, tracks : int
        How many there were.
    is_contrast_fitted : bool
        Otherwise the built-in figures stand: all frames had one contrast.
    """

    detector: ResponseDetector
    intervals: Mapping[str, Interval]
    calibration: tuple[Group, ...]
    groups: Mapping[str, tuple[Group, ...]]
    frames: int
    found: int
    tracks: int
    is_contrast_fitted: bool


def fit_response(
    sightings: Sightings,
    *,
    name: str,
    seed: int = 0,
    draws: int = _DRAWS,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> ResponseFit:
    """Fit a response table to what was found.

    Parameters
    ----------
    sightings : Sightings
        At least 50 frames, at least five found and five missed.
    name : str
        Of the new table.
    seed : int
        Of the bootstrap.
    draws : int
        How many sets of figures are drawn for the intervals.
    progress : callable
        Called with the number of fits done, and of all.

    Returns
    -------
    fit : ResponseFit
        What no frame tells about, such as a class that never appears, is as in the
        built-in table, which weighs as much as two frames.

    Raises
    ------
    InputError
        There are too few frames.
    """
    n_found = int(sightings.is_found.sum())
    least = min(n_found, len(sightings) - n_found)
    if len(sightings) < _LEAST_FRAMES or least < _LEAST_OF_EACH:
        refuse(
            "frames with a road user",
            f"{len(sightings)}, {n_found} of them found",
            f"at least {_LEAST_FRAMES}, with {_LEAST_OF_EACH} found and"
            f" {_LEAST_OF_EACH} missed",
        )
    free = _free(sightings)
    progress(0, 2)
    best = _fit(sightings, free)
    detector = _finish(_detector(best, name), sightings)
    progress(1, 2)
    rng = np.random.default_rng(seed)
    values = _numbers(detector)
    spread = _table_spread(sightings, best, free, draws, rng)
    spread |= _other_spread(sightings, detector, draws, rng)
    progress(2, 2)
    probability = detector.probability(sightings.evidence())
    return ResponseFit(
        detector=detector,
        intervals={
            key: _interval(spread.get(key, np.full(1, value)), value)
            for key, value in values.items()
        },
        calibration=_by_bins(
            "", probability, np.linspace(0.0, 1.0, 11), sightings, probability
        ),
        groups=_groups(sightings, probability),
        frames=len(sightings),
        found=n_found,
        tracks=len(np.unique(sightings.track)),
        is_contrast_fitted=bool(free[-1]),
    )


def _interval(values: FloatArray, value: float) -> Interval:
    """A value with the range of 95 % of what was drawn around it."""
    low, high = np.quantile(values, _INTERVAL).tolist()
    return Interval(value, min(low, value), max(high, value))


# ---------- maximum likelihood
def _free(sightings: Sightings) -> BoolArray:
    """Mask of parameters about which the frames tell something.

    See :func:`_detector` for their order.
    """
    free = np.ones(len(_prior()), dtype=bool)
    is_there = np.isin(np.arange(len(VRU_CLASSES)), sightings.vru_class)
    free[_END_ON] = is_there[VRU_CLASSES.index("cyclist")]
    # Factors are relative to one another.
    free[_CLASSES] = is_there & (is_there.sum() > 1)
    free[_CLASSES.stop :] = float(np.std(sightings.contrast)) > _CONTRAST_SPREAD
    return free


def _fit(sightings: Sightings, free: BoolArray) -> FloatArray:
    """Parameters that make what was found most likely.

    Parameters
    ----------
    sightings : Sightings
        The frames.
    free : (n_parameters,) bool
        Parameters to fit; the others are the built-in ones.

    Returns
    -------
    values : (n_parameters,) float
        See :func:`_detector`.
    """
    from scipy.optimize import minimize

    evidence = sightings.evidence()
    found = sightings.is_found
    prior = _prior()

    def unlikeliness(values: FloatArray) -> float:
        away = values - prior[free]
        doubt = 0.5 * _PRIOR_FRAMES / len(prior) * float(away @ away)
        return doubt - float(_log_chance(_whole(values, free), evidence, found).sum())

    bounds = zip((prior - _REACH)[free], (prior + _REACH)[free], strict=True)
    result = minimize(unlikeliness, prior[free], method="L-BFGS-B", bounds=list(bounds))
    return _whole(result.x, free)


def _whole(values: FloatArray, free: BoolArray) -> FloatArray:
    """All parameters, of those that are free and the built-in ones.

    A class of which nothing is known is to the best of the others as in the built-in
    table.
    """
    prior = _prior()
    whole = prior.copy()
    whole[free] = values
    is_fitted = free[_CLASSES]
    if is_fitted.any():
        best = whole[_CLASSES][is_fitted].max()
        whole[_CLASSES][~is_fitted] += best - prior[_CLASSES][is_fitted].max()
    return whole


def _log_chance(values: FloatArray, evidence: Evidence, found: BoolArray) -> FloatArray:
    """Logarithm of the probability of what happened in each frame, (n,)."""
    probability = np.clip(_detector(values, "").probability(evidence), *_PROBABILITY)
    return np.log(np.where(found, probability, 1.0 - probability))


# ---------- how sure the figures are
def _table_spread(
    sightings: Sightings,
    best: FloatArray,
    free: BoolArray,
    draws: int,
    rng: np.random.Generator,
) -> dict[str, FloatArray]:
    """Figures of the table for parameters drawn around the best ones, by name.

    Parameters
    ----------
    sightings : Sightings
        The frames.
    best : (n_parameters,) float
        Fitted parameters.
    free : (n_parameters,) bool
        Parameters that were fitted.
    draws : int
        How many are drawn.
    rng : Generator
        Of the draws.

    Returns
    -------
    figures : dict of str to (draws,) float

    References
    ----------
    H. White, "Maximum likelihood estimation of misspecified models", 1982: the
    sandwich of curvature and of the scores' spread, whose scores are summed up by
    track.
    """
    evidence = sightings.evidence()
    found = sightings.is_found
    columns = []
    for index in np.flatnonzero(free).tolist():
        step = np.zeros(len(best))
        step[index] = _STEP
        above, below = (
            _log_chance(_whole((best + way * step)[free], free), evidence, found)
            for way in (1.0, -1.0)
        )
        columns.append((above - below) / (2.0 * _STEP))
    # The sandwich: curvature, from the scores of frames, around that of tracks.
    score = np.stack(columns, axis=1)
    bread = score.T @ score + _PRIOR_FRAMES / len(best) * np.eye(score.shape[1])
    by_track = np.zeros((int(sightings.track.max()) + 1, score.shape[1]))
    np.add.at(by_track, sightings.track, score)
    inverse = np.linalg.inv(bread)
    covariance = inverse @ (by_track.T @ by_track) @ inverse
    drawn = rng.multivariate_normal(best[free], covariance, size=draws, method="eigh")
    low = (_prior() - _REACH)[free]
    high = (_prior() + _REACH)[free]
    numbers = []
    for row in np.clip(drawn, low, high):
        table = _detector(_whole(row, free), "")
        numbers.append(_numbers(table))
    if not numbers:
        return {}
    return {key: np.array([one[key] for one in numbers]) for key in numbers[0]}


def _other_spread(
    sightings: Sightings,
    detector: ResponseDetector,
    draws: int,
    rng: np.random.Generator,
) -> dict[str, FloatArray]:
    """Figures that are no parameters, for drawn tracks, by name.

    Tracks are drawn with repetition (bootstrap).
    """
    numbers = []
    for _ in range(min(draws, _MOST_DRAWS)):
        chosen = sightings.take(_draw_tracks(sightings.track, rng))
        if chosen.is_found.any():
            numbers.append(_numbers(_finish(detector, chosen)))
    return {key: np.array([one[key] for one in numbers]) for key in _OTHERS if numbers}


def _prior() -> FloatArray:
    """Parameters of the built-in table, (n_parameters,); see :func:`_detector`."""
    table = built_in_response()
    recall = np.interp(SEEN_KNOTS[1:], table.seen_share, table.recall)
    ratios = recall / np.append(recall[1:], 1.0)
    factors = np.maximum(table.class_factor, 1.0e-3)
    shares = np.clip(np.array([*ratios, table.cyclist_end_on]), 1.0e-3, 1.0 - 1.0e-3)
    return np.concatenate(
        [
            np.log(shares / (1.0 - shares)),
            np.log([table.height_half_px, table.height_steepness]),
            np.log(factors / factors.max()),
            np.log([table.contrast_half, table.contrast_steepness]),
        ]
    )


def _detector(values: FloatArray, name: str) -> ResponseDetector:
    """The response table of parameters.

    Parameters
    ----------
    values : (n_parameters,) float
        Logits of the ratios of recalls and of the factor of a cyclist seen end-on, then
        logarithms of height, class factors and contrast.
    name : str
        Of the table.
    """
    table = built_in_response()
    shares = 1.0 / (1.0 + np.exp(-values[: _END_ON + 1]))
    # Each recall is a share of the next one, so that recall never falls with what is
    # seen.
    recall = np.cumprod(shares[:_END_ON][::-1])[::-1]
    half_px, steepness = np.exp(values[_END_ON + 1 : _CLASSES.start]).tolist()
    factor = np.exp(values[_CLASSES] - values[_CLASSES].max())
    contrast_half, contrast_steepness = np.exp(values[_CLASSES.stop :]).tolist()
    return replace(
        table,
        name=name,
        seen_share=np.array(SEEN_KNOTS),
        recall=np.append(0.0, recall),
        height_half_px=half_px,
        height_steepness=steepness,
        class_factor=factor,
        cyclist_end_on=float(shares[_END_ON]),
        contrast_half=contrast_half,
        contrast_steepness=contrast_steepness,
    )


def _finish(detector: ResponseDetector, sightings: Sightings) -> ResponseDetector:
    """The table with the figures that are no parameters.

    They are the noise of boxes, the correlation of frames, and the least height found.
    """
    errors = sightings.box_error[sightings.is_found]
    middle = np.median(errors, axis=0)
    # 1.4826 times the median deviation is the spread of a normal distribution.
    noise = 1.4826 * float(np.median(np.abs(errors - middle)))
    probability = detector.probability(sightings.evidence())
    return replace(
        detector,
        box_noise_share=min(noise, 1.0),
        frame_correlation=_frame_correlation(sightings, probability),
        min_box_height_px=max(
            1.0, float(sightings.height_px[sightings.is_found].min())
        ),
        assumed=tuple(
            n for i, n in enumerate(VRU_CLASSES) if i not in sightings.vru_class
        ),
    )


def _numbers(detector: ResponseDetector) -> dict[str, float]:
    """Fitted figures of a table, by their names in it."""
    recall = {
        f"recall[{index}]": value
        for index, value in enumerate(detector.recall.tolist())
    }
    classes = dict(zip(VRU_CLASSES, detector.class_factor.tolist(), strict=True))
    return recall | classes | {key: float(getattr(detector, key)) for key in _KEYS}


def _draw_tracks(track: IntArray, rng: np.random.Generator) -> IntArray:
    """Rows of tracks drawn with repetition, at most 20,000.

    As many tracks as there are, as far as the rows allow.
    """
    order = np.argsort(track, kind="stable")
    _, starts, counts = np.unique(track[order], return_index=True, return_counts=True)
    drawn = rng.integers(len(starts), size=len(starts))
    ends = np.cumsum(counts[drawn])
    drawn = drawn[: max(1, int(np.searchsorted(ends, _MOST_PER_DRAW, side="right")))]
    return np.concatenate(
        [order[starts[one] : starts[one] + counts[one]] for one in drawn]
    )


# ---------- correlation of consecutive frames
def _frame_correlation(sightings: Sightings, probability: FloatArray) -> float:
    """Correlation behind consecutive frames that explains found pairs.

    That of the normal numbers that :class:`ResponseDetector` draws; 0 where no
    frames are consecutive.
    """
    from scipy.optimize import brentq
    from scipy.special import ndtri

    order = np.lexsort((sightings.frame, sightings.track))
    same = np.diff(sightings.track[order]) == 0
    next_ = same & (np.diff(sightings.frame[order]) == 1)
    first = order[:-1][next_]
    second = order[1:][next_]
    if not len(first):
        return 0.0
    levels = ndtri(np.clip(probability, *_PROBABILITY))
    both = float((sightings.is_found[first] & sightings.is_found[second]).sum())

    def surplus(correlation: float) -> float:
        joint = joint_normal(levels[first], levels[second], correlation)
        return float(joint.sum()) - both

    if surplus(0.0) >= 0.0:
        return 0.0
    if surplus(_MAX_CORRELATION) <= 0.0:
        return _MAX_CORRELATION
    return float(brentq(surplus, 0.0, _MAX_CORRELATION, xtol=1.0e-4))


# Distances between two frames of a track.
_DISTANCES = (1, 2, 3, 5, 8, 13, 21, 34, 55)
_CORRELATIONS = np.linspace(0.0, _MAX_CORRELATION, 50)
_SHARES = np.linspace(0.0, 0.95, 96)


def fit_lasting_share(
    sightings: Sightings,
    probability: FloatArray,
    *,
    draws: int = _SHARE_DRAWS,
) -> Interval:
    """Share of the variance behind a frame that lasts through its track.

    Frames of a track are correlated by s + (1 - s) r^distance, as
    :class:`LastingNoise` has it. Of all pairs 1 to 55 frames apart it is found
    which s and r make what was found and missed most likely, with each distance as
    heavy as another.

    Parameters
    ----------
    sightings : Sightings
        The frames.
    probability : (n,) float
        Of a detection in each frame.
    draws : int
        Number of samples of tracks, drawn with repetition, for the interval.

    Returns
    -------
    share : Interval
        s, with its 95 % interval.

    Raises
    ------
    InputError
        No frames are consecutive.

    References
    ----------
    C. Varin, N. Reid, D. Firth, "An overview of composite likelihood methods",
    Statistica Sinica 21 (2011).
    """
    tracks, which = np.unique(sightings.track, return_inverse=True)
    share, falling = (one.ravel() for one in np.meshgrid(_SHARES, _CORRELATIONS))
    # Log likelihood of each track's pairs by s and r: (n_tracks, n).
    likely = np.zeros((len(tracks), len(share)))
    for distance in _DISTANCES:
        by_correlation = _pair_likelihood(sightings, which, probability, distance)
        correlation = share + (1.0 - share) * falling**distance
        likely += [np.interp(correlation, _CORRELATIONS, row) for row in by_correlation]
    if not likely.any():
        refuse("frames", "none consecutive", "consecutive frames of a track")
    rng = np.random.default_rng(0)
    drawn = rng.multinomial(
        len(tracks), np.full(len(tracks), 1.0 / len(tracks)), size=draws
    )
    best = float(share[likely.sum(axis=0).argmax()])
    return _interval(share[(drawn @ likely).argmax(axis=1)], best)


def _pair_likelihood(
    sightings: Sightings, which: IntArray, probability: FloatArray, distance: int
) -> FloatArray:
    """Log likelihood of pairs so far apart, over the number of pairs.

    Parameters
    ----------
    sightings : Sightings
        The frames.
    which : (n,) int
        Track of each frame, from 0.
    probability : (n,) float
        Of a detection in each frame.
    distance : int
        Between the frames of a pair.

    Returns
    -------
    likely : (n_tracks, 50) float
        By track and correlation.
    """
    from scipy.special import ndtri

    likely = np.zeros((which.max() + 1, len(_CORRELATIONS)))
    order = np.lexsort((sightings.frame, sightings.track))
    first = order[:-distance]
    second = order[distance:]
    is_pair = which[first] == which[second]
    is_pair &= sightings.frame[second] - sightings.frame[first] == distance
    first = first[is_pair]
    second = second[is_pair]
    sign = np.where(sightings.is_found, 1.0, -1.0)
    level = sign * ndtri(np.clip(probability, *_PROBABILITY))
    same = sign[first] == sign[second]
    for column, correlation in enumerate(_CORRELATIONS):
        # Of one that is found and one that is missed, the noise of one is turned over.
        joint = joint_normal(
            level[first], level[second], np.where(same, correlation, -correlation)
        )
        np.add.at(likely[:, column], which[first], np.log(np.maximum(joint, 1.0e-12)))
    return likely / max(1, len(first))


def joint_normal(
    first: FloatArray, second: FloatArray, correlation: float | FloatArray
) -> FloatArray:
    """Probability that two correlated normal numbers lie below two limits.

    Parameters
    ----------
    first, second : (n,) float
        The limits of two standard normal numbers.
    correlation : float or (n,) float
        Between them.

    Returns
    -------
    probability : (n,) float

    References
    ----------
    Z. Drezner, G. Wesolowsky, "On the computation of the bivariate normal
    integral", 1990: the integral of the density over the correlation.
    """
    from scipy.special import ndtr

    nodes, weights = leggauss(20)
    # Over the arc sine of the correlation the integrand is smooth up to a correlation
    # of 1.
    angle = np.broadcast_to(np.arcsin(correlation), first.shape)
    sine = np.sin(0.5 * angle[:, None] * (nodes + 1.0))
    a = first[:, None]
    b = second[:, None]
    density = np.exp(-0.5 * (a**2 - 2.0 * sine * a * b + b**2) / (1.0 - sine**2))
    return np.asarray(
        ndtr(first) * ndtr(second) + density @ weights * angle / (4.0 * np.pi)
    )


def correlation_at(correlation: float, *, from_hz: float, to_hz: float) -> float:
    """Correlation of consecutive frames at another frame rate.

    It falls off exponentially with time, as that of the linked draws does.

    Examples
    --------
    >>> round(correlation_at(0.64, from_hz=10.0, to_hz=20.0), 9)
    0.8
    """
    return float(correlation ** (from_hz / to_hz))


def at_frame_rate(fit: ResponseFit, *, from_hz: float, to_hz: float) -> ResponseFit:
    """The fit with the frame correlation of another frame rate."""
    key = "frame_correlation"
    figures = astuple(fit.intervals[key])
    there = Interval(
        *(correlation_at(one, from_hz=from_hz, to_hz=to_hz) for one in figures)
    )
    return replace(
        fit,
        detector=replace(fit.detector, frame_correlation=there.value),
        intervals={**fit.intervals, key: there},
    )


# ---------- recall by group
def calibration_error(probability: FloatArray, found: BoolArray) -> float:
    """Mean difference of predicted and found shares in ten bins.

    Each bin weighs as much as it has frames.

    Parameters
    ----------
    probability : (n,) float
        Predicted; divides the frames into bins.
    found : (n,) bool
        What was found.

    References
    ----------
    M. Naeini et al., "Obtaining well calibrated probabilities using Bayesian binning",
    2015.

    Examples
    --------
    >>> found = np.array([False, False, True, True])
    >>> calibration_error(np.array([0.2, 0.2, 0.7, 0.7]), found)
    0.25
    """
    bins = np.clip((probability * 10.0).astype(np.int64), 0, 9)
    off = np.bincount(bins, weights=probability - found, minlength=10)
    return float(np.abs(off).sum() / len(found))


_HEIGHT_EDGES_PX = (0.0, 20.0, 30.0, 40.0, 60.0, 80.0, 120.0, np.inf)
_SHARE_EDGES = (0.0, 0.25, 0.5, 0.75, 0.95, 1.0)
_ASPECT_EDGES_DEG = (0.0, 22.5, 45.0, 67.5, 90.0)
_CONTRAST_EDGES = (0.0, 0.1, 0.3, 0.6, np.inf)


def _groups(
    sightings: Sightings, probability: FloatArray
) -> dict[str, tuple[Group, ...]]:
    """Groups by height, seen share, class, aspect and contrast."""
    by_class = [
        _group(kind, sightings.vru_class == number, sightings, probability)
        for number, kind in enumerate(VRU_CLASSES)
    ]
    return {
        "height": _by_bins(
            " px", sightings.height_px, _HEIGHT_EDGES_PX, sightings, probability
        ),
        "seen": _by_bins(
            "", sightings.seen_share, _SHARE_EDGES, sightings, probability
        ),
        "class": tuple(group for group in by_class if group.frames),
        "aspect": _by_bins(
            " deg", sightings.aspect_deg, _ASPECT_EDGES_DEG, sightings, probability
        ),
        "contrast": _by_bins(
            "", sightings.contrast, _CONTRAST_EDGES, sightings, probability
        ),
    }


def _by_bins(
    unit: str,
    values: FloatArray,
    edges: tuple[float, ...] | FloatArray,
    sightings: Sightings,
    probability: FloatArray,
) -> tuple[Group, ...]:
    """Groups between edges; empty ones are left out.

    The last one includes its upper edge.
    """
    bounds = [float(edge) for edge in edges]
    which = np.clip(
        np.searchsorted(bounds, values, side="right") - 1, 0, len(bounds) - 2
    )
    groups = []
    for number, (low, high) in enumerate(pairwise(bounds)):
        if np.isinf(high):
            words = f"{low:g}{unit} and more"
        else:
            words = f"{low:g} to {high:g}{unit}"
        groups.append(_group(words, which == number, sightings, probability))
    return tuple(group for group in groups if group.frames)


def _group(
    name: str, rows: BoolArray, sightings: Sightings, probability: FloatArray
) -> Group:
    """Figures of the frames in a mask (n,)."""
    found = sightings.is_found[rows]
    expected = 0.0
    if len(found):
        expected = float(probability[rows].mean())
    return Group(
        name=name,
        frames=len(found),
        found=int(found.sum()),
        recall=share_by_track(found, sightings.track[rows]),
        expected=expected,
    )
