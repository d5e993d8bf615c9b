"""``click.option`` with this project's wording of errors, and sections of the help."""

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

from geometry.errors import InputError
from placement.question import BASELINE_NAME

PROGRAM = "The program itself"
"""Title of the section of options that every command has."""

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]
"""What adds an option, or several, to a function that becomes a command."""

_WHOLE_NUMBER = re.compile("-?[0-9]{1,100}")
_TAKES_LAYOUTS = ("layout_names", "keep", "within")


class WordedOption(click.Option):
    """An option that stands in a section of the help, and words errors as this project does.

    Parameters
    ----------
    section : str
        Title in the help. Empty: a command's own option, listed before all sections.
    is_common : bool
        The short help shows it; else ``--help-all`` alone does.
    expected : str
        What a value must be, for the message about one that is not.
    is_path : bool
        The shell completes paths.
    takes_infinity : bool
        The number may be "inf".
    word : str
        A word that may stand in place of the number.
    needs, excludes : str
        Parameter without which, or beside which, the option is refused.
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
        # What is a path is not seen from the type: it may also be a name.
        if is_path:
            kwargs["shell_complete"] = complete_paths
        super().__init__(*args, **kwargs)
        self.section = section
        self.is_common = is_common
        self.expected = expected
        self.takes_infinity = takes_infinity
        self.word = word
        self.needs = needs
        self.excludes = excludes
        # A list of words is what is expected.
        if isinstance(self.type, click.Choice):
            self.expected = "one of " + ", ".join(map(str, self.type.choices))

    def handle_parse_result(
        self, ctx: click.Context, opts: Mapping[str, Any], args: list[str]
    ) -> tuple[Any, list[str]]:
        """Value of the option, and the arguments that are left.

        Raises click.UsageError if the value is empty, or the option has no effect among
        the other options.
        """
        value, source = self.consume_value(ctx, opts)
        if source is ParameterSource.COMMANDLINE:
            self._check_not_empty(value)
            for other in ctx.command.params:
                if other.name in (self.needs, self.excludes):
                    self._check_beside(other, ctx, opts)
        return super().handle_parse_result(ctx, opts, args)

    def _check_not_empty(self, value: Any) -> None:
        """Raise click.UsageError for an empty value; `expected`, if any, words it later."""
        if value == "" and not self.expected:
            me = option_name(self)
            raise click.UsageError(f"{me}: got nothing; expected a value, or no {me}")

    def _check_beside(
        self, other: click.Parameter, ctx: click.Context, opts: Mapping[str, Any]
    ) -> None:
        """Raise click.UsageError unless a needed option is set, and an excluded one is not."""
        value, source = other.consume_value(ctx, opts)
        # "0" is what texts say for "none of that", such as --survive 0.
        is_default = source is ParameterSource.DEFAULT or value in ("0", other.default)
        is_set = bool(value) and not is_default
        is_needed = other.name == self.needs
        if is_set == is_needed:
            return
        if is_needed:
            got = "without"
            expected = "both"
        else:
            got = "beside"
            expected = "one of them"
        me = option_name(self)
        raise click.UsageError(
            f"{me}: got it {got} {option_name(other)}; expected {expected}"
        )

    def type_cast_value(self, ctx: click.Context, value: Any) -> Any:
        """Value in the option's type. Raises InputError if it is not what is expected."""
        if self.word and value == self.word:
            return value
        try:
            typed = super().type_cast_value(ctx, value)
        except click.BadParameter:
            if not self.expected:
                raise
            raise InputError(option_name(self), value, self.expected) from None
        if (
            self.expected
            and isinstance(value, str)
            and not self._is_plain(value, typed)
        ):
            raise InputError(option_name(self), value, self.expected)
        return typed

    def _is_plain(self, text: str, typed: Any) -> bool:
        """True unless Python alone would read the text as such a number.

        It also reads 1_0, other scripts' digits and spaces as whole numbers, and NaN as
        a float.
        """
        if isinstance(typed, float):
            is_infinity = self.takes_infinity and text == "inf"
            return is_infinity or math.isfinite(typed)
        if isinstance(typed, int):
            return _WHOLE_NUMBER.fullmatch(text) is not None
        return True

    def get_help_extra(self, ctx: click.Context) -> Any:
        """Text in brackets in the help: the default, but no range."""
        extra = super().get_help_extra(ctx)
        extra.pop("range", None)
        return extra


def option(*names: str, **settings: Any) -> Decorator:
    """``click.option`` with what :class:`WordedOption` takes.

    Parameters
    ----------
    *names : str
        The option, such as "--max", and the parameter where that is called otherwise.
    **settings
        As ``click.option`` and :class:`WordedOption` take them. The help shows a
        default that is not nothing, such as 8 but not "", unless `show_default` says
        otherwise.
    """
    settings.setdefault("show_default", bool(settings.get("default")))
    return click.option(*names, cls=WordedOption, **settings)


def option_name(param: click.Parameter) -> str:
    """Long name of an option, such as "--out"."""
    return max(param.opts, key=len)


def is_given(name: str) -> bool:
    """True if a parameter of the running command stands on the command line."""
    source = click.get_current_context().get_parameter_source(name)
    return source is ParameterSource.COMMANDLINE


def complete_paths(
    context: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Leave it to the shell to complete a path; the study's layout goes by its name.

    Parameters
    ----------
    context, param
        As click gives them.
    incomplete : str
        What is typed so far.
    """
    is_layout = param.name in _TAKES_LAYOUTS
    if is_layout and incomplete and BASELINE_NAME.startswith(incomplete):
        return [CompletionItem(BASELINE_NAME)]
    return [CompletionItem(incomplete, type="file")]


def combined(*options: Decorator) -> Decorator:
    """All of these options, so that the help shows them in this order.

    Parameters
    ----------
    *options : Decorator
        Options, or what adds several of them.

    Returns
    -------
    Decorator
        The same as these decorators below one another.
    """

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for add in reversed(options):
            command = add(command)
        return command

    return decorate
