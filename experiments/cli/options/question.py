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


def _field_option(name: str, flag: str, **settings: Any) -> partial[Decorator]:
    """:func:`option` of a field, to be called with what a command has otherwise.

    Parameters
    ----------
    name : str
        The field, and the parameter of the command.
    flag : str
        Name of the option on the command line, see :func:`option_of`.
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
        flag,
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

QUESTION_OPTIONS: dict[str, partial[Decorator]] = {
    # ---------- What is asked
    "budget": _field_option(
        "budget",
        "--budget",
        metavar="N",
        section=ASKED,
    ),
    "budget_cost": _field_option(
        "budget_cost",
        "--budget-cost",
        metavar="EUR",
        section=ASKED,
    ),
    "target": _field_option(
        "target",
        "--target",
        metavar="SHARE",
        section=ASKED,
    ),
    "least": _field_option(
        "least",
        "--least",
        needs="target",
        section=ASKED,
    ),
    "min_case_apr": _field_option(
        "min_case_apr",
        "--min-case-apr",
        metavar="SHARE",
        section=ASKED,
        is_common=False,
    ),
    "survive": _field_option(
        "survive",
        "--survive",
        metavar="N|unit|site",
        section=ASKED,
    ),
    "give_up": _field_option(
        "give_up",
        "--give-up",
        metavar="SHARE",
        section=ASKED,
        is_common=False,
    ),
    "located_m": _field_option(
        "located_m",
        "--located",
        metavar="METRES",
        section=ASKED,
        is_common=False,
    ),
    # ---------- What may be mounted, and where
    "keep": _field_option(
        "keep",
        "--keep",
        metavar="LAYOUT",
        is_path=True,
        section=MOUNTED,
    ),
    "within": _field_option(
        "within",
        "--within",
        metavar="LAYOUT",
        is_path=True,
        section=MOUNTED,
    ),
    "force_site": _field_option(
        "force_site",
        "--force-site",
        metavar="SITES",
        section=MOUNTED,
        is_common=False,
    ),
    "forbid_site": _field_option(
        "forbid_site",
        "--forbid-site",
        metavar="SITES",
        section=MOUNTED,
        is_common=False,
    ),
    "site_capacity": _field_option(
        "site_capacity",
        "--site-capacity",
        metavar="N",
        section=MOUNTED,
        is_common=False,
    ),
    "site_cost_eur": _field_option(
        "site_cost_eur",
        "--site-cost",
        metavar="EUR",
        section=MOUNTED,
        is_common=False,
    ),
    "separation_m": _field_option(
        "separation_m",
        "--separation",
        metavar="METRES",
        section=MOUNTED,
        is_common=False,
    ),
    "sensors": _field_option(
        "sensors",
        "--sensors",
        metavar="NAMES",
        excludes="within",
        section=MOUNTED,
    ),
    "heights": _field_option(
        "heights",
        "--heights",
        metavar="METRES",
        section=MOUNTED,
        is_common=False,
    ),
    "yaw_step_deg": _field_option(
        "yaw_step_deg",
        "--yaw-step",
        metavar="DEGREES",
        section=MOUNTED,
        is_common=False,
    ),
    "pitches": _field_option(
        "pitches",
        "--pitches",
        metavar="DEGREES",
        section=MOUNTED,
        is_common=False,
    ),
    "no_look": _field_option(
        "no_look",
        "--no-look",
        metavar="FILE",
        is_path=True,
        section=MOUNTED,
        is_common=False,
    ),
    "no_look_share": _field_option(
        "no_look_share",
        "--no-look-share",
        metavar="SHARE",
        needs="no_look",
        section=MOUNTED,
        is_common=False,
    ),
    # ---------- How it is looked for
    "solver": _field_option(
        "solver",
        "--solver",
        section=SOUGHT,
        is_common=False,
    ),
    "time_limit_s": _field_option(
        "time_limit_s",
        "--time-limit",
        metavar="SECONDS",
        section=SOUGHT,
    ),
    "gap": _field_option(
        "gap",
        "--gap",
        metavar="SHARE",
        section=SOUGHT,
        is_common=False,
    ),
    "refine": _field_option(
        "refine",
        "--refine/--no-refine",
        section=SOUGHT,
    ),
    "samples": _field_option(
        "samples",
        "--samples",
        metavar="N|auto",
        word="auto",
        section=SOUGHT,
        is_common=False,
    ),
    "uncertainty": _field_option(
        "uncertainty",
        "--uncertainty",
        metavar="NAME",
        needs="samples",
        section=SOUGHT,
        is_common=False,
    ),
    "traffic": _field_option(
        "traffic",
        "--traffic",
        metavar="sumo|FILE",
        is_path=True,
        needs="samples",
        section=SOUGHT,
        is_common=False,
    ),
    "risk": _field_option(
        "risk",
        "--risk",
        metavar="HOW",
        needs="samples",
        section=SOUGHT,
        is_common=False,
    ),
    # ---------- What is driven
    "scene": _field_option(
        "scene",
        "--scene",
        metavar="PATH",
        is_path=True,
        section=DRIVEN,
    ),
    "junction": _field_option(
        "junction",
        "--junction",
        metavar="NAME",
        section=DRIVEN,
    ),
    "at": _field_option(
        "at",
        "--at",
        metavar="X,Y",
        section=DRIVEN,
        is_common=False,
    ),
    "sites": _field_option(
        "sites",
        "--sites",
        metavar="WHERE",
        section=DRIVEN,
        is_common=False,
    ),
    "sites_crs": _field_option(
        "sites_crs",
        "--sites-crs",
        metavar="CRS",
        section=DRIVEN,
        is_common=False,
    ),
    "driving_side": _field_option(
        "driving_side",
        "--driving-side",
        section=DRIVEN,
        is_common=False,
    ),
    "cases": _field_option(
        "cases",
        "--cases",
        metavar="CASES",
        section=DRIVEN,
    ),
    "case_range": _field_option(
        "case_range",
        "--range",
        section=DRIVEN,
        is_common=False,
    ),
    "protect": _field_option(
        "protect",
        "--protect",
        section=DRIVEN,
        is_common=False,
    ),
    "along_arms": _field_option(
        "along_arms",
        "--along-arms",
        metavar="METRES",
        section=DRIVEN,
    ),
    "speeds": _field_option(
        "speeds",
        "--speeds",
        metavar="KMH",
        section=DRIVEN,
        is_common=False,
    ),
    "approaches": _field_option(
        "approaches",
        "--approaches",
        metavar="ARMS",
        section=DRIVEN,
        is_common=False,
    ),
    "weather": _field_option(
        "weather",
        "--weather",
        metavar="WEATHER",
        section=DRIVEN,
    ),
    "weights": _field_option(
        "weights",
        "--weights",
        metavar="HOW",
        section=DRIVEN,
        is_common=False,
    ),
    "near": _field_option(
        "near",
        "--near",
        metavar="LAT,LON",
        needs="weights",
        section=DRIVEN,
        is_common=False,
    ),
    "accidents_within_m": _field_option(
        "accidents_within_m",
        "--accidents-within",
        metavar="METRES",
        needs="weights",
        section=DRIVEN,
        is_common=False,
    ),
    # ---------- What is seen, told and braked
    "fusion": _field_option(
        "fusion",
        "--fusion",
        section=SEEN,
    ),
    "detector": _field_option(
        "detector",
        "--detector",
        metavar="HOW",
        section=SEEN,
    ),
    "vut_sensors": _field_option(
        "vut_sensors",
        "--vut-sensors",
        metavar="SENSORS",
        section=SEEN,
        is_common=False,
    ),
    "cars": _field_option(
        "cars",
        "--cars",
        metavar="see|blind|SHARE",
        section=SEEN,
        is_common=False,
    ),
    "packet_loss": _field_option(
        "packet_loss",
        "--packet-loss",
        metavar="SHARE",
        section=SEEN,
        is_common=False,
    ),
    "vam_rate": _field_option(
        "vam_rate",
        "--vam-rate",
        metavar="SHARE",
        section=SEEN,
        is_common=False,
    ),
    "n_confirmations": _field_option(
        "n_confirmations",
        "--confirmations",
        metavar="N",
        section=SEEN,
        is_common=False,
    ),
    "track_memory_s": _field_option(
        "track_memory_s",
        "--track-memory",
        metavar="SECONDS",
        takes_infinity=True,
        section=SEEN,
        is_common=False,
    ),
    "decision": _field_option(
        "decision",
        "--decision",
        metavar="RULE",
        is_path=True,
        section=SEEN,
        is_common=False,
    ),
    "latency_s": _field_option(
        "latency_s",
        "--latency",
        metavar="SECONDS",
        section=SEEN,
        is_common=False,
    ),
    "latency_budget": _field_option(
        "latency_budget",
        "--latency-budget",
        metavar="NAME|FILE",
        section=SEEN,
        is_common=False,
    ),
    "deceleration_mps2": _field_option(
        "deceleration_mps2",
        "--deceleration",
        metavar="M/S2",
        section=SEEN,
        is_common=False,
    ),
    "build_up_s": _field_option(
        "build_up_s",
        "--brake-build-up",
        metavar="SECONDS",
        section=SEEN,
        is_common=False,
    ),
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
