"""The question: what a user asks, as typed values; read from and written to TOML.

Imports nothing heavy.
"""

import math
import re
import textwrap
from dataclasses import dataclass, fields
from functools import cache
from inspect import Parameter, Signature
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from msgspec import Meta

from geometry.errors import InputError
from geometry.files import float_of, load_toml, read_table, reading, write_atomically

DEFAULT_CASES = "default"
BLIND, SEE = "blind", "see"
AUTO = "auto"
BASELINE_NAME = "carlancap-12"
"""Name of the study's own layout."""


def _share(of: str) -> Meta:
    return Meta(ge=0.0, le=1.0, description=f"{of}, 0 to 1")


def _at_least(least: float, of: str, most: float | None = None) -> Meta:
    limits = f"at least {least}" if most is None else f"{least} to {most:,}"
    return Meta(ge=least, le=most, description=f"{of}, {limits}")


def _positive(of: str, most: float | None = None) -> Meta:
    limits = "more than 0" if most is None else f"more than 0, at most {most:,}"
    return Meta(gt=0.0, le=most, description=f"{of}, {limits}")


# Beyond these a number is a slip, and arithmetic or memory would not bear it (assumptions).
_MOST_EUR = 1_000_000_000_000
_MOST_EUR_PER_SITE = 1_000_000_000
_MOST_PER_SITE = 1_000
_MOST_SAMPLES = 100_000
_MOST_LISTED = 10_000
_MOST_S = 10_000_000  # four months

# Of a certificate over sampled worlds: blocks, worlds in each, and worlds to judge layouts in.
N_BLOCKS = 5
N_SAMPLES = 8
N_JUDGED = 60


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """A user's question: what is driven and how it brakes, what may be mounted, how hard to look.

    Lists are one text with commas between; an empty text means that nothing is given. Raises
    InputError where a value is of another kind, or out of its range.

    Attributes
    ----------
    budget : int, optional
        Most units to mount.
    budget_cost : float, optional
        Most money to spend on units and sites.
    target : str
        APR to be reached with the fewest units: 0.99, or max for all that can be reached.
    least : {"units", "cost"}
        What `target` is reached with the least of.
    min_case_apr : float
        APR that must be reached in every case.
    survive : str
        Reach `target` and `min_case_apr` even when any N units fail, or any pole with all its
        units: site, or '2 sites'. Without these, look for the highest APR that is left then.
    give_up : float, optional
        APR that may be given up so that more is left when a unit fails; 0: none; default: 0.01
        where the best layout of so many units, or for so much money, is sought as planned.
    keep : str
        A layout that is mounted and paid already: units are added to it.
    within : str
        Choose among the units of this layout alone: carlancap-12, or a file.
    force_site : str
        Sites that must carry units.
    forbid_site : str
        Sites that must not carry any.
    site_capacity : int, optional
        Units that each site can carry; default: the scene's.
    site_cost_eur : float, optional
        Of each site that is used, once; default: the scene's.
    separation_m : float
        Least distance between two units on the ground; one per site then.
    sensors : str
        Models to choose from, with commas between: carla-ncap-rgb,carla-ncap-lidar, or your own:
        FILE.toml, FILE.toml:NAME; default: the study's camera.
    heights : str
        Heights that are tried at every site: 4,5.5,7; default: 5,6.5,8.
    yaw_step_deg : float, optional
        From one yaw that is tried to the next; default: 15.
    pitches : str
        Pitches that are tried, positive up: -30,-15; default: -15,-30,-45.
    no_look : str
        Areas that no camera may have in its picture; of a layout that is given, the share of them
        in each picture is reported. Polygons in GeoJSON, GeoPackage or Shapefile.
    no_look_share : float, optional
        Share of such an area that may be in the picture all the same; default: none.
    solver : {"auto", "exact", "relax", "greedy"}
        greedy: search only; relax: bounds of relaxations; exact: models and enumeration to the end;
        auto: what the size allows.
    time_limit_s : float
        For the optimiser; when it is up, the best layout found and its gap are given.
    gap : float
        Relative gap at which an objective counts as settled.
    refine : bool
        Look between the poses of the grid, too: turn, tilt, raise and zoom the units found; up to a
        minute more.
    samples : int or {"auto"}
        Choose, or compare, in so many worlds with mounting errors, traffic, misses and lost
        messages drawn at random; each needs a detection table of its own. auto: as many as make the
        layout better.
    uncertainty : str
        What is drawn for `samples`: a name, or a .toml file.
    traffic : str
        Vehicles that drive by in the worlds of `samples`: sumo, or a .toml file of demand for it.
    risk : str
        With `samples`: mean, worst, or the share of the worst worlds whose mean APR counts.
    scene : str
        Folder or .zip of `place-rsus scene import`, or a map (.osm, .osm.pbf, .xodr); default: the
        study's junction.
    junction : str
        Of a map: streets ("A St / B Ave"), id, or "latitude,longitude"; default: the one with the
        most arms. `place-rsus scene show MAP` lists them.
    at : str
        Of a map: a point near the junction, in the file's own coordinates: longitude,latitude or
        metres.
    sites : str
        Of a map, where sensors may be mounted: map (its poles), kerb:15 (every 15 m along the
        kerbs), a CSV or GeoJSON file; default: map, and where it has none kerb:15.
    driving_side : {"map", "left", "right"}
        Of a map, on which traffic keeps; map: as it says or shows.
    cases : str
        A set - default (the study's cases, along the arms), study (those at the junction alone),
        protocol-4.5.1, protocol-2026, junction (cars and motorcyclists that cross), all - or names
        with commas between; CPNA stands for CPNA-25 and CPNA-75 - or FILE.toml of your own cases.
        `place-rsus scenarios list` shows them.
    case_range : {"standard", "extended"}
        extended: also the impact points and speeds that Euro NCAP's extended range adds.
    protect : {"vru", "all"}
        Whose runs count. vru: people on foot, cyclists and motorcyclists; all: people in other cars
        as well.
    along_arms : str
        Where along the arms cases are laid that are not bound to the junction: so far before and
        behind it; 0: at the junction alone; default: 0,15,30,45, and 0 for `cases` study. Away from
        0 each drives a third of the speeds, in turn.
    speeds : str
        VUT speeds: 30,50; 20-40 (the case's own speeds in that range); 30x50 (the VUT's, and that
        of the car or motorcycle it meets); or all; default: all up to the speed limits of the map.
    approaches : str
        From where the VUT comes: north,east; default: every arm of the junction.
    weather : str
        day,night,rain,fog: each run is driven in each.
    force : bool
        Drive speeds that the protocol does not.
    strict : bool
        A case that no approach carries is an error; else it is reported and left out.
    weights : str
        run: every run counts the same; case: every case, and within it every approach, then every
        position, then every run; fhwa-crash-types: by how often cars hit people so;
        euroncap-rating-2026: by its points; unfallatlas:FILE or stats19:FILE: by the accidents
        around the junction, as Germany and Great Britain publish them; or a CSV file with case,
        approach, weight, and if wanted position and weather; default: case, and run for `cases`
        study.
    near : str
        Of `weights` unfallatlas and stats19, around where: latitude,longitude; default: the
        junction, where the scene says where on earth it lies.
    accidents_within_m : float, optional
        Of the same, how far from there; default: 500.
    score : {"avoided", "rating-2026"}
        What a run counts that is not avoided: nothing; or by the speed that is left at contact, as
        in Euro NCAP's rating of 2026. With it, whatever is optimised or bounded as APR is this
        score, also `target` and `min_case_apr`.
    fusion : {"any", "single"}
        any: a frame counts if any unit detects; single: one unit must confirm alone.
    detector : str
        Of cameras: geometric (by boxes), response (misses by size, cover, class, weather), cnn (the
        shipped network, on rendered pictures), cnn-table (the table fitted to it), pole-2015 or
        car-2019 (tables fitted to real recordings), a .toml file with a response table, or an
        .onnx network. LiDARs detect with enough points; +pointrcnn-2019 behind it: as often as a
        real detector found them so far away.
    vut_sensors : str
        What the VUT itself looks with: camera,lidar.
    cars : str
        Of the VUTs: blind (they act on what roadside units tell them, and on nothing else), see
        (their own sensors are one more unit in every run, which costs nothing and never fails), or
        the share of them that see, such as 0.3; runs are a weighted sum of both then.
    packet_loss : float
        Of the RSUs' and road users' messages, frame by frame; in the evaluation.
    vam_rate : float
        Of the road users who announce themselves (VRU awareness messages).
    n_confirmations : int, optional
        Detected frames in a row that confirm; default: the study's 3.
    track_memory_s : float, optional
        A confirmed track lives so long without detections, and must live at the last moment; inf:
        for ever, as the study reads it. Default: 1, but inf for `cases` study and recordings.
    latency_s : float, optional
        From the confirming frame to braking; default: the study's 0.025.
    latency_budget : str
        In place of `latency_s`: the mean of study, cpm-100ms, cpm-50ms, or of a .toml file of
        parts.
    deceleration_mps2 : float, optional
        Of full braking; default: the study's 7.72.
    build_up_s : float, optional
        Until braking is full; default: the study's 0.
    """

    budget: Annotated[int, _at_least(1, "a whole number of units")] | None = None
    budget_cost: Annotated[float, _positive("euros", _MOST_EUR)] | None = None
    target: str = ""
    least: Literal["units", "cost"] = "units"
    min_case_apr: Annotated[float, _share("a share of the runs")] = 0.0
    survive: str = "0"
    give_up: Annotated[float, _share("a share of the runs")] | None = None
    keep: str = ""
    within: str = ""
    force_site: str = ""
    forbid_site: str = ""
    site_capacity: Annotated[int, _at_least(1, "units per site", _MOST_PER_SITE)] | None = None
    site_cost_eur: Annotated[float, _at_least(0, "euros", _MOST_EUR_PER_SITE)] | None = None
    separation_m: Annotated[float, _at_least(0, "metres", 10_000)] = 0.0
    sensors: str = ""
    heights: str = ""
    yaw_step_deg: (
        Annotated[
            float,
            Meta(ge=0.1, le=360.0, description="degrees that divide 360 evenly, at least 0.1"),
        ]
        | None
    ) = None
    pitches: str = ""
    no_look: str = ""
    no_look_share: Annotated[float, _share("a share of an area")] | None = None
    solver: Literal["auto", "exact", "relax", "greedy"] = "auto"
    time_limit_s: Annotated[float, _positive("seconds", _MOST_S)] = 60.0
    gap: Annotated[float, _share("a relative gap")] = 0.0
    refine: bool = False
    samples: (
        Annotated[int, _at_least(0, "auto, or a number of sampled worlds", _MOST_SAMPLES)]
        | Literal["auto"]
    ) = 0
    uncertainty: str = "default"
    traffic: str = ""
    risk: str = "mean"
    scene: str = ""
    junction: str = ""
    at: str = ""
    sites: str = ""
    driving_side: Literal["map", "left", "right"] = "map"
    cases: str = DEFAULT_CASES
    case_range: Literal["standard", "extended"] = "standard"
    protect: Literal["vru", "all"] = "vru"
    along_arms: str = ""
    speeds: str = ""
    approaches: str = ""
    weather: str = "day"
    force: bool = False
    strict: bool = False
    weights: str = ""
    near: str = ""
    accidents_within_m: Annotated[float, _positive("metres", 100_000)] | None = None
    score: Literal["avoided", "rating-2026"] = "avoided"
    fusion: Literal["any", "single"] = "any"
    detector: str = "geometric"
    vut_sensors: str = "camera"
    cars: str = BLIND
    packet_loss: Annotated[float, _share("a share of lost messages")] = 0.0
    vam_rate: Annotated[float, _share("a share of equipped road users")] = 0.0
    n_confirmations: Annotated[int, _at_least(1, "a number of frames")] | None = None
    track_memory_s: (
        Annotated[float, Meta(gt=0.0, description="seconds, more than 0, or inf")] | None
    ) = None
    latency_s: Annotated[float, _at_least(0, "seconds")] | None = None
    latency_budget: str = ""
    deceleration_mps2: Annotated[float, _positive("m/s^2")] | None = None
    build_up_s: Annotated[float, _at_least(0, "seconds")] | None = None

    def __post_init__(self) -> None:
        for field in question_fields().values():
            value = getattr(self, field.name)
            if value is not field.default and value != field.default:
                _check_value(field, value, f"question: {field.name}")

    @property
    def n_samples(self) -> int:
        """`samples` as a number; raises InputError where it is still to be found out."""
        if isinstance(self.samples, str):
            expected = f"a number; {AUTO} where the best layout within a budget is chosen"
            raise InputError("samples", self.samples, expected)
        return self.samples


def map_options(question: Question) -> dict[str, Any]:
    """Options of the map that a question's scene is cut out of.

    Keywords of :func:`geometry.load_scene`. Raises InputError if the point is no point.
    """
    options: dict[str, Any] = {}
    if question.junction:
        options["junction"] = question.junction
    if question.at:
        options["at"] = read_point(question.at, "at")
    if question.sites:
        options["sites"] = question.sites
    if question.driving_side != "map":
        options["keeps_left"] = question.driving_side == "left"
    return options


def read_point(text: str, where: str) -> tuple[float, float]:
    """Two finite numbers with a comma between; raises InputError for anything else."""
    numbers = [float_of(word) for word in text.split(",")]
    if len(numbers) != 2 or not all(map(math.isfinite, numbers)):
        raise InputError(where, text, "two numbers: X,Y")
    return numbers[0], numbers[1]


@dataclass(frozen=True, slots=True, kw_only=True)
class QuestionField:
    """A field of :class:`Question`, taken apart."""

    name: str  # of the field
    key: str  # such as "site_cost": the name in a question file
    # int, float, bool or str, or one of the words of a Literal; with limits in a
    # :class:`msgspec.Meta`
    kind: Any
    default: Any  # None: nothing is given
    description: str  # other fields stand in it between backticks


_KEYS = {"n_confirmations": "confirmations", "build_up_s": "brake_build_up", "case_range": "range"}
_UNIT = re.compile("_(eur|m|deg|s|mps2)$")  # a key has none


@cache
def question_fields() -> dict[str, QuestionField]:
    """The fields of a question by name, in their order."""
    hints = get_type_hints(Question, include_extras=True)
    found = re.findall(r"^    (\w+) : .*\n((?: {8}.*\n)+)", Question.__doc__ or "", re.MULTILINE)
    descriptions = {name: " ".join(text.split()) for name, text in found}
    known = {}
    for field in fields(Question):
        name, kind = field.name, hints[field.name]
        if get_origin(kind) in (Union, UnionType):  # of a value and None
            kind = next(one for one in get_args(kind) if one is not NoneType)
        known[name] = QuestionField(
            name=name,
            key=_KEYS.get(name) or _UNIT.sub("", name),
            kind=kind,
            default=field.default,
            description=descriptions.get(name, ""),
        )
    return known


def split_names(text: str, where: str) -> tuple[str, ...]:
    """Names with commas between; none of an empty text.

    Raises InputError if one is empty, or stands there twice.
    """
    names = tuple(word.strip() for word in text.split(",")) if text else ()
    if not all(names) or len(set(names)) < len(names):
        raise InputError(where, text, "names with commas between, each once")
    return names


def read_number(where: str, text: str, expected: str, low: float, high: float) -> float:
    """A finite number from `low` to `high`; raises InputError for anything else."""
    number = float_of(text)
    if not low <= number <= high or not math.isfinite(number):
        raise InputError(where, text, expected)
    return number


def read_cars(text: str) -> float:
    """Share of the VUTs that see, 0..1: of "blind", "see", or a number.

    Raises InputError for anything else.
    """
    words = {BLIND: 0.0, SEE: 1.0}
    expected = "blind, see, or the share of cars that see, 0 to 1"
    return words[text] if text in words else read_number("cars", text, expected, 0.0, 1.0)


def load_question_values(path: Path) -> dict[str, Any]:
    """Read a question file: the values that it gives, by the names of the fields.

    Raises InputError if it cannot be read, or has an unknown key or a value that cannot be.
    """
    known = {field.key: field for field in question_fields().values()}
    values = {}
    for key, value in load_toml(path).items():
        if key not in known:
            raise InputError(str(path), key, "one of " + ", ".join(known))
        field = known[key]
        if field.kind is str and isinstance(value, int | float) and not isinstance(value, bool):
            value = str(value)
        values[field.name] = _check_value(field, value, f"{path}: {key}")
    return values


def _check_value(field: QuestionField, value: Any, where: str) -> Any:
    """A value of a field, of its kind. Raises InputError if it is of another kind, or too large."""
    if (field.name, value) in (("track_memory_s", math.inf), ("samples", AUTO)):
        return value
    return read_table(value, field.kind, where)


def load_question(path: str | Path) -> Question:
    """Read a question file (TOML); what it does not give has its default.

    Its keys are the names of the options with underscores, such as ``site_cost = 500.0``. Raises
    InputError: it cannot be read, or has an unknown key or a value that cannot be.
    """
    return Question(**load_question_values(Path(path)))


def question_text(question: Question) -> str:
    """A question file's text: every field that differs from its default, below its description."""
    import tomlkit

    document = tomlkit.document()
    document.add(tomlkit.comment("A question for place-rsus --question FILE."))
    for field in question_fields().values():
        value = getattr(question, field.name)
        if value != field.default:
            document.add(tomlkit.nl())
            for line in textwrap.wrap(field.description, 96, break_on_hyphens=False):
                document.add(tomlkit.comment(line))
            document.add(field.key, value)
    return tomlkit.dumps(document)


def save_question(path: str | Path, question: Question) -> None:
    """Write a question file, see :func:`question_text`."""
    with reading(path, "a file that can be written", OSError):
        write_atomically(Path(path), question_text(question))


Question.__signature__ = Signature(  # type: ignore[attr-defined]  # without limits, to be read
    [
        Parameter(field.name, Parameter.KEYWORD_ONLY, default=field.default)
        for field in question_fields().values()
    ]
)
