"""The question: everything that a user asks, as typed values.

It is read from and written to TOML. Imports nothing heavy.
"""

import math
import re
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from inspect import Parameter, Signature, cleandoc
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from msgspec import Meta

from geometry.errors import InputError
from geometry.opening import reading
from geometry.tables import read_table
from geometry.text_formats import float_of, load_data, load_toml
from geometry.writing import write_atomically

DEFAULT_CASES = "default"
BLIND = "blind"
SEE = "see"
AUTO = "auto"
BASELINE_NAME = "carlancap-12"
"""Name of the study's own layout."""


# Of a certificate over sampled worlds: blocks, worlds in each, and worlds to judge
# layouts in.
N_BLOCKS = 5
N_SAMPLES = 8
N_JUDGED = 60


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """A user's question.

    It says what is driven and how the VUT brakes, what may be mounted, and how hard
    to look. What its fields mean stands in ``data/question.toml``, and in this
    class's docstring at run time. Lists are one text with commas between; an empty
    text means that nothing is given. Raises InputError where a value is of another
    kind, or out of its range.
    """

    budget: int | None = None
    budget_cost: float | None = None
    target: str = ""
    least: Literal["units", "cost"] = "units"
    min_case_apr: float = 0.0
    survive: str = "0"
    give_up: float | None = None
    located_m: float | None = None
    keep: str = ""
    within: str = ""
    force_site: str = ""
    forbid_site: str = ""
    site_capacity: int | None = None
    site_cost_eur: float | None = None
    separation_m: float = 0.0
    sensors: str = ""
    heights: str = ""
    yaw_step_deg: float | None = None
    pitches: str = ""
    no_look: str = ""
    no_look_share: float | None = None
    solver: Literal["auto", "exact", "relax", "greedy"] = "auto"
    time_limit_s: float = 60.0
    gap: float = 0.0
    refine: bool = False
    samples: int | Literal["auto"] = 0
    uncertainty: str = "default"
    traffic: str = ""
    risk: str = "mean"
    scene: str = ""
    junction: str = ""
    at: str = ""
    sites: str = ""
    sites_crs: str = ""
    driving_side: Literal["map", "left", "right"] = "map"
    cases: str = DEFAULT_CASES
    case_range: Literal["standard", "extended"] = "standard"
    protect: Literal["vru", "all"] = "vru"
    along_arms: str = ""
    speeds: str = ""
    approaches: str = ""
    weather: str = "day"
    weights: str = ""
    near: str = ""
    accidents_within_m: float | None = None
    fusion: Literal["any", "single"] = "any"
    detector: str = "geometric"
    vut_sensors: str = "camera"
    cars: str = BLIND
    packet_loss: float = 0.0
    vam_rate: float = 0.0
    n_confirmations: int | None = None
    track_memory_s: float | None = None
    decision: str = ""
    latency_s: float | None = None
    latency_budget: str = ""
    deceleration_mps2: float | None = None
    build_up_s: float | None = None

    def __post_init__(self) -> None:
        for field in question_fields().values():
            value = getattr(self, field.name)
            if value is not field.default and value != field.default:
                _check_value(field, value, f"question: {field.name}")

    @property
    def n_samples(self) -> int:
        """`samples` as a number.

        Raises InputError where the number is still to be found.
        """
        if isinstance(self.samples, str):
            expected = (
                f"a number; {AUTO} where the best layout within a budget is chosen"
            )
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
    if question.sites_crs:
        options["sites_crs"] = question.sites_crs
    if question.driving_side != "map":
        options["keeps_left"] = question.driving_side == "left"
    return options


def read_point(text: str, where: str) -> tuple[float, float]:
    """Two finite numbers with a comma between.

    Raises InputError for anything else.
    """
    numbers = [float_of(word) for word in text.split(",")]
    if len(numbers) != 2 or not all(map(math.isfinite, numbers)):
        raise InputError(where, text, "two numbers: X,Y")
    return numbers[0], numbers[1]


@dataclass(frozen=True, slots=True, kw_only=True)
class QuestionField:
    """A field of :class:`Question`, taken apart.

    Attributes
    ----------
    name : str
        Of the field.
    key : str
        Such as "site_cost": the name in a question file.
    kind : Any
        Int, float, bool or str, or one of the words of a Literal; with limits
        in a :class:`msgspec.Meta`.
    default : Any
        None: nothing is given.
    description : str
        Other fields stand in it between backticks.
    """

    name: str
    key: str
    kind: Any
    default: Any
    description: str


_KEYS = {
    "n_confirmations": "confirmations",
    "build_up_s": "brake_build_up",
    "case_range": "range",
}
# A key has none.
_UNIT = re.compile("_(eur|m|deg|s|mps2)$")


@cache
def question_fields() -> dict[str, QuestionField]:
    """The fields of a question by name, in their order."""
    hints = get_type_hints(Question, include_extras=True)
    words = load_data(__package__, "question.toml")
    known = {}
    for field in fields(Question):
        name = field.name
        kind = hints[name]
        # Of a value and None.
        if get_origin(kind) in (Union, UnionType):
            kind = next(one for one in get_args(kind) if one is not NoneType)
        says = words[name]
        if "expected" in says:
            names = {"min": "ge", "above": "gt", "max": "le"}
            limits: dict[str, Any] = {
                names[one]: says[one] for one in names if one in says
            }
            kind = Annotated[kind, Meta(**limits, description=says["expected"])]
        known[name] = QuestionField(
            name=name,
            key=_KEYS.get(name) or _UNIT.sub("", name),
            kind=kind,
            default=field.default,
            description=says["help"],
        )
    return known


def split_names(text: str, where: str) -> tuple[str, ...]:
    """Names with commas between; none of an empty text.

    Raises InputError if one is empty, or stands there twice.
    """
    if text:
        names = tuple(word.strip() for word in text.split(","))
    else:
        names = ()
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
    if text in words:
        return words[text]
    return read_number("cars", text, expected, 0.0, 1.0)


def load_question_values(path: Path) -> dict[str, Any]:
    """Read a question file: the values that it gives, by the names of the fields.

    Raises InputError if it cannot be read, or has an unknown key or a value that cannot
    be.
    """
    return _read_values(load_toml(path), str(path))


def _read_values(table: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Values of a question file's table, by the names of the fields.

    Raises InputError for an unknown key, or a value that cannot be.
    """
    known = {field.key: field for field in question_fields().values()}
    values = {}
    for key, value in table.items():
        if key not in known:
            raise InputError(where, key, "one of " + ", ".join(known))
        field = known[key]
        if (
            field.kind is str
            and isinstance(value, int | float)
            and not isinstance(value, bool)
        ):
            value = str(value)
        values[field.name] = _check_value(field, value, f"{where}: {key}")
    return values


# JSON has no infinity.
_ENDLESS = "inf"


def question_values(question: Question) -> dict[str, Any]:
    """Values of a question that differ from the defaults, for JSON.

    They are under the keys of a question file.
    """
    values = {}
    for field in question_fields().values():
        value = getattr(question, field.name)
        if value != field.default:
            if value == math.inf:
                values[field.key] = _ENDLESS
            else:
                values[field.key] = value
    return values


def read_question(values: Mapping[str, Any], where: str) -> Question:
    """The question whose :func:`question_values` these are.

    Raises InputError: a key is unknown, or a value cannot be.
    """
    table = dict(values)
    for key, value in table.items():
        if value == _ENDLESS:
            table[key] = math.inf
    return Question(**_read_values(table, where))


def _check_value(field: QuestionField, value: Any, where: str) -> Any:
    """Check a value of a field, and convert it to the field's type.

    Raises InputError if it is of another type, or out of range.
    """
    if (field.name, value) in (("track_memory_s", math.inf), ("samples", AUTO)):
        return value
    return read_table(value, field.kind, where)


def load_question(path: str | Path) -> Question:
    """Read a question file (TOML); what it does not give has its default.

    Its keys are the names of the options with underscores, such as ``site_cost =
    500.0``. Raises InputError: it cannot be read, or has an unknown key or a value that
    cannot be.
    """
    return Question(**load_question_values(Path(path)))


def question_text(question: Question) -> str:
    """Text of a question file.

    It has every field that differs from its default, below the field's description.
    """
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


def _documented(field: QuestionField) -> str:
    """A field as docstrings have it: its type without limits, and its description."""
    kind = getattr(field.kind, "__origin__", field.kind).__name__
    if get_origin(field.kind) is Literal:
        kind = "{" + ", ".join(f'"{word}"' for word in get_args(field.kind)) + "}"
    if field.default is None:
        optional = ", optional"
    else:
        optional = ""
    return f"{field.name} : {kind}{optional}\n    {field.description}"


Question.__doc__ = "\n".join(
    [
        *(cleandoc(Question.__doc__ or ""), "", "Attributes", "----------"),
        *map(_documented, question_fields().values()),
    ]
)
Question.__signature__ = Signature(  # type: ignore[attr-defined]  # the same
    [
        Parameter(field.name, Parameter.KEYWORD_ONLY, default=field.default)
        for field in question_fields().values()
    ]
)
