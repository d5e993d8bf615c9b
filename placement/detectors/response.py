"""A detector that finds people with a probability, and its tables."""

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray, float_array, set_arrays
from geometry.errors import InputError, check_one_of, refuse
from geometry.image_boxes import box_height_px, iou
from geometry.phrases import Phrase, join_phrases
from geometry.tables import Table, read_table, take_list, take_number
from geometry.text_formats import load_data, load_toml

from .evidence import (
    VRU_CLASSES,
    Detections,
    Evidence,
    Interval,
    LidarTable,
    detector_defaults,
    linked_noise,
    load_min_iou,
)

_POSITIVES = (
    "height_half_px",
    "height_steepness",
    "min_box_height_px",
    "contrast_half",
    "contrast_steepness",
)
# How often the error of a box is halved until it is correct.
_HALVINGS = 10
_PROBABILITIES = (
    "cyclist_end_on",
    "box_noise_share",
    "frame_correlation",
    "plan_probability",
)
_FIGURES = ("recall", *VRU_CLASSES, *_POSITIVES, *_PROBABILITIES[:-1])
"""What can be measured; the probability from which a plan counts is chosen."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LastingNoise:
    """Noise that stays the same in all frames of a run.

    The variances of all parts of the noise that decides a frame sum up to 1.

    Attributes
    ----------
    person : (n,) float
        Noise of whoever is there, for all units, by `draw_index`.
    person_share : float
        Its variance.
    unit_person_share : float
        Variance of what one unit and one person have in common.
    """

    person: FloatArray
    person_share: float
    unit_person_share: float

    @property
    def frame_share(self) -> float:
        """Variance of the noise that changes from frame to frame, 0 to 1."""
        return 1.0 - self.person_share - self.unit_person_share

    def frame_correlation(self, correlation: float) -> float:
        """Correlation between consecutive frames of the noise that changes.

        Parameters
        ----------
        correlation : float
            That of all noise, which must come out.

        Returns
        -------
        correlation : float
            0 where what lasts alone makes frames more alike than that.
        """
        lasting = self.person_share + self.unit_person_share
        if lasting < 1.0:
            return max(0.0, correlation - lasting) / (1.0 - lasting)
        return 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ResponseDetector:
    """Detects with a probability; each frame is drawn at random.

    Attributes
    ----------
    name : str
        "response", or the file that it comes from.
    seen_share, recall : (n,) float
        Share of the VRU that is seen, ascending from 0 to 1, and the probability of a
        correct detection there; linear between.
    height_half_px, height_steepness : float
        Factor 1 / (1 + (half / height)^steepness) of the visible box. [px]
    min_box_height_px : float
        Smaller boxes are never detected. [px]
    class_factor : (n_classes,) float
        In the order of ``VRU_CLASSES``.
    cyclist_end_on : float
        Factor of a cyclist seen from straight behind or ahead; 1 from the side.
    contrast_half, contrast_steepness : float
        Factor 1 / (1 + (half / contrast)^steepness), relative to that at full contrast.
    box_noise_share : float
        Standard deviation of each side, as a share of the box's width or height.
    frame_correlation : float
        Between the random draws of consecutive frames.
    plan_probability : float
        A plan counts on a detection from this probability on.
    assumed : tuple of str
        Classes of which nothing is measured.
    assumed_figures : tuple of str, optional
        Further figures that are assumed, by their keys; None: the file does not say.
    false_tracks_per_hour : Interval, optional
        Tracks of nothing that a unit confirms in an hour; None: unknown.
    lasting : LastingNoise, optional
        In a sampled world; None: all noise is that of frames.
    lidar : LidarTable, optional
        What LiDARs find.

    Raises
    ------
    InputError
        A figure is out of range, or the shares do not ascend from 0 to 1.
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
    assumed: tuple[str, ...] = ()
    assumed_figures: tuple[str, ...] | None = None
    false_tracks_per_hour: Interval | None = None
    lasting: LastingNoise | None = None
    lidar: LidarTable | None = None

    needs_pictures = False
    plans_with = ""
    seconds_per_picture = 0.0
    is_drawn = True

    @property
    def description(self) -> Phrase:
        """When it detects."""
        words = [
            Phrase(
                "The response model {name} draws at random whether a road user is "
                "detected in a frame. The probability depends on the road user's "
                "height in pixels, visible share, class, visible side, and contrast "
                "in the light and weather.",
                name=self.name,
            ),
            Phrase(
                "The detection table counts a frame as detected if its probability is "
                "at least {least:g}.",
                least=self.plan_probability,
            ),
        ]
        if self.assumed_words():
            words.append(self.assumed_words())
        if self.alarm_words:
            words.append(self.alarm_words)
        if self.lidar is not None:
            words.append(self.lidar.description)
        return join_phrases(words, " ")

    def assumed_words(self, classes: Collection[str] = VRU_CLASSES) -> Phrase:
        """Says that nothing is measured of some of `classes`.

        Empty where something is measured of all.
        """
        names = [name for name in self.assumed if name in classes]
        if not names:
            return Phrase("")
        factors = dict(zip(VRU_CLASSES, self.class_factor.tolist(), strict=True))
        *before, last = names
        words = Phrase(
            "{name} (factor {factor:g})", name=Phrase(last), factor=factors[last]
        )
        for name in reversed(before):
            words = Phrase(
                "{name} (factor {factor:g}) and {others}",
                name=Phrase(name),
                factor=factors[name],
                others=words,
            )
        return Phrase(
            "Assumed, not measured: how well the detector finds {classes}.",
            classes=words,
        )

    @property
    def figures_words(self) -> Phrase:
        """How many of its figures are measured, and which are assumed."""
        if self.assumed_figures is None:
            return Phrase(
                "{name} does not say which of its values are measured.", name=self.name
            )
        names = [
            one for one in _FIGURES if one in (*self.assumed, *self.assumed_figures)
        ]
        n_measured = len(_FIGURES) - len(names)
        if not names:
            return Phrase(
                "{measured} of the {n} values of {name} are measured.",
                n=len(_FIGURES),
                name=self.name,
                measured=n_measured,
            )
        return Phrase(
            "{measured} of the {n} values of {name} are measured; assumed: {names}.",
            n=len(_FIGURES),
            name=self.name,
            measured=n_measured,
            names=", ".join(names),
        )

    @property
    def alarm_words(self) -> Phrase:
        """How often something is confirmed where nothing is.

        Empty where that is unknown.
        """
        rate = self.false_tracks_per_hour
        if rate is None:
            return Phrase("")
        return Phrase(
            "In measurements on its pictures, a unit confirms {rate:.3g} false "
            "tracks per hour (95 %: {low:.3g} to {high:.3g}). Each may brake a car "
            "whose path it seems to cross. The verdicts do not include them.",
            rate=rate.value,
            low=rate.low,
            high=rate.high,
        )

    def __post_init__(self) -> None:
        n = (len(self.seen_share),)
        set_arrays(self, "", seen_share=n, recall=n, class_factor=(len(VRU_CLASSES),))
        share = self.seen_share
        if (
            len(share) < 2
            or (share[0], share[-1]) != (0.0, 1.0)
            or (np.diff(share) <= 0.0).any()
        ):
            raise InputError(
                "seen_share", share.tolist(), "shares that ascend from 0 to 1"
            )
        for field in (*_PROBABILITIES, "recall", "class_factor"):
            values = np.atleast_1d(getattr(self, field))
            outside = values[~((values >= 0.0) & (values <= 1.0))]
            if len(outside):
                raise InputError(field, float(outside[0]), "0 .. 1")
        for field in _POSITIVES:
            value = getattr(self, field)
            if not (np.isfinite(value) and value > 0.0):
                raise InputError(field, value, "a number, > 0")

    def check_classes(self, classes: Iterable[str]) -> None:
        """Accept all classes: it has a factor for each."""

    def probability(self, evidence: Evidence) -> FloatArray:
        """Probability of a correct detection, (n,); 0 where nothing is seen."""
        height = box_height_px(evidence.visible_px)
        probability = self._most(evidence) * _rising(
            height, half=self.height_half_px, steepness=self.height_steepness
        )
        return np.where(height >= max(self.min_box_height_px, 1.0e-9), probability, 0.0)

    def is_expected(self, evidence: Evidence) -> BoolArray:
        """Mask of rows that are detected with at least `plan_probability`, (n,)."""
        return self.probability(evidence) >= self.plan_probability

    def least_height_px(self, evidence: Evidence) -> FloatArray:
        """Height at which the probability reaches `plan_probability`, (n,)."""
        most = self._most(evidence)
        least = max(self.min_box_height_px, 1.0e-9)
        if self.plan_probability == 0.0:
            return np.zeros(len(evidence))
        with np.errstate(divide="ignore", invalid="ignore"):
            odds = np.where(
                most > self.plan_probability, most / self.plan_probability - 1.0, 0.0
            )
            height: FloatArray = self.height_half_px * odds ** (
                -1.0 / self.height_steepness
            )
        return np.maximum(height, least)

    def detect(self, evidence: Evidence, rng: np.random.Generator) -> Detections:
        """Draw which rows are detected, and the errors of their boxes.

        Rows with the same `draw_index` share their draw.
        """
        from scipy.special import ndtr

        draws, row_draw = np.unique(evidence.draw_index, return_inverse=True)
        chance = ndtr(self._noise(draws, rng))[row_draw]
        noise = rng.standard_normal((len(draws), 4))[row_draw]
        probability = self.probability(evidence)
        rows = np.flatnonzero(chance < probability)
        return Detections(
            row_index=rows,
            boxes_px=_correct_boxes(
                evidence.visible_px[rows], self.box_noise_share * noise[rows]
            ),
            confidence=probability[rows],
        )

    def fingerprint(self) -> tuple[object, ...]:
        """Values that `is_expected` depends on."""
        names = ("seen_share", "recall", "class_factor")
        curves = [getattr(self, name).tobytes() for name in names]
        figures = (*_POSITIVES, "cyclist_end_on", "plan_probability")
        numbers = [getattr(self, name) for name in figures]
        # Nothing is added without a table for LiDARs, so that cached tables stay valid.
        if self.lidar:
            return ("response", *curves, *numbers, self.lidar)
        return ("response", *curves, *numbers)

    def _noise(self, draws: IntArray, rng: np.random.Generator) -> FloatArray:
        """Standard normal numbers of frames in ascending order, (n,).

        Parameters
        ----------
        draws : (n,) int
            Distinct numbers of frames; consecutive ones are consecutive frames of a
            run.
        rng : Generator
            Of the numbers.
        """
        lasting = self.lasting
        if lasting is None:
            return linked_noise(draws, self.frame_correlation, rng)
        linked = linked_noise(
            draws, lasting.frame_correlation(self.frame_correlation), rng
        )
        run = np.cumsum(np.diff(draws, prepend=draws[:1]) != 1) - 1
        # Noise of one unit and one person, the same in all frames of a run.
        own = rng.standard_normal(len(draws))[run]
        own_part = np.sqrt(lasting.unit_person_share) * own
        return np.asarray(
            own_part + np.sqrt(lasting.frame_share) * linked + lasting.person[draws]
        )

    def _most(self, evidence: Evidence) -> FloatArray:
        """Probability of a correct detection of a box of any height, (n,).

        The product of recall and the factors of class, aspect and contrast.
        """
        seen = evidence.visible_share * evidence.inside_share
        return (
            np.interp(seen, self.seen_share, self.recall)
            * self.class_factor[evidence.vru_class]
            * self._aspect_factor(evidence.aspect_deg, evidence.vru_class)
            * self._contrast_factor(evidence.contrast)
        )

    def _aspect_factor(self, aspect_deg: FloatArray, vru_class: IntArray) -> FloatArray:
        """Factor for the side that is seen, (n,); 1 but for cyclists."""
        factor = np.ones(len(aspect_deg))
        is_cyclist = vru_class == VRU_CLASSES.index("cyclist")
        end_on = np.cos(np.radians(aspect_deg[is_cyclist])) ** 2
        factor[is_cyclist] = 1.0 - (1.0 - self.cyclist_end_on) * end_on
        return factor

    def _contrast_factor(self, contrast: FloatArray) -> FloatArray:
        """Factor for the contrast, (n,); 1 at full contrast."""
        half = self.contrast_half
        steepness = self.contrast_steepness
        full = _rising(np.ones(1), half=half, steepness=steepness)
        return _rising(contrast, half=half, steepness=steepness) / full


def _rising(values: FloatArray, *, half: float, steepness: float) -> FloatArray:
    """A curve that rises from 0 to 1 and is 0.5 at `half`."""
    powers = np.maximum(values, 0.0) ** steepness
    return np.asarray(powers / (powers + half**steepness))


def _correct_boxes(boxes_px: FloatArray, error: FloatArray) -> FloatArray:
    """Boxes whose sides are off by shares of their sizes, as far as correct.

    The probability is that of a correct detection: an error that would make the box
    miss the road user is halved until it does not.

    Parameters
    ----------
    boxes_px : (n, 4) float
        Boxes without error. [px]
    error : (n, 4) float
        Of each side, as a share of width or height.

    Returns
    -------
    boxes_px : (n, 4) float
        [px]
    """
    off = np.tile(boxes_px[:, 2:] - boxes_px[:, :2], 2) * error
    for _ in range(_HALVINGS):
        is_wrong = iou(boxes_px + off, boxes_px) <= load_min_iou()
        if not is_wrong.any():
            break
        off[is_wrong] *= 0.5
    return boxes_px + off


# ---------- tables
_FILE = "detectors.toml"
# Tables fitted to what a detector found: on rendered pictures, and on real recordings.
_TABLE_FILES = {
    "response": _FILE,
    "cnn-table": "vru.toml",
    "pole-2015": "pole-2015.toml",
    "car-2019": "car-2019.toml",
}


def load_response_file(path: Path) -> ResponseDetector:
    """Response table of a user's TOML file.

    Raises InputError if it cannot be read, or a figure is missing or out of range.
    """
    return _read_response(path, load_toml(path), name=path.name)


@cache
def load_lidar_table(name: str) -> LidarTable:
    """Built-in table of what LiDARs find."""
    document = load_data(__package__, f"{name}.toml")
    of_class = [document[document["stands_for"].get(one, one)] for one in VRU_CLASSES]
    return LidarTable(
        name=name,
        distance_m=tuple(tuple(one["distance_m"]) for one in of_class),
        recall=tuple(tuple(one["recall"]) for one in of_class),
        frame_correlation=tuple(one["frame_correlation"][0] for one in of_class),
        plan_probability=document["plan_probability"],
    )


def built_in_response() -> ResponseDetector:
    """Built-in table "response"."""
    return load_table("response")


@cache
def load_table(name: str) -> ResponseDetector:
    """Built-in response table of a name."""
    source = files(__package__) / "data" / _TABLE_FILES[name]
    return _read_response(source, load_toml(source), name=name)


def _read_response(
    source: Path | Traversable, document: Table, *, name: str
) -> ResponseDetector:
    """Response table of a document.

    Parameters
    ----------
    source : Path or Traversable
        The file, for messages.
    document : Table
        What it holds.
    name : str
        Of the detector.

    Raises
    ------
    InputError
        A figure is missing or out of range; the message names the file and the line.
    """
    table = document.get("response")
    if not isinstance(table, dict):
        refuse(str(source), "no table [response]", "a table [response]")
    try:
        shares = float_array(
            take_list(table, "seen_share", "response"), (-1,), "seen_share"
        )
        recall = float_array(take_list(table, "recall", "response"), (-1,), "recall")
        numbers: dict[str, Any] = {
            key: take_number(table, key, "response")
            for key in (*_POSITIVES, *_PROBABILITIES)
        }
        factors, assumed = _read_classes(table)
        for key, factor in factors.items():
            if not 0.0 <= factor <= 1.0:
                raise InputError(key, factor, "0 .. 1")
        return ResponseDetector(
            name=name,
            assumed=assumed,
            assumed_figures=_read_names(table, "assumed_figures", _FIGURES),
            false_tracks_per_hour=_read_alarms(document),
            seen_share=shares,
            recall=recall,
            class_factor=float_array(list(factors.values()), (-1,), "class_factor"),
            **numbers,
        )
    except InputError as error:
        key = error.where.removeprefix("response.")
        where = f"{source}:{_line(source, key)}: {key}"
        raise InputError(where, error.got, error.expected) from None


def _read_classes(table: Table) -> tuple[dict[str, float], tuple[str, ...]]:
    """Factor by class, and the classes of which nothing is measured.

    A file need not know the classes that the built-in table assumes: there it has
    the same factor.
    """
    given = detector_defaults()["response"]
    named = _read_names(table, "assumed", VRU_CLASSES) or ()
    missing = [name for name in given["assumed"] if name not in table]
    whole = {**{name: given[name] for name in missing}, **table}
    factors = {key: take_number(whole, key, "response") for key in VRU_CLASSES}
    return factors, tuple(name for name in VRU_CLASSES if name in (*named, *missing))


def _read_names(table: Table, key: str, known: Sequence[str]) -> tuple[str, ...] | None:
    """Names of a list, each one of `known`; None where there is no list."""
    names = take_list({key: [], **table}, key, "response")
    for name in names:
        check_one_of(key, name, known)
    if key in table:
        return tuple(names)
    return None


def _read_alarms(document: Table) -> Interval | None:
    """Rate of false tracks, from the table ``[false_tracks_per_hour]``.

    None if there is no such table.
    """
    where = "false_tracks_per_hour"
    if where not in document:
        return None
    rate = read_table(document[where], dict[str, float], where)
    interval = Interval(*(take_number(rate, key, where) for key in Interval.__slots__))
    if not 0.0 <= interval.low <= interval.value <= interval.high < np.inf:
        raise InputError(where, rate, "0 <= low <= value <= high")
    return interval


def _line(source: Path | Traversable, key: str) -> int:
    """Line of a key in the table ``[response]``.

    That of the table if the key is missing.
    """
    lines = source.read_text(encoding="utf-8").splitlines()
    is_header = [bool(re.match(r"\s*\[\s*response\s*\]", text)) for text in lines]
    header = 0
    if any(is_header):
        header = is_header.index(True)
    # The table ends at the next header.
    for index in range(header + 1, len(lines)):
        if re.match(r"\s*\[", lines[index]):
            break
        if re.match(rf"\s*{re.escape(key)}\s*=", lines[index]):
            return index + 1
    return header + 1
