"""The question: what a user asks, each field with its option; read from and written to TOML.

A field carries all that the command line and the question file need to know about it: its help,
its section, its type with the values that it may have, and its default. Imports nothing heavy.
"""

import math
import textwrap
from dataclasses import dataclass, fields
from functools import cache
from inspect import Parameter, Signature
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from msgspec import Meta

DEFAULT_CASES = "default"
BASELINE_NAME = "carlancap-12"
"""What a user calls the study's own layout."""

ASKED = "What is asked"
MOUNTED = "What may be mounted, and where"
SOUGHT = "How it is looked for"
DRIVEN = "What is driven"
SEEN = "What is seen, told and braked"
SECTIONS = (ASKED, MOUNTED, SOUGHT, DRIVEN, SEEN)


@dataclass(frozen=True, slots=True, kw_only=True)
class Option:
    """How a user meets a field of :class:`Question`."""

    # section, help: where and how the help describes it
    section: str
    help: str
    metavar: str = ""  # what the help shows for a value; empty: what the type says
    # without dashes in front; empty: the field's name. In a question file, dashes are underscores.
    name: str = ""
    is_common: bool = False  # whether most people need it: the short help shows it
    is_path: bool = False  # whether a shell completes the value as a path
    takes_infinity: bool = False  # whether a number may be infinite
    needs: str = ""  # field without which this one has no effect
    excludes: str = ""  # field with which this one has no effect


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """What is asked: what is driven and how it brakes, what may be mounted, how hard to look.

    Lists are one text with commas between; an empty text means that nothing is given. Raises
    InputError where a value is of another kind, or out of its range.
    """

    budget: Annotated[
        Annotated[int, _at_least(1, "a whole number of units")] | None,
        Option(section=ASKED, help="Most units to mount.", is_common=True),
    ] = None
    budget_cost: Annotated[
        Annotated[float, _positive("euros", _MOST_EUR)] | None,
        Option(
            section=ASKED,
            help="Most money to spend on units and sites.",
            metavar="EUR",
            is_common=True,
        ),
    ] = None
    target: Annotated[
        str,
        Option(
            section=ASKED,
            help="APR to be reached with the fewest units: 0.99, or max for all that can be "
            "reached.",
            metavar="SHARE",
            is_common=True,
        ),
    ] = ""
    least: Annotated[
        Literal["units", "cost"],
        Option(
            section=ASKED,
            help="What --target is reached with the least of.",
            is_common=True,
            needs="target",
        ),
    ] = "units"
    min_case_apr: Annotated[
        Annotated[float, _share("a share of the runs")],
        Option(section=ASKED, help="APR that must be reached in every case."),
    ] = 0.0
    survive: Annotated[
        str,
        Option(
            section=ASKED,
            help="Reach --target and --min-case-apr even when any N units fail, or any pole with "
            "all its units: site, or '2 sites'. Without these, look for the highest APR that is "
            "left then.",
            metavar="N|unit|site",
            is_common=True,
        ),
    ] = "0"

    keep: Annotated[
        str,
        Option(
            section=MOUNTED,
            help="A layout that hangs there and is paid: units are added to it.",
            metavar="LAYOUT",
            is_common=True,
            is_path=True,
        ),
    ] = ""
    within: Annotated[
        str,
        Option(
            section=MOUNTED,
            help="Choose among the units of this layout alone: carlancap-12, or a file.",
            metavar="LAYOUT",
            is_common=True,
            is_path=True,
        ),
    ] = ""
    force_site: Annotated[
        str, Option(section=MOUNTED, help="Sites that must carry units.", metavar="SITES")
    ] = ""
    forbid_site: Annotated[
        str, Option(section=MOUNTED, help="Sites that must not carry any.", metavar="SITES")
    ] = ""
    site_capacity: Annotated[
        Annotated[int, _at_least(1, "units per site", _MOST_PER_SITE)] | None,
        Option(section=MOUNTED, help="Units that each site can carry; default: the scene's."),
    ] = None
    site_cost_eur: Annotated[
        Annotated[float, _at_least(0, "euros", _MOST_EUR_PER_SITE)] | None,
        Option(
            section=MOUNTED,
            help="Of each site that is used, once; default: the scene's.",
            metavar="EUR",
            name="site-cost",
        ),
    ] = None
    separation_m: Annotated[
        Annotated[float, _at_least(0, "metres", 10_000)],
        Option(
            section=MOUNTED,
            help="Least distance between two units on the ground; one per site then.",
            metavar="METRES",
            name="separation",
        ),
    ] = 0.0
    sensors: Annotated[
        str,
        Option(
            section=MOUNTED,
            help="Models to choose from, with commas between: carla-ncap-rgb,carla-ncap-lidar, or "
            "your own: FILE.toml, FILE.toml:NAME; default: the study's camera.",
            metavar="NAMES",
            excludes="within",
            is_common=True,
        ),
    ] = ""
    heights: Annotated[
        str,
        Option(
            section=MOUNTED,
            help="Heights that are tried at every site: 4,5.5,7; default: 5,6.5,8.",
            metavar="METRES",
        ),
    ] = ""
    yaw_step_deg: Annotated[
        Annotated[float, Meta(gt=0.0, le=360.0, description="degrees that divide 360 evenly")]
        | None,
        Option(
            section=MOUNTED,
            help="From one yaw that is tried to the next; default: 15.",
            metavar="DEGREES",
            name="yaw-step",
        ),
    ] = None
    pitches: Annotated[
        str,
        Option(
            section=MOUNTED,
            help="Pitches that are tried, positive up: -30,-15; default: -15,-30,-45.",
            metavar="DEGREES",
        ),
    ] = ""
    no_look: Annotated[
        str,
        Option(
            section=MOUNTED,
            help="Areas that no camera may have in its picture; of a layout that is given, the "
            "share of them in each picture is told. Polygons in GeoJSON, GeoPackage or Shapefile.",
            metavar="FILE",
            is_path=True,
        ),
    ] = ""
    no_look_share: Annotated[
        Annotated[float, _share("a share of an area")] | None,
        Option(
            section=MOUNTED,
            help="Share of such an area that may be in the picture all the same; default: none.",
            needs="no_look",
        ),
    ] = None

    solver: Annotated[
        Literal["auto", "exact", "relax", "greedy"],
        Option(
            section=SOUGHT,
            help="greedy: search only; relax: bounds of relaxations; exact: models and "
            "enumeration to the end; auto: what the size allows.",
        ),
    ] = "auto"
    time_limit_s: Annotated[
        Annotated[float, _positive("seconds", _MOST_S)],
        Option(
            section=SOUGHT,
            help="For the optimiser; when it is up, the best layout found and its gap are given.",
            metavar="SECONDS",
            name="time-limit",
            is_common=True,
        ),
    ] = 60.0
    gap: Annotated[
        Annotated[float, _share("a relative gap")],
        Option(section=SOUGHT, help="Relative gap at which an objective counts as settled."),
    ] = 0.0
    refine: Annotated[
        bool,
        Option(
            section=SOUGHT,
            help="Look between the poses of the grid, too: turn, tilt, raise and zoom the units "
            "found; up to a minute more.",
            is_common=True,
        ),
    ] = False
    samples: Annotated[
        Annotated[int, _at_least(0, "a number of sampled worlds", _MOST_SAMPLES)],
        Option(
            section=SOUGHT,
            help="Choose, or compare, in so many worlds with mounting errors, traffic, misses and "
            "lost messages drawn at random; each needs a detection table of its own.",
        ),
    ] = 0
    uncertainty: Annotated[
        str,
        Option(
            section=SOUGHT,
            help="What is drawn for --samples: a name, or a .toml file.",
            metavar="NAME",
            needs="samples",
        ),
    ] = "default"
    traffic: Annotated[
        str,
        Option(
            section=SOUGHT,
            help="Vehicles that drive by in the worlds of --samples: sumo, a .toml file of demand "
            "for it, or FCD of your own model (.xml, .csv, also .gz, .parquet).",
            metavar="sumo|FILE",
            is_path=True,
            needs="samples",
        ),
    ] = ""
    traffic_offset: Annotated[
        str,
        Option(
            section=SOUGHT,
            help="Metres added to x and y of --traffic FILE; default: what the .net.xml beside it "
            "says.",
            metavar="EAST,NORTH",
            needs="traffic",
        ),
    ] = ""
    risk: Annotated[
        str,
        Option(
            section=SOUGHT,
            help="With --samples: mean, worst, or the share of the worst worlds whose mean APR "
            "counts.",
            metavar="HOW",
            needs="samples",
        ),
    ] = "mean"
    pool: Annotated[
        Annotated[int, _at_least(0, "a number of layouts", _MOST_LISTED)],
        Option(
            section=SOUGHT,
            help="List so many layouts that are as good in the first objective, the best first, "
            "and how often each site appears in them.",
        ),
    ] = 0

    scene: Annotated[
        str,
        Option(
            section=DRIVEN,
            help="Folder or .zip of `place-rsus scene import`, or a map (.osm, .osm.pbf, .xodr); "
            "default: the study's junction.",
            metavar="PATH",
            is_common=True,
            is_path=True,
        ),
    ] = ""
    junction: Annotated[
        str,
        Option(
            section=DRIVEN,
            help='Of a map: streets ("A St / B Ave"), id, or "latitude,longitude"; default: the '
            "one with the most arms. `place-rsus scene show MAP` lists them.",
            metavar="NAME",
            is_common=True,
        ),
    ] = ""
    at: Annotated[
        str,
        Option(
            section=DRIVEN,
            help="Of a map: a point near the junction, in the file's own coordinates: "
            "longitude,latitude or metres.",
            metavar="X,Y",
        ),
    ] = ""
    sites: Annotated[
        str,
        Option(
            section=DRIVEN,
            help="Of a map, where sensors may hang: map (its poles), kerb:15 (every 15 m along the "
            "kerbs), a CSV or GeoJSON file; default: map, and where it has none kerb:15.",
            metavar="WHERE",
        ),
    ] = ""
    driving_side: Annotated[
        Literal["map", "left", "right"],
        Option(section=DRIVEN, help="Of a map, on which traffic keeps; map: as it says or shows."),
    ] = "map"
    cases: Annotated[
        str,
        Option(
            section=DRIVEN,
            help="A set - default (the study's cases, along the arms), study (those at the "
            "junction alone), protocol-4.5.1, all - or names with commas between; CPNA stands for "
            "CPNA-25 and CPNA-75 - or FILE.toml of your own cases. `place-rsus scenarios list` "
            "shows them.",
            metavar="CASES",
            is_common=True,
        ),
    ] = DEFAULT_CASES
    along_arms: Annotated[
        str,
        Option(
            section=DRIVEN,
            help="Where along the arms cases are laid that are not bound to the junction: so far "
            "before and behind it; 0: at the junction alone; default: 0,15,30,45, and 0 for "
            "--cases study. Away from 0 each drives a third of the speeds, in turn.",
            metavar="METRES",
            is_common=True,
        ),
    ] = ""
    speeds: Annotated[
        str,
        Option(
            section=DRIVEN,
            help="VUT speeds: 30,50; 20-40 (the case's own speeds in that range); or all; default: "
            "all up to the speed limits of the map.",
            metavar="KMH",
        ),
    ] = ""
    approaches: Annotated[
        str,
        Option(
            section=DRIVEN,
            help="From where the VUT comes: north,east; default: every arm of the junction.",
            metavar="ARMS",
        ),
    ] = ""
    weather: Annotated[
        str,
        Option(
            section=DRIVEN,
            help="day,night,rain,fog: each run is driven in each.",
            metavar="WEATHER",
            is_common=True,
        ),
    ] = "day"
    force: Annotated[
        bool,
        Option(section=DRIVEN, help="Drive speeds that the protocol does not.", needs="speeds"),
    ] = False
    strict: Annotated[
        bool,
        Option(
            section=DRIVEN,
            help="A case that no approach carries is an error; else it is told and left out.",
        ),
    ] = False
    weights: Annotated[
        str,
        Option(
            section=DRIVEN,
            help="run: every run counts the same; case: every case, and within it every approach, "
            "then every position, then every run; fhwa-crash-types: by how often cars hit people "
            "so; euroncap-rating-2026: by its points; or a CSV file with case, approach, weight, "
            "and if wanted position and weather; default: case, and run for --cases study.",
            metavar="HOW",
        ),
    ] = ""

    fusion: Annotated[
        Literal["any", "single"],
        Option(
            section=SEEN,
            help="any: a frame counts if any unit detects; single: one unit must confirm alone.",
            is_common=True,
        ),
    ] = "any"
    detector: Annotated[
        str,
        Option(
            section=SEEN,
            help="Of cameras: geometric (by boxes), response (misses by size, cover, class, "
            "weather), cnn (the shipped network, on rendered pictures), cnn-table (the table "
            "fitted to it), a .toml file with a response table, or an .onnx network.",
            metavar="HOW",
            is_common=True,
        ),
    ] = "geometric"
    vut_sensors: Annotated[
        str,
        Option(
            section=SEEN, help="What the VUT itself looks with: camera,lidar.", metavar="SENSORS"
        ),
    ] = "camera"
    packet_loss: Annotated[
        Annotated[float, _share("a share of lost messages")],
        Option(
            section=SEEN,
            help="Of the RSUs' and road users' messages, frame by frame; in the evaluation.",
        ),
    ] = 0.0
    vam_rate: Annotated[
        Annotated[float, _share("a share of equipped road users")],
        Option(
            section=SEEN, help="Of the road users who announce themselves (VRU awareness messages)."
        ),
    ] = 0.0
    n_confirmations: Annotated[
        Annotated[int, _at_least(1, "a number of frames")] | None,
        Option(
            section=SEEN,
            help="Detected frames in a row that confirm; default: the study's 3.",
            name="confirmations",
        ),
    ] = None
    track_memory_s: Annotated[
        Annotated[float, Meta(gt=0.0, description="seconds, more than 0, or inf")] | None,
        Option(
            section=SEEN,
            help="A confirmed track lives so long without detections, and must live at the last "
            "moment; inf: for ever, as the study reads it. Default: 1, but inf for --cases study "
            "and recordings.",
            metavar="SECONDS",
            name="track-memory",
            takes_infinity=True,
        ),
    ] = None
    latency_s: Annotated[
        Annotated[float, _at_least(0, "seconds")] | None,
        Option(
            section=SEEN,
            help="From the confirming frame to braking; default: the study's 0.025.",
            metavar="SECONDS",
            name="latency",
        ),
    ] = None
    latency_budget: Annotated[
        str,
        Option(
            section=SEEN,
            help="In place of --latency: the mean of study, cpm-100ms, cpm-50ms, or of a .toml "
            "file of parts.",
            metavar="NAME|FILE",
        ),
    ] = ""
    deceleration_mps2: Annotated[
        Annotated[float, _positive("m/s^2")] | None,
        Option(
            section=SEEN,
            help="Of full braking; default: the study's 7.72.",
            metavar="M/S2",
            name="deceleration",
        ),
    ] = None
    build_up_s: Annotated[
        Annotated[float, _at_least(0, "seconds")] | None,
        Option(
            section=SEEN,
            help="Until braking is full; default: the study's 0.",
            metavar="SECONDS",
            name="brake-build-up",
        ),
    ] = None

    def __post_init__(self) -> None:
        for field in question_fields().values():
            value = getattr(self, field.name)
            if value is not field.default and value != field.default:
                _check_value(field, value, f"question: {field.name}")


def map_options(question: Question) -> dict[str, Any]:
    """What a question says of the map that its scene is cut out of; empty: nothing.

    Keywords of :func:`geometry.load_scene`. Raises InputError if the point is no point.
    """
    options: dict[str, Any] = {}
    if question.junction:
        options["junction"] = question.junction
    if question.at:
        options["at"] = read_point(question.at, "--at")
    if question.sites:
        options["sites"] = question.sites
    if question.driving_side != "map":
        options["keeps_left"] = question.driving_side == "left"
    return options


def read_point(text: str, where: str) -> tuple[float, float]:
    """Two finite numbers with a comma between; raises InputError for anything else."""
    from geometry.errors import InputError

    try:
        x, y = (float(word) for word in text.split(","))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(where, text, "two numbers: X,Y")
    return x, y


@dataclass(frozen=True, slots=True, kw_only=True)
class QuestionField:
    """A field of :class:`Question`, taken apart."""

    name: str  # of the field
    # int, float, bool or str, or one of the words of a Literal; with limits in a
    # :class:`msgspec.Meta`
    kind: Any
    default: Any  # of the field; None: nothing is given
    option: Option  # how the user meets it

    @property
    def option_name(self) -> str:
        """Such as "--site-cost"."""
        return "--" + (self.option.name or self.name.replace("_", "-"))

    @property
    def key(self) -> str:
        """Such as "site_cost": the name in a question file."""
        return self.option_name.removeprefix("--").replace("-", "_")


@cache
def question_fields() -> dict[str, QuestionField]:
    """The fields of a question that a user can set, by name, in the order of the help."""
    hints = get_type_hints(Question, include_extras=True)
    found = {}
    for field in fields(Question):
        if get_origin(hints[field.name]) is not Annotated:
            continue
        kind, *limits, option = get_args(hints[field.name])
        if limits:  # Python makes one list of what is annotated twice
            kind = Annotated[kind, *limits]
        if get_origin(kind) in (Union, UnionType):  # of a value and None
            kind = next(one for one in get_args(kind) if one is not NoneType)
        found[field.name] = QuestionField(
            name=field.name, kind=kind, default=field.default, option=option
        )
    return found


def split_names(text: str, where: str) -> tuple[str, ...]:
    """Names with commas between; none of an empty text.

    Raises InputError if one is empty, or stands there twice.
    """
    names = tuple(word.strip() for word in text.split(",")) if text else ()
    if not all(names) or len(set(names)) < len(names):
        from geometry.errors import InputError

        raise InputError(where, text, "names with commas between, each once")
    return names


def read_number(where: str, text: str, expected: str, low: float, high: float) -> float:
    """A finite number from `low` to `high`; raises InputError for anything else."""
    from geometry.errors import InputError

    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not low <= number <= high or not math.isfinite(number):
        raise InputError(where, text, expected)
    return number


def load_question_values(path: Path) -> dict[str, Any]:
    """Read a question file: the values that it gives, by the names of the fields.

    Raises InputError if it cannot be read, or has an unknown key or a value that cannot be.
    """
    from geometry.errors import InputError
    from geometry.files import load_toml

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
    from geometry.files import read_table

    if field.option.takes_infinity and value == math.inf:
        return value
    return read_table(value, field.kind, where)


def load_question(path: str | Path) -> Question:
    """Read a question file (TOML); what it does not give has its default.

    Parameters
    ----------
    path : str or Path
        Its keys are the names of the options with underscores, such as ``site_cost = 500.0``.

    Raises
    ------
    InputError
        The file cannot be read, or has an unknown key or a value that cannot be.
    """
    return Question(**load_question_values(Path(path)))


def question_text(question: Question) -> str:
    """A question file's text: every field that differs from its default, below its help."""
    import tomlkit

    document = tomlkit.document()
    document.add(tomlkit.comment("A question for place-rsus --question FILE."))
    for field in question_fields().values():
        value = getattr(question, field.name)
        if value != field.default:
            document.add(tomlkit.nl())
            for line in textwrap.wrap(field.option.help, 96, break_on_hyphens=False):
                document.add(tomlkit.comment(line))
            document.add(field.key, value)
    return tomlkit.dumps(document)


def save_question(path: str | Path, question: Question) -> None:
    """Write a question file: every field that differs from its default, below its help."""
    from geometry.errors import InputError, Unquoted
    from geometry.files import write_atomically

    try:
        write_atomically(Path(path), question_text(question))
    except OSError as error:
        raise InputError(
            str(path), Unquoted(error.strerror or error), "a file that can be written"
        ) from None


def _describe_fields() -> None:
    """Write the fields into the class's docstring, and its signature without annotations."""
    described, parameters = [], []
    for field in question_fields().values():
        kind = get_args(field.kind)[0] if get_origin(field.kind) is Annotated else field.kind
        words = " or ".join(map(repr, get_args(kind))) or kind.__name__
        described.append(f"    {field.name} : {words}, default {field.default!r}")
        described += textwrap.wrap(
            field.option.help, 88, initial_indent=8 * " ", subsequent_indent=8 * " "
        )
        parameters.append(Parameter(field.name, Parameter.KEYWORD_ONLY, default=field.default))
    Question.__doc__ = "\n".join(
        [f"{Question.__doc__}".rstrip(), "", "    Attributes", "    ----------", *described, "    "]
    )
    Question.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    self = Parameter("self", Parameter.POSITIONAL_ONLY)
    Question.__init__.__signature__ = Signature([self, *parameters])  # type: ignore[attr-defined]


_describe_fields()
