"""The setting in which layouts are placed and judged.

It has scene, runs, braking rule, detectors and radio.
"""

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, cast

from geometry.actors import pick_actor
from geometry.arrays import BoolArray
from geometry.errors import InputError, refuse
from geometry.frames import to_geographic
from geometry.junction import ARM_NAMES, build_junction
from geometry.phrases import Phrase
from geometry.registry import load_entry
from geometry.scene import Scene
from geometry.scene_sources import load_scene
from geometry.sensors import CameraModel
from scenarios.aeb import AebRule, load_aeb_rule, load_track_memory_s
from scenarios.cases import Case, Selection, select_cases
from scenarios.paths import CoursePath, StraightPath, TowedPath, TurnPath
from scenarios.positions import (
    AT_ZERO,
    Position,
    is_bound,
    is_study_set,
    pick_positions,
    read_position,
)
from scenarios.runs import (
    WEATHERS,
    FrameAxis,
    LeftOut,
    Refusal,
    Run,
    build_frame_axis,
    build_runs,
    left_out_case,
)
from scenarios.weights import (
    check_weights,
    default_weights,
    needs_place,
    weigh,
    weight_by_function,
)

from .cache import cached_value
from .compute import DEFAULT_COMPUTE, Compute
from .detectors import (
    Detector,
    PlanningDetector,
    load_detector,
    load_planning_detector,
    vru_class,
)
from .latency import load_latency_budget
from .question import Question, map_options, read_cars, read_point, split_names


# ---------- radio
@dataclass(frozen=True, slots=True, kw_only=True)
class Radio:
    """Radio between RSUs, VRUs and the VUT.

    Attributes
    ----------
    packet_loss : float
        Probability that a message is lost: an RSU's collective perception
        message (CPM) of one frame, or a VRU's awareness message (VAM). 0 .. 1.
    vam_rate : float
        Share of the runs whose VRU carries a device that sends VAMs. 0 .. 1.
    """

    packet_loss: float = 0.0
    vam_rate: float = 0.0

    def __post_init__(self) -> None:
        for name in ("packet_loss", "vam_rate"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(name, getattr(self, name), "0 .. 1")


# ---------- the setting
VUT_SENSORS = ("camera", "lidar")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setting:
    """The question, but for the layout.

    Attributes
    ----------
    scene : Scene
        What stands still, and the mount sites.
    runs : tuple of Run
        What happens there.
    axis : FrameAxis
        Frames and weights of `runs`.
    rule : AebRule
        From detected frames to braking.
    detector : Detector
        Of cameras, in the evaluator.
    table_detector : PlanningDetector
        Of cameras, in the detection table.
    refusals : tuple of Refusal
        What was asked for, but cannot be driven.
    radio : Radio
        From detections to the VUT.
    vut_sensors : tuple of str
        What the VUT itself looks with.
    vut_camera : CameraModel, optional
        In place of the study's.
    cars : float
        Share of the VUTs whose own sensors are one more unit in every run. 0 ..
        1.
    seen_by_vut : (n_frames,) bool, optional
        In which the VUT's own sensors detect, where that is known already; see
        :func:`placement.evaluator.with_sight`.
    """

    scene: Scene
    runs: tuple[Run, ...]
    axis: FrameAxis
    rule: AebRule
    detector: Detector
    table_detector: PlanningDetector
    refusals: tuple[Refusal, ...] = ()
    radio: Radio = field(default_factory=Radio)
    vut_sensors: tuple[str, ...] = VUT_SENSORS[:1]
    vut_camera: CameraModel | None = None
    cars: float = 0.0
    seen_by_vut: BoolArray | None = None

    def __post_init__(self) -> None:
        for name in self.vut_sensors or ("none",):
            if name not in VUT_SENSORS:
                raise InputError(
                    "vut_sensors", name, "one or more of " + ", ".join(VUT_SENSORS)
                )
        if not 0.0 <= self.cars <= 1.0:
            raise InputError("cars", self.cars, "0 .. 1")
        seen = self.seen_by_vut
        if seen is not None and seen.shape != (self.axis.n_frames,):
            refuse("seen_by_vut", "frames of other runs", "those of the axis")

    def __repr__(self) -> str:
        return f"Setting({self.scene.name!r}, {len(self.runs)} runs)"


# ---------- from a question to runs and setting
_log = logging.getLogger(__name__)


def build_rule(question: Question) -> AebRule:
    """The study's braking rule, with what the question changes.

    Raises InputError if the latency budget is unknown or a latency is given as well, or
    tracks live for less than a frame.
    """
    # Fields of the rule that the question gives.
    changes = {
        name: getattr(question, name)
        for name in (
            one.name for one in fields(AebRule) if one.name in Question.__slots__
        )
        if getattr(question, name) is not None
    }
    # By default tracks live for ever in the study's cases, as the study reads it.
    memory_s = math.inf
    if not is_study_set(question.cases):
        memory_s = load_track_memory_s()
    changes.setdefault("track_memory_s", memory_s)
    if question.latency_budget:
        if question.latency_s is not None:
            refuse("latency_s", "it beside `latency_budget`", "one of them")
        budget = load_latency_budget(question.latency_budget, where="latency_budget")
        changes["latency_s"] = budget.mean_s
    try:
        return replace(load_aeb_rule(), **changes)
    except InputError as error:
        raise InputError(
            error.where.removeprefix("aeb."), error.got, error.expected
        ) from None


def check_question(question: Question) -> None:
    """Check what can be checked of a question without a scene.

    Raises InputError: a word is unknown, or a file cannot be used. MissingExtraError:
    what it needs is not installed.
    """
    _select(question)
    pick_positions(question.along_arms, question.cases)
    _words(question.approaches, "approaches", ARM_NAMES)
    _words(question.weather, "weather", WEATHERS, at_least=1)
    build_rule(question)
    read_cars(question.cars)
    if question.decision:
        load_entry("scenarios.decision:load_decision_rule")(question.decision)
    if question.weights:
        check_weights(question.weights)
    if question.near:
        _read_place_deg(question.near)
    load_detector(question.detector, where="detector")


def _select(question: Question) -> Selection:
    """Cases that a question selects."""
    return select_cases(
        question.cases,
        speeds=question.speeds or None,
        case_range=question.case_range,
        protect=question.protect,
    )


class Drives(NamedTuple):
    """The runs that a question lays on a scene.

    Attributes
    ----------
    runs : tuple of Run
        What is driven.
    refused : tuple of Refusal
        What the junction does not carry.
    left_out : tuple of Refusal
        Cases none of whose speeds were asked for, or that meet somebody who is
        not to be protected.
    """

    runs: tuple[Run, ...]
    refused: tuple[Refusal, ...]
    left_out: tuple[Refusal, ...]


def drive(
    question: Question,
    scene: Scene,
    *,
    position: Position | None = None,
    known: Sequence[Run] = (),
    cache_folder: Path | None = None,
) -> Drives:
    """Lay the cases of a question on a scene's junction; there may be no runs.

    Without a word on speeds none is driven above the speed limits of the scene's lanes.
    With a `position`, every speed is driven at this one alone. `known` runs are not
    laid again, see :func:`scenarios.runs.build_runs`. In a `cache_folder` the runs are
    cached. Raises InputError where a word is unknown, or the protocol does not
    drive a speed.
    """
    selection = _select(question)
    positions = (
        (position,) if position else pick_positions(question.along_arms, question.cases)
    )
    arms = tuple(build_junction(scene).arms)
    approaches = _words(question.approaches, "approaches", arms) or arms
    weathers = _words(question.weather, "weather", WEATHERS, at_least=1)
    # Everything that the runs depend on; it is part of the cache's key.
    laid: dict[str, Any] = {
        "vut": pick_actor("vut", "vut"),
        "rule": build_rule(question),
        "approaches": approaches,
        "weathers": weathers,
        "positions": positions,
        "is_spread": position is None,
        "keeps_limits": not question.speeds.strip(),
    }
    runs, refused = cached_value(
        cache_folder,
        "runs",
        partial(build_runs, scene, selection.cases, **laid, known=known),
        kind=tuple[tuple[Run, ...], tuple[Refusal, ...]],
        classes=(StraightPath, TurnPath, CoursePath, TowedPath),
        made_from=(scene, selection.cases, laid),
        packages=("geometry", "scenarios"),
    )
    no_speed = Phrase(
        "this case has none of the requested speeds ({speeds})",
        speeds=question.speeds,
    )
    reasons: list[tuple[Case, Phrase, LeftOut]] = [
        *((case, no_speed, "speeds") for case in selection.left_out),
        *((case, _unprotected(case), "unprotected") for case in selection.unprotected),
    ]
    left_out = tuple(
        left_out_case(case, approach, reason, left_out)
        for case, reason, left_out in reasons
        for approach in approaches
    )
    return Drives(runs=runs, refused=refused, left_out=left_out)


def _unprotected(case: Case) -> Phrase:
    return Phrase(
        "the target is a {user}, and only vulnerable road users are protected",
        user=Phrase(case.road_user),
    )


def drive_one(question: Question, scene: Scene, *, position: str = "0") -> Run:
    """The only run of a question at a position.

    Raises InputError if there are none, or several.
    """
    where = "position"
    place = read_position(position, where)
    # Cases that are bound to the junction are driven at 0 only.
    for case in select_cases(question.cases).cases:
        if is_bound(case) and place != AT_ZERO:
            raise InputError(
                where, position, f"0: {case.name} is bound to the junction"
            )
    drives = drive(replace(question, protect="all"), scene, position=place)
    if not drives.runs and (*drives.refused, *drives.left_out):
        refusal = (*drives.refused, *drives.left_out)[0]
        expected = "a case that this approach carries"
        refuse(
            f"{refusal.case.name} from the {refusal.approach}", refusal.reason, expected
        )
    if len(drives.runs) != 1:
        ids = ", ".join(run.id for run in drives.runs)
        refuse(question.cases, f"{len(drives.runs)} runs ({ids})", "one run")
    return drives.runs[0]


def build_setting(
    question: Question | None = None,
    scene: Scene | None = None,
    *,
    weights: Callable[[Run], float] | None = None,
    known: Setting | None = None,
    compute: Compute = DEFAULT_COMPUTE,
) -> Setting:
    """All that a layout is placed in and judged by.

    `question` says what is driven and how much it counts, by default the study's cases
    along the arms; `scene` is in place of the junction that it names, `weights` in
    place of its word on weights: only proportions matter. Runs of a `known` setting on
    the same scene are not laid again. `compute` has the cache of the runs, of which
    there is one at least. Raises InputError: as :func:`drive`; no
    approach carries any of the cases; the weights do not fit the runs.
    """
    question = question or Question()
    scene = scene or load_scene(question.scene, **map_options(question))
    # Names first: what is misspelt is refused before anything is driven.
    vut_sensors = _words(question.vut_sensors, "vut_sensors", VUT_SENSORS) or ("",)
    rule = build_rule(question)
    detector = load_detector(question.detector, where="detector")
    cars = read_cars(question.cars)
    if question.decision:
        load_entry("scenarios.decision:load_decision_rule")(question.decision)
        if 0.0 < cars < 1.0:
            raise InputError("cars", cars, "blind or see beside `decision`")
    known_runs: tuple[Run, ...] = ()
    if known is not None and _drives_alike(known, scene, rule):
        known_runs = known.runs
    drives = drive(question, scene, known=known_runs, cache_folder=compute.cache_folder)
    runs = drives.runs
    if not runs:
        _check_every_case(drives, scene)
    # The detector has to know the classes of road users.
    classes = {vru_class(run.encounter.vru) for run in runs}
    detector.check_classes(sorted(classes))
    words = detector.assumed_words(classes)
    if words:
        _log.warning("detector %s: %s", detector.name, words.removesuffix("."))
    if weights is not None:
        weight = weight_by_function(runs, weights)
    else:
        weight = weigh(
            runs,
            question.weights or default_weights(question.cases),
            refused=drives.refused,
            near=_place_deg(question, scene),
            within_m=question.accidents_within_m,
        )
    return Setting(
        scene=scene,
        runs=runs,
        axis=build_frame_axis(runs, weight),
        rule=rule,
        detector=detector,
        table_detector=_table_detector(detector),
        refusals=(*drives.refused, *drives.left_out),
        radio=Radio(packet_loss=question.packet_loss, vam_rate=question.vam_rate),
        vut_sensors=vut_sensors,
        cars=cars,
    )


def _drives_alike(known: Setting, scene: Scene, rule: AebRule) -> bool:
    """True if runs of a setting may stand in another one on a scene.

    A track's life changes no run.
    """
    same = replace(rule, track_memory_s=known.rule.track_memory_s)
    return known.scene is scene and same == known.rule


def _place_deg(question: Question, scene: Scene) -> tuple[float, float] | None:
    """Latitude and longitude around which accidents count.

    None where they are not known.
    """
    if question.near:
        return _read_place_deg(question.near)
    if not scene.crs or not needs_place(question.weights):
        return None
    middle = scene.outline_m.mean(axis=0, keepdims=True)
    longitude, latitude = to_geographic(middle, scene.crs)[0].tolist()
    return latitude, longitude


def _read_place_deg(text: str) -> tuple[float, float]:
    """Latitude and longitude in a text, in degrees; else an InputError."""
    try:
        latitude, longitude = read_point(text, "near")
    except InputError:
        latitude = longitude = math.nan
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
        raise InputError(
            "near", text, "latitude,longitude in degrees, such as 52.52,13.40"
        )
    return latitude, longitude


def _check_every_case(drives: Drives, scene: Scene) -> None:
    """Raise InputError for the first case that no approach carries.

    The message has all its reasons.
    """
    driven = {run.case.name for run in drives.runs}
    reasons: dict[str, dict[str, list[str]]] = {}
    # Approaches by case and reason.
    for refusal in drives.refused:
        if refusal.case.name not in driven:
            by_reason = reasons.setdefault(refusal.case.name, {})
            by_reason.setdefault(refusal.reason, []).append(refusal.approach)
    for case, by_reason in reasons.items():
        why = "; ".join(
            f"from the {', '.join(dict.fromkeys(arms))}: {reason}"
            for reason, arms in by_reason.items()
        )
        expected = f"a case that can be driven at {scene.name} ({why})"
        refuse("cases", f"{case}, which no approach carries", expected)


def _table_detector(detector: Detector) -> PlanningDetector:
    """The detector of the detection table: another one stands in for a network."""
    if not detector.plans_with:
        return cast(PlanningDetector, detector)
    _log.warning(
        "detector %s: judged on rendered pictures; poses are chosen by the %s detector",
        detector.name,
        detector.plans_with,
    )
    planner = load_planning_detector(detector.plans_with)
    if detector.lidar is None:
        return planner
    return replace(planner, lidar=detector.lidar)  # type: ignore[type-var]


def _words(
    text: str, where: str, known: tuple[str, ...], *, at_least: int = 0
) -> tuple[str, ...]:
    """Known words with commas between; none of an empty text."""
    words = split_names(text, where)
    checked: Sequence[str] = words
    if len(words) < at_least:
        checked = [text]
    for word in checked:
        if word not in known:
            raise InputError(where, word, "one or more of " + ", ".join(known))
    return words
