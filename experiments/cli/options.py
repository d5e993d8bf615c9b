"""Options: those of a question, made from its fields, and those that several commands share."""

import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem
from msgspec import Meta

from geometry.errors import InputError
from geometry.files import load_data
from placement.compute import RAYS, Compute
from placement.question import (
    BASELINE_NAME,
    Question,
    QuestionField,
    load_question_values,
    question_fields,
    save_question,
)

from ..language import LANGUAGES, speaking
from .running import Call, Job, cache_folder, check_address_space

_TABLES = load_data("experiments", "options.toml")
SECTIONS = ASKED, MOUNTED, SOUGHT, DRIVEN, SEEN = tuple(_TABLES["question"])
"""Titles in the help."""
OPTIONS = {
    name: {"section": section, "is_common": False} | settings
    for section, of_section in _TABLES["question"].items()
    for name, settings in of_section.items()
}
"""How each field of a question is shown, in the fields' order."""
EXAMPLES = {name: f"\b\n{text}" for name, text in _TABLES["examples"].items()}
"""What stands below the help of a command, as it is."""


def option_of(field: QuestionField) -> str:
    """The option of a field, such as "--site-cost"."""
    return "--" + field.key.replace("_", "-")


def help_of(field: QuestionField) -> str:
    """A field's description with options in place of the other fields' names."""
    known = question_fields()

    def named(found: re.Match[str]) -> str:
        return option_of(known[found[1]]) if found[1] in known else found[0]

    return re.sub("`([a-z_0-9]+)`", named, field.description)


PROGRAM = "The program itself"
Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]
_WHOLE_NUMBER = re.compile("-?[0-9]{1,100}")


class WordedOption(click.Option):
    """An option that stands in a section of the help, and words errors as this project does.

    The `section` is a title in the help; empty: a command's own options, which stand before all
    sections. The short help shows only `is_common` ones. `expected` is what a value must be, for
    the message about another one; a number `takes_infinity` as "inf", or a `word`. Without the
    parameter that it `needs`, or beside the one that it `excludes`, the option is refused.
    """

    def __init__(
        self,
        *args: Any,
        section: str = "",
        is_common: bool = True,
        expected: str = "",
        is_path: bool = False,
        takes_infinity: bool = False,
        word: str = "",
        needs: str = "",
        excludes: str = "",
        **kwargs: Any,
    ) -> None:
        if is_path:
            kwargs["shell_complete"] = complete_paths
        super().__init__(*args, **kwargs)
        self.takes_infinity, self.word = takes_infinity, word
        self.needs, self.excludes = needs, excludes
        self.section, self.is_common, self.expected = section, is_common, expected
        if isinstance(self.type, click.Choice):
            self.expected = "one of " + ", ".join(map(str, self.type.choices))

    def handle_parse_result(
        self, ctx: click.Context, opts: Mapping[str, Any], args: list[str]
    ) -> tuple[Any, list[str]]:
        """The value; refused if it is empty, or has no effect among the other options."""
        raw, source = self.consume_value(ctx, opts)
        if source is ParameterSource.COMMANDLINE:
            me = option_name(self)
            if raw == "" and not self.expected:  # else what is expected is said
                raise click.UsageError(f"{me}: got nothing; expected a value, or no {me}")
            related = [one for one in ctx.command.params if one.name in (self.needs, self.excludes)]
            for other in related:
                found, of_other = other.consume_value(ctx, opts)
                is_set = of_other is not ParameterSource.DEFAULT and bool(found)
                is_set &= found not in ("0", other.default)
                if is_set != (other.name == self.needs):
                    got, wanted = ("beside", "one of them") if is_set else ("without", "both")
                    other_name = option_name(other)
                    raise click.UsageError(f"{me}: got it {got} {other_name}; expected {wanted}")
        return super().handle_parse_result(ctx, opts, args)

    def type_cast_value(self, ctx: click.Context, value: Any) -> Any:
        """The value, checked by its type."""
        if self.word and value == self.word:
            return value
        try:
            typed = super().type_cast_value(ctx, value)
        except click.BadParameter:
            if not self.expected:
                raise
            raise InputError(option_name(self), value, self.expected) from None
        # Python also reads 1_0, other scripts' digits and spaces as numbers, and NaN as a float.
        is_odd = isinstance(value, str) and (
            not (math.isfinite(typed) or (self.takes_infinity and value == "inf"))
            if isinstance(typed, float)
            else isinstance(typed, int) and not _WHOLE_NUMBER.fullmatch(value)
        )
        if self.expected and is_odd:
            raise InputError(option_name(self), value, self.expected)
        return typed

    def get_help_extra(self, ctx: click.Context) -> Any:
        """Text in brackets in the help: the default, but no range."""
        extra = super().get_help_extra(ctx)
        extra.pop("range", None)
        return extra


def option(*names: str, **settings: Any) -> Decorator:
    """``click.option`` with what :class:`WordedOption` takes."""
    return click.option(*names, cls=WordedOption, **settings)


def option_name(param: click.Parameter) -> str:
    """The long name of an option."""
    return max(param.opts, key=len)


def is_given(name: str) -> bool:
    """A parameter of the running command stands on the command line."""
    source = click.get_current_context().get_parameter_source(name)
    return source is ParameterSource.COMMANDLINE


def complete_paths(
    context: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Leaves it to the shell to complete a path; the study's layout goes by its name."""
    takes_layouts = incomplete and param.name in ("layout_names", "keep", "within")
    if takes_layouts and BASELINE_NAME.startswith(incomplete):
        return [CompletionItem(BASELINE_NAME)]
    return [CompletionItem(incomplete, type="file")]


def combined(*options: Decorator) -> Decorator:
    """All of these options, so that the help shows them in this order."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for add in reversed(options):
            command = add(command)
        return command

    return decorate


_PATHS = {"file": {}, "folder": {"file_okay": False}, "regular file": {"dir_okay": False}}


def table_options(command: str, **more: dict[str, Any]) -> dict[str, Decorator]:
    """Options of a command by parameter, as ``data/options.toml`` has them, or `more` of each."""
    return {
        name: _table_option(name, settings | more.get(name, {}))
        for name, settings in _TABLES[command].items()
    }


def from_table(command: str, **more: dict[str, Any]) -> Decorator:
    """All of :func:`table_options`."""
    return combined(*table_options(command, **more).values())


def _table_option(parameter: str, settings: dict[str, Any]) -> Decorator:
    names = settings.pop("option", "--" + parameter.replace("_", "-"))
    kind = settings.pop("type", None)
    least, above, most = (settings.pop(key, None) for key in ("min", "above", "max"))
    if isinstance(kind, list | tuple):
        kind = click.Choice(kind)
    elif kind == "int":
        kind = click.IntRange(min=least, max=most)
        settings = {"metavar": "N"} | settings
    elif kind == "float":
        low = least if above is None else above
        is_ranged = low is not None or most is not None
        kind = click.FloatRange(low, most, min_open=above is not None) if is_ranged else float
    elif kind in _PATHS:
        kind = click.Path(path_type=Path, **_PATHS[kind])
    settings = {"show_default": bool(settings.get("default"))} | settings
    return option(*([names] if isinstance(names, str) else names), parameter, type=kind, **settings)


def fields_in(*sections: str, but: Sequence[str] = ()) -> tuple[str, ...]:
    """Names of a question's fields in these sections of the help, without some of them."""
    return tuple(
        name for name, shown in OPTIONS.items() if shown["section"] in sections and name not in but
    )


OF_SCENE = ("scene", "junction", "at", "sites", "driving_side")
"""Fields that say which junction it is."""
PLANNED = (*fields_in(ASKED, MOUNTED, SOUGHT), "fusion")
"""Fields of commands that look for layouts."""
JUDGED = fields_in(DRIVEN, SEEN, but=("fusion",))
"""Fields of commands that evaluate layouts."""
_JUDGING = (
    *("fusion", "weights", "near", "accidents_within_m", "score"),
    *("vut_sensors", "cars", "packet_loss", "vam_rate"),
)
PICTURED = fields_in(DRIVEN, SEEN, but=(*_JUDGING, "track_memory_s"))
"""Fields of commands that draw what each unit sees, whoever judges it."""
ONLY_DRIVEN = fields_in(DRIVEN, SEEN, but=(*_JUDGING, "detector"))
"""Fields of commands that show what is driven and judge nothing."""


def field_option(field: QuestionField, default: Any = None) -> Decorator:
    """The option of a field of a question; `default` in place of the field's own."""
    default = field.default if default is None else default
    kind, *limits = get_args(field.kind) if get_origin(field.kind) is Annotated else [field.kind]
    limit: Any = limits[0] if limits else Meta()
    name = option_of(field)
    settings: dict[str, Any] = {
        **OPTIONS[field.name],
        "option": f"{name}/--no-{name.removeprefix('--')}" if kind is bool else name,
        "default": default,
        "expected": limit.description or "",
        "help": help_of(field),
    }
    if get_origin(kind) is Literal:
        settings["type"] = get_args(kind)
    elif kind in (int, float):
        limits_of_kind = {"min": limit.ge, "above": limit.gt, "max": limit.le}
        words = {"type": kind.__name__, "metavar": "N" if kind is int else "SHARE"}
        settings = limits_of_kind | words | settings
    return _table_option(field.name, settings)


def question_options(
    *names: str,
    defaults: dict[str, Any] | None = None,
    named_apart: Sequence[str] = (),
    has_file: bool = True,
) -> Decorator:
    """Options of a command that asks something; the command gets them as one `question`.

    Fields that are not named keep their defaults, also where a question file gives them: one file
    serves every command. `defaults` are in place of the fields' own; parameters of the fields in
    `named_apart` are added by the command itself. `has_file`: with ``--question`` and ``--save-
    question``.
    """
    known = question_fields()
    options = [
        field_option(field, (defaults or {}).get(name))
        for name, field in known.items()
        if name in names
    ]
    if has_file:
        options += [_SHARED["question"], _SHARED["save_question_to"]]

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def with_question(*args: Any, save_question_to: Path | None = None, **values: Any) -> Any:
            question = Question(**{name: values.pop(name) for name in (*names, *named_apart)})
            _refuse_program_of_file(question)
            if save_question_to is not None:
                save_question(save_question_to, question)
            return command(*args, question=question, **values)

        return combined(*options)(with_question)

    return decorate


def _refuse_program_of_file(question: Question) -> None:
    """Refuse a network that only a question file names: it is a program, and files come by mail."""
    source = click.get_current_context().get_parameter_source("detector")
    if source is ParameterSource.DEFAULT_MAP and ".onnx" in question.detector:
        trusted = f"--detector {question.detector} as well if you trust it"
        expected = f"no network, which is a program, or {trusted}"
        raise InputError("--question: detector", question.detector, expected)


def one_run_options() -> Decorator:
    """The argument and options that name a run: the command gets `question` and `position`."""
    apart = ("cases", "approaches", "speeds")
    asked = [name for name in ONLY_DRIVEN if name not in (*apart, "along_arms")]
    return combined(
        click.argument("cases", metavar="CASE"),
        from_table("run"),
        question_options(*asked, named_apart=apart, has_file=False),
    )


def _read_question(context: click.Context, _param: click.Parameter, path: Path | None) -> None:
    """Let a question file give what the command line does not."""
    if path is not None:
        context.default_map = load_question_values(path)


def _show_traceback(context: click.Context, _param: click.Parameter, is_shown: bool) -> None:
    if is_shown:
        context.obj.shows_tracebacks = True


def _speak(context: click.Context, _param: click.Parameter, code: str | None) -> None:
    """Speak a language until the command ends; that of the group, where none is said."""
    if code is not None:
        context.with_resource(speaking(code))


_SHARED = table_options(
    "shared",
    verbose={"callback": lambda context, _, is_given: is_given and context.obj.tell_more()},
    debug={"callback": _show_traceback},
    language={"type": LANGUAGES, "callback": _speak},
    workers={"default": os.cpu_count() or 1},
    rays={"type": RAYS, "default": RAYS[0]},
    question={"callback": _read_question},
)
json_option = _SHARED["as_json"]
layout_option = _SHARED["layout_names"]
quiet_option = combined(_SHARED["quiet"], _SHARED["verbose"], _SHARED["debug"])
"""Options ``--quiet``, which the command gets, ``--verbose`` and ``--debug``."""
language_option = _SHARED["language"]


def compute_options(*, has_cache: bool = False) -> Decorator:
    """Options that say how to compute, as a `compute`; `has_cache`: it builds tables."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def with_compute(
            *args: Any, seed: int, workers: int, rays: str, uses_cache: bool = False, **values: Any
        ) -> Any:
            check_address_space()
            if rays != RAYS[0]:
                from geometry.raycast import caster_name

                caster_name(rays, where="--rays")
            compute = Compute(
                seed=seed,
                workers=workers,
                rays=rays,
                cache_folder=cache_folder() if uses_cache else None,
                progress=click.get_current_context().find_root().obj,
            )
            return command(*args, compute=compute, **values)

        names = ("seed", "workers", "rays", *(["uses_cache"] if has_cache else []))
        return combined(*(_SHARED[name] for name in names))(with_compute)

    return decorate


def calling(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options ``--json``, ``--quiet`` and so on: the command gets them as one `call`."""

    @wraps(command)
    def with_call(*, as_json: bool, quiet: bool, **values: Any) -> Any:
        progress = click.get_current_context().find_root().obj
        return command(Call(progress=progress, as_json=as_json, quiet=quiet), **values)

    return combined(json_option, quiet_option)(with_call)


def asking(
    *names: str, defaults: dict[str, Any] | None = None, has_cache: bool = True
) -> Decorator:
    """Options of a command that asks something and computes; it gets them as one `job`."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def with_job(**values: Any) -> Any:
            of_job = ("question", "compute", "as_json", "quiet")
            asked = {name: values.pop(name) for name in of_job}
            progress = click.get_current_context().find_root().obj
            return command(Job(progress=progress, **asked), **values)

        asked = question_options(*names, defaults=defaults)
        computing = compute_options(has_cache=has_cache)
        return combined(asked, language_option, json_option, quiet_option, computing)(with_job)

    return decorate


def folder_option(files: str) -> Decorator:
    """``--out``, a folder for some files, named in its help; nothing is written without it."""
    return option("--out", type=click.Path(path_type=Path), help=f"Folder for {files}; else none.")


scene_option = field_option(question_fields()["scene"])


def _show_all(context: click.Context, _param: click.Parameter, is_asked: bool) -> None:
    if is_asked:
        context.meta[_show_all.__qualname__] = True
        click.echo(context.get_help(), color=context.color)
        context.exit()


def _write_sections(
    command: click.Command, ctx: click.Context, formatter: click.HelpFormatter
) -> None:
    shows_all = ctx.meta.get(_show_all.__qualname__, False)
    sections: dict[str, list[tuple[str, str]]] = {title: [] for title in ("", *SECTIONS, PROGRAM)}
    for param in command.get_params(ctx):
        record = param.get_help_record(ctx) if isinstance(param, click.Option) else None
        if record is not None and (shows_all or getattr(param, "is_common", True)):
            sections[getattr(param, "section", PROGRAM)].append(record)
    for title, records in sections.items():
        if records:
            with formatter.section(title or "Options"):
                formatter.write_dl(records)


def _with_help_all(params: list[click.Parameter]) -> list[click.Parameter]:
    """Parameters and ``--help-all``, where there is more than the short help shows."""
    if all(getattr(param, "is_common", True) for param in params):
        return params
    help_all = WordedOption(
        ["--help-all"],
        is_flag=True,
        expose_value=False,
        is_eager=True,
        callback=_show_all,
        section=PROGRAM,
        help="Show this message with every option.",
    )
    return [*params, help_all]


class SectionedCommand(click.Command):
    """A command whose options are listed in sections, the common ones alone unless asked."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.params = _with_help_all(self.params)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options."""
        _write_sections(self, ctx, formatter)


class SectionedGroup(SectionedCommand, click.Group):
    """A group with options of its own, listed in sections, and commands."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write commands first: whoever looks for one need not pass by the options."""
        self.format_commands(ctx, formatter)
        _write_sections(self, ctx, formatter)


def with_option_names(message: str, group: click.Group) -> str:
    """Put the names of options in place of the fields that a message of the library names.

    A message names a field at its beginning, before a colon or "in", or anywhere between backticks:
    "budget: got 0; expected 1 or more, or `target`". Names that no option has stay as they are.
    """
    names = dict(_option_names(group))

    def name(found: re.Match[str]) -> str:
        return names.get(found[1], found[0])

    message = re.sub(r"`([a-z0-9_]+)`", name, message)
    return re.sub(r"\A([a-z0-9_]+)(?=:| in )", name, message)


def _option_names(command: click.Command) -> Iterator[tuple[str, str]]:
    """Names of parameters with those of their options, of a group after those of its commands."""
    for one in command.commands.values() if isinstance(command, click.Group) else ():
        yield from _option_names(one)
    for param in command.params:
        if isinstance(param, click.Option) and param.name is not None:
            yield param.name, option_name(param)
