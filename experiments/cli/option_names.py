"""Option names in messages of the library, which knows the names of fields and arguments alone."""

import re
from collections.abc import Iterator

import click


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


def _option_names(group: click.Group) -> Iterator[tuple[str, str]]:
    """Names of parameters with those of their options, of a group after those of its commands."""
    for command in group.commands.values():
        if isinstance(command, click.Group):
            yield from _option_names(command)
        else:
            yield from _names_of(command)
    yield from _names_of(group)


def _names_of(command: click.Command) -> Iterator[tuple[str, str]]:
    for param in command.params:
        if isinstance(param, click.Option) and param.name is not None:
            yield param.name, max(param.opts, key=len)
