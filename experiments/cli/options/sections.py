"""Commands whose help lists options in sections, the common ones alone unless asked."""

import re
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Any

import click

from geometry.registry import load_entry

from ..commands import CommandEntry
from .question import SECTIONS
from .worded import PROGRAM, WordedOption, option_name

_SHOWS_ALL = f"{__name__}.shows_all"
"""Key of a context's ``meta``: ``--help-all`` was given."""


class SectionedCommand(click.Command):
    """A command whose options are listed in sections.

    The short help shows the common ones alone; ``--help-all``, which the command gets
    where there are others, shows them all. It takes what click.Command takes.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        if not all(_is_common(param) for param in self.params):
            self.params = [*self.params, _help_all_option()]

    def format_options(
        self, ctx: click.Context, formatter: click.HelpFormatter
    ) -> None:
        """Write the options, section by section."""
        _write_sections(self, ctx, formatter)


class SectionedGroup(SectionedCommand, click.Group):
    """A group with options of its own, listed in sections, and commands.

    Commands of a registry are loaded when they run; the help of the group loads none.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._entries: dict[str, CommandEntry] = {}

    def add_entries(self, entries: Mapping[str, CommandEntry]) -> None:
        """Add commands by their names in a registry."""
        self._entries |= entries

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of all commands, loaded or not, in alphabetical order."""
        return sorted({*self._entries, *super().list_commands(ctx)})

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As click does; a name that there is not may be near that of any entry."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            # Click looks among commands that are loaded, if it looks at all.
            near = get_close_matches(args[0], self._entries)
            if near and "Did you mean" not in error.format_message():
                words = f"{error.format_message()} Did you mean {near[0]!r}?"
                raise click.UsageError(words, ctx) from None
            raise

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Load a command; None where there is none of that name."""
        entry = self._entries.get(cmd_name)
        if entry is not None and cmd_name not in self.commands:
            self.add_command(load_entry(entry.place), cmd_name)
        return super().get_command(ctx, cmd_name)

    def format_commands(
        self, ctx: click.Context, formatter: click.HelpFormatter
    ) -> None:
        """Write a line for each command, of its registry where it has one."""
        shown = {
            name: click.Command(name, help=entry.line)
            for name, entry in self._entries.items()
        }
        click.Group(commands={**shown, **self.commands}).format_commands(ctx, formatter)

    def format_options(
        self, ctx: click.Context, formatter: click.HelpFormatter
    ) -> None:
        """Write commands first: whoever looks for one need not pass by the options."""
        self.format_commands(ctx, formatter)
        _write_sections(self, ctx, formatter)


def _is_common(param: click.Parameter) -> bool:
    """True if the short help shows a parameter; click's own are shown always."""
    return getattr(param, "is_common", True)


def _help_all_option() -> WordedOption:
    """Option ``--help-all``, which shows every option and ends."""
    return WordedOption(
        ["--help-all"],
        is_flag=True,
        expose_value=False,
        is_eager=True,
        callback=_show_all,
        section=PROGRAM,
        help="Show this message with every option.",
    )


def _show_all(context: click.Context, _param: click.Parameter, is_asked: bool) -> None:
    """Print the help with every option, and end."""
    if is_asked:
        context.meta[_SHOWS_ALL] = True
        click.echo(context.get_help(), color=context.color)
        context.exit()


def _write_sections(
    command: click.Command, ctx: click.Context, formatter: click.HelpFormatter
) -> None:
    """Write the options of a command: its own first, then section by section.

    Parameters
    ----------
    command : click.Command
        Has the options.
    ctx : click.Context
        Says whether all of them are wanted.
    formatter : click.HelpFormatter
        Gets the text.
    """
    shows_all = ctx.meta.get(_SHOWS_ALL, False)
    titles = ("", *SECTIONS, PROGRAM)
    sections: dict[str, list[tuple[str, str]]] = {title: [] for title in titles}
    for param in command.get_params(ctx):
        if not isinstance(param, click.Option):
            continue
        record = param.get_help_record(ctx)
        if record is not None and (shows_all or _is_common(param)):
            # Options of click itself, such as --help, are in no section of ours.
            title = getattr(param, "section", PROGRAM)
            sections[title].append(record)
    for title, records in sections.items():
        if records:
            with formatter.section(title or "Options"):
                formatter.write_dl(records)


def with_option_names(message: str, group: click.Group) -> str:
    """Put the names of options in place of the fields that a message of the library names.

    A message names a field at its beginning, before a colon or "in", or anywhere
    between backticks: "budget: got 0; expected 1 or more, or `target`".

    Parameters
    ----------
    message : str
        What the library says.
    group : click.Group
        Has the options; those of its commands, as far as they are loaded, count where
        it has none of that name.

    Returns
    -------
    str
        Names that no option has stay as they are.
    """
    names = dict(_option_names(group))

    def name(found: re.Match[str]) -> str:
        return names.get(found[1], found[0])

    message = re.sub(r"`([a-z0-9_]+)`", name, message)
    return re.sub(r"\A([a-z0-9_]+)(?=:| in )", name, message)


def _option_names(command: click.Command) -> Iterator[tuple[str, str]]:
    """Parameters and their options' names; a group's own come last, and so win."""
    if isinstance(command, click.Group):
        for inner in command.commands.values():
            yield from _option_names(inner)
    for param in command.params:
        if isinstance(param, click.Option) and param.name is not None:
            yield param.name, option_name(param)
