"""Detectors by boxes alone and by probability, and any detector by its name or file."""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import as_file, files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, cast

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray, float_array, set_arrays
from geometry.errors import InputError, check_field, check_one_of, refuse
from geometry.image_boxes import box_height_px, iou
from geometry.tables import Table, read_table, take, take_list, take_number
from geometry.text_formats import load_data, load_toml

from .evidence import (
    VRU_CLASSES,
    Detections,
    Detector,
    Evidence,
    Interval,
    LidarTable,
    PlanningDetector,
    linked_noise,
    load_min_iou,
)


# ---------- by boxes alone
@dataclass(frozen=True, slots=True, kw_only=True)
class GeometricDetector:
    """Detects by boxes alone: the same evidence always gives the same answer."""

    # the box of the visible part must overlap that of the whole VRU (amodal) by more
    # than this
    min_iou: float
    min_box_height_px: float  # the visible box must be at least this high. [px]
    min_contrast: float = 0.0  # the VRU must stand out by at least this much
    name: str = "geometric"
    lidar: LidarTable | None = None

    needs_pictures = False

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
    def description(self) -> str:
        """When it detects."""
        return (
            "A road user counts as detected in a frame if the box around its visible"
            " part overlaps "
            f"the box around all of it by more than {self.min_iou:g} (intersection over"
            " union), is "
            f"at least {self.min_box_height_px:g} pixels high, and light and air leave"
            " it a "
            f"contrast of at least {100.0 * self.min_contrast:g} %."
            f"{self.lidar.description if self.lidar else ''}"
        )

    def is_expected(self, evidence: Evidence) -> BoolArray:
        """Rows that it detects, (n,)."""
        return (
            (iou(evidence.visible_px, evidence.amodal_px) > self.min_iou)
            & (box_height_px(evidence.visible_px) >= self.min_box_height_px)
            & (evidence.contrast >= self.min_contrast)
        )

    def least_height_px(self, evidence: Evidence) -> FloatArray:
        """The least height where the contrast is enough, infinite elsewhere, (n,)."""
        is_clear = np.broadcast_to(
            evidence.contrast >= self.min_contrast, len(evidence)
        )
        return np.where(is_clear, self.min_box_height_px, np.inf)

    def detect(self, evidence: Evidence, rng: np.random.Generator) -> Detections:
        """The visible boxes of what it detects; `rng` is not used."""
        rows = np.flatnonzero(self.is_expected(evidence))
        return Detections(
            row_index=rows,
            boxes_px=evidence.visible_px[rows],
            confidence=np.ones(len(rows)),
        )

    def fingerprint(self) -> tuple[object, ...]:
        """Everything that it depends on."""
        numbers = (self.min_iou, self.min_box_height_px, self.min_contrast)
        return ("geometric", *numbers, *([self.lidar] if self.lidar else []))


# ---------- by probability
_POSITIVES = (
    "height_half_px",
    "height_steepness",
    "min_box_height_px",
    "contrast_half",
    "contrast_steepness",
)
_HALVINGS = 10  # of errors of boxes
_PROBABILITIES = (
    "cyclist_end_on",
    "box_noise_share",
    "frame_correlation",
    "plan_probability",
)
_FIGURES = ("recall", *VRU_CLASSES, *_POSITIVES, *_PROBABILITIES[:-1])
"""What can be measured; from which probability on a plan counts on a frame is chosen."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LastingNoise:
    """What decides a frame, as far as it is the same in all frames of a run; all noise has 1."""

    person: (
        FloatArray  # (n,): noise of whoever is there, for all units, by `draw_index`
    )
    person_share: float  # variance of it
    unit_person_share: float  # variance of what one unit and one person have in common

    @property
    def frame_share(self) -> float:
        """Variance of what changes from frame to frame, 0 .. 1."""
        return 1.0 - self.person_share - self.unit_person_share

    def frame_correlation(self, correlation: float) -> float:
        """Correlation of what changes that leaves all noise with one of consecutive frames.

        0 where what lasts alone makes them more alike than that.
        """
        lasting = self.person_share + self.unit_person_share
        if lasting < 1.0:
            return max(0.0, correlation - lasting) / (1.0 - lasting)
        return 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ResponseDetector:
    """Detects with a probability; each frame is drawn at random."""

    name: str  # "response", or the file that it comes from
    # seen_share, recall: (n,): share of the VRU that is seen, ascending from 0 to 1,
    # and the probability of a correct detection there; linear between
    seen_share: FloatArray
    recall: FloatArray
    # height_half_px, height_steepness: factor 1 / (1 + (half / height)^steepness) of
    # the visible box. [px]
    height_half_px: float
    height_steepness: float
    min_box_height_px: float  # smaller boxes are never detected. [px]
    class_factor: FloatArray  # (n_classes,): in the order of ``VRU_CLASSES``
    cyclist_end_on: (
        float  # factor of a cyclist seen from straight behind or ahead; 1 from the side
    )
    # contrast_half, contrast_steepness: factor 1 / (1 + (half / contrast)^steepness),
    # relative to that at full contrast
    contrast_half: float
    contrast_steepness: float
    box_noise_share: (
        float  # standard deviation of each side, as share of the box's width or height
    )
    frame_correlation: float  # between the random draws of consecutive frames
    plan_probability: float  # a plan counts on a detection from this probability on
    assumed: tuple[str, ...] = ()  # classes of which nothing is measured
    # further figures that are assumed, by their keys; None: the file does not say
    assumed_figures: tuple[str, ...] | None = None
    # Tracks of nothing that a unit confirms in an hour, with the 95 % interval; None:
    # unknown.
    false_tracks_per_hour: Interval | None = None
    lasting: LastingNoise | None = (
        None  # in a sampled world; None: all noise is that of frames
    )
    lidar: LidarTable | None = None

    needs_pictures = False

    @property
    def description(self) -> str:
        """When it detects."""
        return (
            "Whether a road user is detected in a frame is drawn by the response model "
            f"{self.name}: the probability depends on its height in pixels, the share"
            " that is "
            "seen, its class, the side that it shows and its contrast in light and"
            " weather. The "
            "detection table counts on frames with a probability of at least "
            f"{self.plan_probability:g}.{self.assumed_words()}{self.alarm_words}"
            f"{self.lidar.description if self.lidar else ''}"
        )

    def assumed_words(self, classes: Collection[str] = VRU_CLASSES) -> str:
        """That nothing is measured of some of `classes`; empty where something is of all."""
        names = [name for name in self.assumed if name in classes]
        if not names:
            return ""
        factors = dict(zip(VRU_CLASSES, self.class_factor.tolist(), strict=True))
        words = " and ".join(f"{name} (factor {factors[name]:g})" for name in names)
        return f" Nothing is measured of {words}: how well they are found is assumed."

    @property
    def figures_words(self) -> str:
        """How many of its figures are measured, and which are assumed."""
        if self.assumed_figures is None:
            return f"{self.name} does not say which of its figures are measured."
        names = [
            one for one in _FIGURES if one in (*self.assumed, *self.assumed_figures)
        ]
        n_measured = len(_FIGURES) - len(names)
        if names:
            listed = f"; assumed: {', '.join(names)}"
        else:
            listed = ""
        return (
            f"Of the {len(_FIGURES)} figures of {self.name} {n_measured} are"
            f" measured{listed}."
        )

    @property
    def alarm_words(self) -> str:
        """How often something is confirmed where nothing is; empty where that is unknown."""
        rate = self.false_tracks_per_hour
        if rate is None:
            return ""
        return (
            f" As measured on its pictures, a unit confirms {rate.value:.3g} tracks of"
            f" nothing per hour (95 %: {rate.low:.3g} to {rate.high:.3g}), each of"
            " which may brake a car that it seems to cross the path of; they are no"
            " part of the verdicts."
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

    def probability(self, evidence: Evidence) -> FloatArray:
        """Probability of a correct detection, (n,); 0 where nothing is seen."""
        height = box_height_px(evidence.visible_px)
        probability = self._most(evidence) * _rising(
            height, half=self.height_half_px, steepness=self.height_steepness
        )
        return np.where(height >= max(self.min_box_height_px, 1.0e-9), probability, 0.0)

    def is_expected(self, evidence: Evidence) -> BoolArray:
        """Rows that are detected with at least `plan_probability`, (n,)."""
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
        """Draw which rows are detected, and the errors of their boxes."""
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
        """Everything that `is_expected` depends on."""
        return (
            "response",
            *(
                getattr(self, name).tobytes()
                for name in ("seen_share", "recall", "class_factor")
            ),
            *(
                getattr(self, name)
                for name in (*_POSITIVES, "cyclist_end_on", "plan_probability")
            ),
            *([self.lidar] if self.lidar else []),
        )

    def _noise(self, draws: IntArray, rng: np.random.Generator) -> FloatArray:
        """Standard normal numbers of frames in ascending order, (n,)."""
        lasting = self.lasting
        if lasting is None:
            return linked_noise(draws, self.frame_correlation, rng)
        linked = linked_noise(
            draws, lasting.frame_correlation(self.frame_correlation), rng
        )
        run = np.cumsum(np.diff(draws, prepend=draws[:1]) != 1) - 1
        own = rng.standard_normal(len(draws))[run]  # of the unit and the person, by run
        own_part = np.sqrt(lasting.unit_person_share) * own
        return np.asarray(
            own_part + np.sqrt(lasting.frame_share) * linked + lasting.person[draws]
        )

    def _most(self, evidence: Evidence) -> FloatArray:
        """Probability of a correct detection of a box of any height, (n,)."""
        seen = evidence.visible_share * evidence.inside_share
        return (
            np.interp(seen, self.seen_share, self.recall)
            * self.class_factor[evidence.vru_class]
            * self._aspect_factor(evidence.aspect_deg, evidence.vru_class)
            * self._contrast_factor(evidence.contrast)
        )

    def _aspect_factor(self, aspect_deg: FloatArray, vru_class: IntArray) -> FloatArray:
        factor = np.ones(len(aspect_deg))
        is_cyclist = vru_class == VRU_CLASSES.index("cyclist")
        end_on = np.cos(np.radians(aspect_deg[is_cyclist])) ** 2
        factor[is_cyclist] = 1.0 - (1.0 - self.cyclist_end_on) * end_on
        return factor

    def _contrast_factor(self, contrast: FloatArray) -> FloatArray:
        half = self.contrast_half
        steepness = self.contrast_steepness
        full = _rising(np.ones(1), half=half, steepness=steepness)
        return _rising(contrast, half=half, steepness=steepness) / full


def _rising(values: FloatArray, *, half: float, steepness: float) -> FloatArray:
    """A curve that rises from 0 to 1 and is 0.5 at `half`."""
    powers = np.maximum(values, 0.0) ** steepness
    return np.asarray(powers / (powers + half**steepness))


def _correct_boxes(boxes_px: FloatArray, error: FloatArray) -> FloatArray:
    """Boxes (n, 4) whose sides are off by shares (n, 4) of their sizes, as far as they are correct.

    The probability is that of a correct detection: an error that would make the box
    miss the road user is halved until it does not.
    """
    off = np.tile(boxes_px[:, 2:] - boxes_px[:, :2], 2) * error
    for _ in range(_HALVINGS):
        is_wrong = iou(boxes_px + off, boxes_px) <= load_min_iou()
        if not is_wrong.any():
            break
        off[is_wrong] *= 0.5
    return boxes_px + off


# ---------- by name or file
DETECTOR_NAMES = ("geometric", "response", "pole-2015", "car-2019", "cnn-table", "cnn")
"""Of cameras; ``LIDAR_NAMES`` may follow any of them, or a file, behind a plus sign."""
LIDAR_NAMES = ("pointrcnn-2019",)
_FILE = "detectors.toml"
_NETWORK_FILE = "vru.onnx"
# Tables fitted to what a detector found: on rendered pictures, and on real recordings.
_TABLE_FILES = {
    "response": _FILE,
    "cnn-table": "vru.toml",
    "pole-2015": "pole-2015.toml",
    "car-2019": "car-2019.toml",
}


def load_detector(name: str = "geometric", *, where: str = "detector") -> Detector:
    """Detector by name or file; `where` names it in messages.

    Names are those of ``DETECTOR_NAMES``; files are ``.toml`` with a table
    ``[response]`` as in ``data/detectors.toml``, or ``.onnx``. One of ``LIDAR_NAMES``
    behind a plus sign says what LiDARs find; alone, cameras go by the first of
    ``DETECTOR_NAMES``. Raises InputError if the name is unknown or the file cannot be
    used, MissingExtraError for "cnn" or an ONNX file without onnxruntime.
    """
    cameras, _, lidars = name.rpartition("+")
    if lidars in LIDAR_NAMES:
        found = load_detector(cameras or DETECTOR_NAMES[0], where=where)
        named = cast(Any, found)  # all of them are dataclasses
        both: Detector = replace(
            named, name=f"{found.name}+{lidars}", lidar=_load_lidar_table(lidars)
        )
        return both
    if name == "cnn":
        return _load_shipped_network()
    if name in DETECTOR_NAMES:
        return load_planning_detector(name)
    path = Path(name)
    if path.suffix == ".toml":
        return _read_response(path, load_toml(path), name=path.name)
    if path.suffix == ".onnx":
        return _load_network(path.name, path, "onnx")
    known = ", ".join((*DETECTOR_NAMES, *LIDAR_NAMES))
    raise InputError(
        where, name, f"{known}, a .toml file with a response table, or an .onnx file"
    )


def is_drawn(name: str) -> bool:
    """True if a detector of this name finds people with a probability, not by a rule.

    >>> is_drawn("response"), is_drawn("geometric+pointrcnn-2019"), is_drawn("cnn")
    (True, True, False)
    """
    last = name.rpartition("+")[2]
    return last in LIDAR_NAMES or last in _TABLE_FILES or last.endswith(".toml")


@cache
def _load_lidar_table(name: str) -> LidarTable:
    """A built-in table of what LiDARs find."""
    document = load_data(__package__, f"{name}.toml")
    of_class = [document[document["stands_for"].get(one, one)] for one in VRU_CLASSES]
    return LidarTable(
        name=name,
        distance_m=tuple(tuple(one["distance_m"]) for one in of_class),
        recall=tuple(tuple(one["recall"]) for one in of_class),
        frame_correlation=tuple(one["frame_correlation"][0] for one in of_class),
        plan_probability=document["plan_probability"],
    )


@cache
def _load_shipped_network() -> Detector:
    """The network that is shipped."""
    words = _load_table("cnn-table").alarm_words
    how = {"looks_at_crops": True, "plans_with": "cnn-table", "alarm_words": words}
    with as_file(files(__package__) / "data" / _NETWORK_FILE) as path:
        return _load_network("cnn", path, "cnn", **how)


def _load_network(name: str, path: Path, section: str, **how: Any) -> Detector:
    """A network from a file, with the limits of a section of ``data/detectors.toml``."""
    from .network import NetworkDetector, load_onnx_model

    return NetworkDetector(
        name=name, model=load_onnx_model(path), **_limits(section), **how
    )


def built_in_response() -> ResponseDetector:
    """The built-in table "response"."""
    return _load_table("response")


@cache
def _load_table(name: str) -> ResponseDetector:
    """A built-in response table."""
    source = files(__package__) / "data" / _TABLE_FILES[name]
    return _read_response(source, load_toml(source), name=name)


@cache
def load_planning_detector(name: str = "geometric") -> PlanningDetector:
    """One of the built-in detectors but "cnn"."""
    if name in _TABLE_FILES:
        return _load_table(name)
    return GeometricDetector(min_iou=load_min_iou(), **_limits(name))


@cache
def _defaults() -> dict[str, Any]:
    return load_data(__package__, _FILE)


def _limits(section: str) -> dict[str, Any]:
    """Numbers of a section, by the detector's fields."""
    return read_table(
        take(_defaults(), section, _FILE), dict[str, float], f"{_FILE}: {section}"
    )


def _read_response(
    source: Path | Traversable, document: Table, *, name: str
) -> ResponseDetector:
    """Response table of a document; errors name the file and the line."""
    table = document.get("response")
    if not isinstance(table, dict):
        refuse(str(source), "no table [response]", "a table [response]")
    try:
        shares, recall = (
            float_array(take_list(table, key, "response"), (-1,), key)
            for key in ("seen_share", "recall")
        )
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

    A file need not know the classes that the built-in table assumes: there it has the
    same factor.
    """
    given = _defaults()["response"]
    named = _read_names(table, "assumed", VRU_CLASSES) or ()
    missing = [name for name in given["assumed"] if name not in table]
    whole = {**{name: given[name] for name in missing}, **table}
    factors = {key: take_number(whole, key, "response") for key in VRU_CLASSES}
    return factors, tuple(name for name in VRU_CLASSES if name in (*named, *missing))


def _read_names(table: Table, key: str, known: Sequence[str]) -> tuple[str, ...] | None:
    """Names of a list; None where there is none."""
    names = take_list({key: [], **table}, key, "response")
    for name in names:
        check_one_of(key, name, known)
    if key in table:
        return tuple(names)
    return None


def _read_alarms(document: Table) -> Interval | None:
    """Rate of false tracks, of the table ``[false_tracks_per_hour]``, if there is one."""
    where = "false_tracks_per_hour"
    if where not in document:
        return None
    rate = read_table(document[where], dict[str, float], where)
    interval = Interval(*(take_number(rate, key, where) for key in Interval.__slots__))
    if not 0.0 <= interval.low <= interval.value <= interval.high < np.inf:
        raise InputError(where, rate, "0 <= low <= value <= high")
    return interval


def _line(source: Path | Traversable, key: str) -> int:
    """Line of a key in the table ``[response]``; that of the table if the key is missing."""
    lines = source.read_text(encoding="utf-8").splitlines()
    header = next(
        (
            index
            for index, text in enumerate(lines)
            if re.match(r"\s*\[\s*response\s*\]", text)
        ),
        0,
    )
    for index in range(header + 1, len(lines)):
        if re.match(r"\s*\[", lines[index]):
            break
        if re.match(rf"\s*{re.escape(key)}\s*=", lines[index]):
            return index + 1
    return header + 1
