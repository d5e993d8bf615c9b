"""Options that ask a question, one for each field of :class:`placement.Question`.

Types, bounds, words of errors, defaults and help texts are the fields' own, which the
library checks, and which question files and the planner's page have, too.
"""

import re
from collections.abc import Callable, Sequence
from functools import partial, wraps
from pathlib import Path
from typing import Annotated, Any, Literal, cast, get_args, get_origin

import click
from click.core import ParameterSource
from msgspec import Meta

from geometry.errors import InputError
from placement.question import (
    Question,
    QuestionField,
    load_question_values,
    question_fields,
    save_question,
)

from .worded import PROGRAM, Decorator, combined, option

ASKED = "What is asked"
MOUNTED = "What may be mounted, and where"
SOUGHT = "How it is looked for"
DRIVEN = "Simulated runs"
SEEN = "What is seen, told and braked"
SECTIONS = (ASKED, MOUNTED, SOUGHT, DRIVEN, SEEN)
"""Titles in the help, in its order."""


# ---------- what a field says about its option


def option_of(field: QuestionField) -> str:
    """Name of the option of a field, such as "--site-cost"."""
    return "--" + field.key.replace("_", "-")


def help_of(field: QuestionField) -> str:
    """Description of a field, with options in place of the other fields' names.

    The library names fields between backticks, which command lines do not know.
    """
    known = question_fields()

    def named(found: re.Match[str]) -> str:
        name = found[1]
        if name not in known:
            return found[0]
        return option_of(known[name])

    return re.sub("`([a-z_0-9]+)`", named, field.description)


def _field_option(name: str, *, flag: str = "", **settings: Any) -> partial[Decorator]:
    """:func:`option` of a field, to be called with what a command has otherwise.

    Parameters
    ----------
    name : str
        The field, and the parameter of the command.
    flag : str
        Name of the option on the command line; by default see :func:`option_of`.
    **settings
        All that the field itself does not say, as :func:`option` takes it.

    Returns
    -------
    partial
        Called without arguments it is the option; ``default=8`` gives it another
        default.
    """
    field = question_fields()[name]
    kind = field.kind
    limits = Meta()
    if get_origin(kind) is Annotated:
        kind, limits = get_args(kind)
    return partial(
        option,
        flag or option_of(field),
        name,
        type=_click_type(kind, limits),
        default=field.default,
        expected=limits.description or "",
        help=help_of(field),
        **settings,
    )


def _click_type(kind: Any, limits: Meta) -> "click.ParamType[Any] | None":
    """Type of an option whose values are of a kind, within limits.

    Parameters
    ----------
    kind : type or Literal
        int, float, bool, str, or words of which one is chosen.
    limits : msgspec.Meta
        Least and greatest value of a number.

    Returns
    -------
    click.ParamType or None
        None: click finds it by the default and the name.
    """
    if get_origin(kind) is Literal:
        return click.Choice(get_args(kind))
    if kind is int:
        # Limits of whole numbers are whole numbers, which their type does not say.
        least_whole = cast("int | None", limits.ge)
        most_whole = cast("int | None", limits.le)
        return click.IntRange(min=least_whole, max=most_whole)
    if kind is float:
        is_open = limits.gt is not None
        if is_open:
            least = limits.gt
        else:
            least = limits.ge
        return click.FloatRange(min=least, max=limits.le, min_open=is_open)
    return None


# ---------- the options, in the order of the fields

_COMMON = {
    "budget",
    "budget_cost",
    "target",
    "least",
    "survive",
    "keep",
    "within",
    "sensors",
    "time_limit_s",
    "refine",
    "scene",
    "junction",
    "cases",
    "along_arms",
    "weather",
    "fusion",
    "detector",
}
"""Fields whose options the short help shows, too."""
_FIELDS: dict[str, dict[str, dict[str, Any]]] = {
    ASKED: {
        "budget": {"metavar": "N"},
        "budget_cost": {"metavar": "EUR"},
        "target": {"metavar": "SHARE"},
        "least": {"needs": "target"},
        "min_case_apr": {"metavar": "SHARE"},
        "survive": {"metavar": "N|unit|site"},
        "give_up": {"metavar": "SHARE"},
        "located_m": {"metavar": "METRES"},
    },
    MOUNTED: {
        "keep": {"metavar": "LAYOUT", "is_path": True},
        "within": {"metavar": "LAYOUT", "is_path": True},
        "force_site": {"metavar": "SITES"},
        "forbid_site": {"metavar": "SITES"},
        "site_capacity": {"metavar": "N"},
        "site_cost_eur": {"metavar": "EUR"},
        "separation_m": {"metavar": "METRES"},
        "sensors": {"metavar": "NAMES", "excludes": "within"},
        "heights": {"metavar": "METRES"},
        "yaw_step_deg": {"metavar": "DEGREES"},
        "pitches": {"metavar": "DEGREES"},
        "no_look": {"metavar": "FILE", "is_path": True},
        "no_look_share": {"metavar": "SHARE", "needs": "no_look"},
    },
    SOUGHT: {
        "solver": {},
        "time_limit_s": {"metavar": "SECONDS"},
        "gap": {"metavar": "SHARE"},
        "refine": {"flag": "--refine/--no-refine"},
        "samples": {"metavar": "N|auto", "word": "auto"},
        "uncertainty": {"metavar": "NAME", "needs": "samples"},
        "traffic": {"metavar": "sumo|FILE", "is_path": True, "needs": "samples"},
        "risk": {"metavar": "HOW", "needs": "samples"},
    },
    DRIVEN: {
        "scene": {"metavar": "PATH", "is_path": True},
        "junction": {"metavar": "NAME"},
        "at": {"metavar": "X,Y"},
        "sites": {"metavar": "WHERE"},
        "sites_crs": {"metavar": "CRS"},
        "driving_side": {},
        "cases": {"metavar": "CASES"},
        "case_range": {},
        "protect": {},
        "along_arms": {"metavar": "METRES"},
        "speeds": {"metavar": "KMH"},
        "approaches": {"metavar": "ARMS"},
        "weather": {"metavar": "WEATHER"},
        "weights": {"metavar": "HOW"},
        "near": {"metavar": "LAT,LON", "needs": "weights"},
        "accidents_within_m": {"metavar": "METRES", "needs": "weights"},
    },
    SEEN: {
        "fusion": {},
        "detector": {"metavar": "HOW"},
        "vut_sensors": {"metavar": "SENSORS"},
        "cars": {"metavar": "see|blind|SHARE"},
        "packet_loss": {"metavar": "SHARE"},
        "vam_rate": {"metavar": "SHARE"},
        "n_confirmations": {"metavar": "N"},
        "track_memory_s": {"metavar": "SECONDS", "takes_infinity": True},
        "decision": {"metavar": "RULE", "is_path": True},
        "latency_s": {"metavar": "SECONDS"},
        "latency_budget": {"metavar": "NAME|FILE"},
        "deceleration_mps2": {"metavar": "M/S2"},
        "build_up_s": {"metavar": "SECONDS"},
    },
}
"""What the options of each section's fields have, beside what the fields say."""
QUESTION_OPTIONS = {
    name: _field_option(name, section=section, is_common=name in _COMMON, **settings)
    for section, fields in _FIELDS.items()
    for name, settings in fields.items()
}
"""What adds the option of each field; ``QUESTION_OPTIONS["samples"](default=8)``."""

# ---------- which fields a command asks


def fields_in(*sections: str, but: Sequence[str] = ()) -> tuple[str, ...]:
    """Names of the fields in these sections of the help, without some of them.

    Parameters
    ----------
    *sections : str
        Such as :data:`ASKED`.
    but : sequence of str
        Fields that are left out.
    """
    return tuple(
        name
        for name, add in QUESTION_OPTIONS.items()
        if add.keywords["section"] in sections and name not in but
    )


OF_SCENE = ("scene", "junction", "at", "sites", "sites_crs", "driving_side")
"""Fields that say which junction it is."""
PLANNED = (*fields_in(ASKED, MOUNTED, SOUGHT), "fusion")
"""Fields of commands that look for layouts."""
JUDGED = fields_in(DRIVEN, SEEN, but=("fusion", "decision"))
"""Fields of commands that evaluate layouts."""
_JUDGING = (
    "fusion",
    "weights",
    "near",
    "accidents_within_m",
    "vut_sensors",
    "cars",
    "packet_loss",
    "vam_rate",
    "decision",
)
PICTURED = fields_in(DRIVEN, SEEN, but=(*_JUDGING, "track_memory_s"))
"""Fields of commands that draw what each unit sees, whoever judges it."""
ONLY_DRIVEN = fields_in(DRIVEN, SEEN, but=(*_JUDGING, "detector"))
"""Fields of commands that show what is driven and judge nothing."""


# ---------- how a command gets its question


def _read_question(
    context: click.Context, _param: click.Parameter, path: Path | None
) -> None:
    """Let a question file give what the command line does not.

    Raises InputError if it cannot be read, or has an unknown key or a value that cannot
    be.
    """
    if path is not None:
        context.default_map = load_question_values(path)


_question_file_option = option(
    "--question",
    type=click.Path(path_type=Path),
    metavar="FILE",
    expose_value=False,
    is_eager=True,
    callback=_read_question,
    is_path=True,
    section=PROGRAM,
    help=(
        "Read the question from a TOML file: every option above, by its name with "
        "underscores; what stands on the command line wins, what this command has no "
        "option for is not used."
    ),
)
_save_question_option = option(
    "--save-question",
    "save_question_to",
    type=click.Path(path_type=Path),
    metavar="FILE",
    is_path=True,
    section=PROGRAM,
    help="Write the question in use to a TOML file for --question.",
)


def question_options(
    *names: str,
    defaults: dict[str, Any] | None = None,
    named_apart: Sequence[str] = (),
    has_file: bool = True,
) -> Decorator:
    """Options of a command that asks something; it gets them as one `question`.

    Fields that are not named keep their defaults, also where a question file gives
    them: one file serves every command.

    Parameters
    ----------
    *names : str
        Fields that the command has options for.
    defaults : dict, optional
        Defaults in place of the fields' own, by field.
    named_apart : sequence of str
        Fields whose parameters the command adds itself.
    has_file : bool
        The command has ``--question`` and ``--save-question``, too.

    Raises
    ------
    InputError
        A value is none that its field can have.
    """
    changed = defaults or {}
    # In the order of the fields, which is that of the help
    added = []
    for name, add in QUESTION_OPTIONS.items():
        if name not in names:
            continue
        if name in changed:
            added.append(add(default=changed[name]))
        else:
            added.append(add())
    if has_file:
        added += [_question_file_option, _save_question_option]
    asked = (*names, *named_apart)

    # The command does not see the single values: they become one question here.
    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def with_question(
            *args: Any, save_question_to: Path | None = None, **values: Any
        ) -> Any:
            question = Question(**{name: values.pop(name) for name in asked})
            _refuse_program_of_file(question)
            if save_question_to is not None:
                save_question(save_question_to, question)
            return command(*args, question=question, **values)

        return combined(*added)(with_question)

    return decorate


def _refuse_program_of_file(question: Question) -> None:
    """Raise InputError for a network that only a question file names.

    It is a program, and files come by mail.
    """
    source = click.get_current_context().get_parameter_source("detector")
    if source is ParameterSource.DEFAULT_MAP and ".onnx" in question.detector:
        trusted = f"--detector {question.detector} as well if you trust it"
        expected = f"no network, which is a program, or {trusted}"
        raise InputError("--question: detector", question.detector, expected)


def one_run_options() -> Decorator:
    """The argument and options that name a run.

    The command gets `question`, with that run's case, approach and speeds, and
    `position`.
    """
    # One run has one case, approach and speed: these have names of their own.
    apart = ("cases", "approaches", "speeds")
    asked = [name for name in ONLY_DRIVEN if name not in (*apart, "along_arms")]
    return combined(
        click.argument("cases", metavar="CASE"),
        option(
            "--approach",
            "approaches",
            required=True,
            metavar="ARM",
            help="Such as east.",
        ),
        option(
            "--speed",
            "speeds",
            required=True,
            metavar="KMH",
            help="Of the VUT; 30x50: and of whoever it meets.",
        ),
        option(
            "--position",
            default="0",
            metavar="METRES",
            help=(
                "Where along the arms: -15 is so far before the junction, +15"
                " behind it."
            ),
        ),
        question_options(*asked, named_apart=apart, has_file=False),
    )
