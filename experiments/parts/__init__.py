"""Parts of an answer, one file each.

Its value, its words, its table, its figure.

A part looks like this; each has of it what it needs:

* its value, a frozen dataclass that is its own JSON, unless it is a value of
  `placement`;
* ``words(value) -> list[str]``: its sentences, the same on the terminal, in the report,
  on the
  planner's page and in JSON;
* ``table(value) -> Table``: its numbers, for terminal and report alike;
* ``plot_..(value) -> Axes``: its figure;
* ``section(value) -> Section | None``: words, table and figure as the report shows
  them; None where
  there is nothing to say.

A command is a list of parts: its terminal prints their words and tables, its report
their sections.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .section import Table


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A part of an answer, as a terminal prints it.

    Where the table is too wide and its last column is text, that stands below each row;
    else columns that do not fit stand in a further table below.
    """

    # Empty: none, and the sentences begin on the left.
    title: str = ""
    # A paragraph each.
    words: Sequence[str] = ()
    table: "Table | None" = None
    # Sentences below the table.
    notes: Sequence[str] = ()
    # Printed without ``--verbose``, too.
    is_short: bool = False

    def __bool__(self) -> bool:
        """There is something to print."""
        return bool(self.words or self.table or self.notes)
