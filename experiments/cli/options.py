"""Options that several commands share, and how their values are read."""

import os
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import wraps
from typing import Any

import click
from click.shell_completion import CompletionItem

from placement.question import BASELINE_NAME, DEFAULT_CASES, Question

# ---------- options that several commands share, and how their values are read


PHASES = ("aligned", "worst")
_MAX_DIGITS = 100


class OneOf(click.ParamType[str]):
    """A word from a list; another one is told in this project's words."""

    name = "name"

    def __init__(self, words: Sequence[str]) -> None:
        self.words = words

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        """What the help shows for a value."""
        return "[" + "|".join(self.words) + "]"

    def convert(self, value: str, param: Any, ctx: Any) -> str:
        """The value, checked."""
        if value not in self.words:
            raise input_error(option_name(param), value, "one of " + ", ".join(self.words))
        return value

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Words for a shell to complete."""
        return [CompletionItem(word) for word in self.words if word.startswith(incomplete)]


class WholeNumber(click.ParamType[int]):
    """A whole number from a least value on."""

    name = "number"

    def __init__(self, least: int, what: str) -> None:
        self.least = least
        self.what = what

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        """What the help shows for a value."""
        return "N"

    def convert(self, value: Any, param: Any, ctx: Any) -> int:
        """The value, checked."""
        text = str(value)
        # int() would also take 1_0, other scripts' digits and spaces.
        is_whole = text.isascii() and text.isdigit() and len(text) <= _MAX_DIGITS
        if not is_whole or int(text) < self.least:
            raise input_error(option_name(param), value, f"{self.what}, at least {self.least}")
        return int(text)


class Number(click.ParamType[float]):
    """A finite number, more than a limit or at least it."""

    name = "number"

    def __init__(self, metavar: str, what: str, *, may_be_zero: bool = False) -> None:
        self.metavar = metavar
        self.what = what
        self.may_be_zero = may_be_zero

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        """What the help shows for a value."""
        return self.metavar

    def convert(self, value: Any, param: Any, ctx: Any) -> float:
        """The value, checked."""
        try:
            number = float(value)
        except ValueError:
            number = -1.0
        if not (0.0 < number < float("inf") or (self.may_be_zero and number == 0.0)):
            least = "at least 0" if self.may_be_zero else "more than 0"
            raise input_error(option_name(param), value, f"{self.what}, {least}")
        return number


class Share(Number):
    """A number from 0 to 1."""

    def __init__(self, what: str) -> None:
        super().__init__("SHARE", what, may_be_zero=True)

    def convert(self, value: Any, param: Any, ctx: Any) -> float:
        """The value, checked."""
        try:
            number = float(value)
        except ValueError:
            number = -1.0
        if not 0.0 <= number <= 1.0:
            raise input_error(option_name(param), value, f"{self.what}, 0 to 1")
        return number


def option_name(param: click.Parameter) -> str:
    """The long name of an option."""
    return max(param.opts, key=len)


def input_error(where: str, got: object, expected: str) -> Exception:
    """The error of a value that the user can mend."""
    from geometry.errors import InputError

    return InputError(where, got, expected)


def complete_paths(
    context: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Leaves it to the shell to complete a path; the study's layout goes by its name."""
    takes_layouts = str(param.name) in ("layout_names", "keep", "within")
    if takes_layouts and incomplete and BASELINE_NAME.startswith(incomplete):
        return [CompletionItem(BASELINE_NAME)]
    return [CompletionItem(incomplete, type="file")]


json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print JSON on stdout and nothing else."
)


def _be_verbose(context: click.Context, param: click.Parameter, is_verbose: bool) -> None:
    if is_verbose:
        context.obj.tell_more()


_verbose_option = click.option(
    "--verbose",
    is_flag=True,
    expose_value=False,
    callback=_be_verbose,
    help="Also tell sizes, bounds, files that are read, and seconds per stage.",
)
_quiet_option = click.option("--quiet", is_flag=True, help="No progress on stderr.")


def quiet_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """How much is told on stderr: ``--quiet``, which the command gets, and ``--verbose``."""
    return _quiet_option(_verbose_option(command))


workers_option = click.option(
    "--workers",
    type=WholeNumber(1, "a number of threads"),
    default=os.cpu_count() or 1,
    show_default="one per processor",
    help="Threads.",
)
seed_option = click.option(
    "--seed",
    type=WholeNumber(0, "a whole number"),
    default=0,
    show_default=True,
    help="Of all that is left to chance: points on the road users, misses, lost messages.",
)
layout_option = click.option(
    "--layout",
    "layout_names",
    multiple=True,
    shell_complete=complete_paths,
    help="carlancap-12, or a layout file.",
)


def no_look_option(what: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """``--no-look``: a file of areas."""
    return click.option(
        "--no-look",
        default="",
        metavar="FILE",
        shell_complete=complete_paths,
        help=f"{what}: polygons in GeoJSON, GeoPackage or Shapefile.",
    )


def _cases_option(default: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    return click.option(
        "--cases",
        metavar="CASES",
        default=default,
        show_default=True,
        help="A set - study, protocol-4.5.1, all - or names with commas between; CPNA stands for "
        "CPNA-25 and CPNA-75. `place-rsus scenarios list` shows them.",
    )


_SELECTION_OPTIONS = (
    click.option(
        "--speeds",
        default="",
        metavar="KMH",
        help="VUT speeds: 30,50 or 20-40 (the case's own speeds in that range); default: all.",
    ),
    click.option(
        "--approaches",
        default="",
        metavar="ARMS",
        help="From where the VUT comes: north,east; default: every arm of the junction.",
    ),
)
_DRIVE_OPTIONS = (
    click.option(
        "--weather",
        default="day",
        show_default=True,
        metavar="WEATHER",
        help="day,night,rain,fog: each run is driven in each.",
    ),
    click.option("--force", is_flag=True, help="Drive speeds that the protocol does not."),
)
cache_option = click.option(
    "--cache/--no-cache",
    "uses_cache",
    default=True,
    show_default=True,
    help="Keep detection tables between calls, in PLACE_RSUS_CACHE or the user's cache folder.",
)
scene_option = click.option(
    "--scene",
    default="",
    metavar="PATH",
    shell_complete=complete_paths,
    help="Folder or .zip file of `place-rsus scene import`; default: the study's junction.",
)
_BRAKING_OPTIONS = (
    click.option(
        "--deceleration",
        "deceleration_mps2",
        type=Number("M/S2", "m/s^2"),
        help="Of full braking; default: the study's 7.72.",
    ),
    click.option(
        "--brake-build-up",
        "build_up_s",
        type=Number("SECONDS", "seconds", may_be_zero=True),
        help="Until braking is full; default: the study's 0.",
    ),
    click.option(
        "--latency",
        "latency_s",
        type=Number("SECONDS", "seconds", may_be_zero=True),
        help="From the confirming frame to braking; default: the study's 0.025.",
    ),
    click.option(
        "--confirmations",
        "n_confirmations",
        type=WholeNumber(1, "a number of frames"),
        help="Detected frames in a row that confirm; default: the study's 3.",
    ),
    click.option(
        "--phase",
        type=OneOf(PHASES),
        default="aligned",
        show_default=True,
        help="aligned: a frame falls on the impact; worst: of ten phases the one that loses most.",
    ),
)
_PERCEPTION_OPTIONS = (
    click.option(
        "--detector",
        default="geometric",
        show_default=True,
        metavar="HOW",
        help="Of cameras: geometric (by boxes), response (misses by size, cover, class, weather), "
        "a .toml file with a response table, or an .onnx network that looks at rendered pictures.",
    ),
    click.option(
        "--vut-sensors",
        default="camera",
        show_default=True,
        metavar="SENSORS",
        help="What the VUT itself looks with: camera,lidar.",
    ),
    click.option(
        "--packet-loss",
        type=Share("a share of lost messages"),
        default=0.0,
        show_default=True,
        help="Of the RSUs' and road users' messages, frame by frame; in the evaluation.",
    ),
    click.option(
        "--vam-rate",
        type=Share("a share of equipped road users"),
        default=0.0,
        show_default=True,
        help="Of the road users who announce themselves (VRU awareness messages).",
    ),
)
_WEIGHT_OPTION = click.option(
    "--weights",
    default="run",
    show_default=True,
    metavar="HOW",
    help="run: every run counts the same; case: every case; euroncap-rating-2026: by its points; "
    "or a CSV file with case, approach, weight.",
)


def question_options(
    *, cases: str = DEFAULT_CASES, has_weights: bool = True
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Options that say what is driven; the command gets them as one `question`.

    Parameters
    ----------
    cases : str
        What is driven unless the user says.
    has_weights : bool
        Whether the command weighs runs and judges layouts on them.
    """
    judging = [_WEIGHT_OPTION, *_PERCEPTION_OPTIONS] if has_weights else []
    return _into_question(
        scene_option,
        _cases_option(cases),
        *_SELECTION_OPTIONS,
        *_DRIVE_OPTIONS,
        *judging,
        *_BRAKING_OPTIONS,
    )


def one_run_options() -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Options and the argument that name a single run, and how it brakes, as one `question`."""
    return _into_question(
        click.argument("cases", metavar="CASE"),
        click.option(
            "--approach", "approaches", required=True, metavar="ARM", help="Such as east."
        ),
        click.option(
            "--speed",
            "speeds",
            required=True,
            type=Number("KMH", "km/h"),
            callback=lambda _context, _param, value: f"{value:g}",
            help="Of the VUT.",
        ),
        scene_option,
        *_DRIVE_OPTIONS,
        *_BRAKING_OPTIONS,
    )


def _into_question(
    *options: Callable[[Callable[..., Any]], Callable[..., Any]],
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def with_question(*args: Any, **values: Any) -> Any:
            names = [field.name for field in fields(Question) if field.name in values]
            question = Question(**{name: values.pop(name) for name in names})
            return command(*args, question=question, **values)

        for option in reversed(options):
            with_question = option(with_question)
        return with_question

    return decorate


# ---------- help in sections


_SECTIONS = {
    "What is asked": (
        "budget",
        "budget_cost",
        "target",
        "least",
        "min_case_apr",
        "survive",
        "stage_weights",
    ),
    "What may be mounted, and where": (
        "keep",
        "within",
        "force_site",
        "forbid_site",
        "site_capacity",
        "site_cost_eur",
        "separation_m",
        "sensors",
        "no_look",
        "no_look_share",
        "no_look_price",
        "study_poses",
    ),
    "How it is looked for": (
        "solver",
        "milp_solver",
        "time_limit_s",
        "gap",
        "refine",
        "samples",
        "uncertainty",
        "risk",
        "pool",
        "pool_tolerance",
    ),
    "What is driven": (
        "scene",
        "cases",
        "speeds",
        "approaches",
        "weather",
        "force",
        "phase",
        "weights",
    ),
    "What is seen, told and braked": (
        "fusion",
        "detector",
        "vut_sensors",
        "packet_loss",
        "vam_rate",
        "n_confirmations",
        "latency_s",
        "latency_budget",
        "latency_mode",
        "deceleration_mps2",
        "build_up_s",
        "recording",
        "min_confidence",
    ),
    "The program itself": (
        "as_json",
        "quiet",
        "verbose",
        "seed",
        "workers",
        "uses_cache",
        "version",
        "_click_default_help",
    ),
}
"""Names of parameters, section by section; what is in none stands before them all."""


class SectionedCommand(click.Command):
    """A command whose options are listed in sections."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options."""
        _write_sections(self, ctx, formatter)


class SectionedGroup(click.Group):
    """A group with options of its own, listed in sections, and commands."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write commands first: whoever looks for one need not pass by the options."""
        self.format_commands(ctx, formatter)
        _write_sections(self, ctx, formatter)


def _write_sections(
    command: click.Command, ctx: click.Context, formatter: click.HelpFormatter
) -> None:
    section_of = {name: title for title, names in _SECTIONS.items() for name in names}
    sections: dict[str, list[tuple[str, str]]] = {"Options": [], **{key: [] for key in _SECTIONS}}
    for param in command.get_params(ctx):
        record = param.get_help_record(ctx)
        if record is not None:
            sections[section_of.get(str(param.name), "Options")].append(record)
    for title, records in sections.items():
        if records:
            with formatter.section(title):
                formatter.write_dl(records)
