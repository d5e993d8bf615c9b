"""Text for a terminal.

Tables and sentences, without colours. Rich is loaded when it is needed.
"""

import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from io import StringIO
from typing import TYPE_CHECKING, Any

from ..language import tr, trn
from ..parts import Part
from ..results.numbers import cars_words

if TYPE_CHECKING:
    from ..parts.section import Table

WIDTH = 80
SCREEN = 100
"""Columns of a terminal, and of the screen that an answer fits on."""
_GAP = 2
_MOST_REASONS = 5
_HEAD_WIDTHS = (12, 10, 8)
_WIDEST_WORD = 20
_NUMBER_AND_UNIT = re.compile(
    r"(?<=\d) (?=(?:%|m|cm|s|ms|km/h|m/s|EUR|deg|degrees|px|Hz|runs?|points?|units?"
    r"|Grad|Läufen?|Lauf|Prozentpunkten?|Sensor(?:en)?)(?![\w/]))"
)


def sentences(
    *texts: str, indent: int = 0, hanging: int = 0, head: str = "", width: int = WIDTH
) -> list[str]:
    """Lines of paragraphs; an empty text gives none.

    `indent` spaces stand before every line, and `hanging` more before all but the
    first; `head` stands before each text, on its first line alone.
    """
    return [
        line.replace("\N{NO-BREAK SPACE}", " ")
        for text in texts
        for line in textwrap.wrap(
            _NUMBER_AND_UNIT.sub("\N{NO-BREAK SPACE}", head + text),
            width,
            initial_indent=" " * indent,
            subsequent_indent=" " * (indent + hanging),
            break_on_hyphens=False,
        )
    ]


def answer_text(parts: Iterable[Part], *, is_verbose: bool) -> str:
    """An answer on a screen of 100 columns.

    With `is_verbose` all of it, 80 columns wide.
    """
    width = WIDTH if is_verbose else SCREEN
    lines: list[str] = []
    was_plain = True
    for part in parts:
        if part and (is_verbose or part.is_short):
            is_plain = not (part.title or part.table)
            # It belongs to what stands above.
            is_note = is_plain and not part.words
            belongs_above = is_note or (is_plain and was_plain)
            if lines and not belongs_above:
                lines.append("")
            lines += _part_lines(part, width)
            was_plain = is_plain and not part.notes
    return "\n".join(lines)


def _part_lines(part: Part, width: int) -> list[str]:
    indent = 2 if part.title else 0
    return [
        *sentences(part.title, width=width),
        *sentences(*part.words, indent=indent, hanging=indent, width=width),
        *([] if part.table is None else _table_lines(part.table, width)),
        *sentences(*part.notes, indent=2, hanging=2, width=width),
    ]


def _table_lines(shown: "Table", width: int) -> list[str]:
    """A table of a part: as it is where it fits."""
    heads = list(shown.columns)
    rows = [[str(cell) for cell in row] for row in shown.rows]
    cells = zip(heads, *rows, strict=True)
    needed = sum(_GAP + max(map(len, column)) for column in cells)
    has_text = len(heads) > 1 and len(heads) - 1 not in shown.numeric
    if has_text:
        last = [row.pop() for row in (heads, *rows)]
        if needed > width:
            below = [f"{last[0]} {text}" if text else "" for text in last[1:]]
            return listing(heads, rows, below, width=width)
        lines = zip(listing(heads, rows, width=width), last, strict=True)
        return [f"{line}  {text}".rstrip() for line, text in lines]
    if needed <= width:
        return table(heads, rows, width=width)
    columns = {
        head: [row[index] for row in rows] for index, head in enumerate(heads) if index
    }
    return wide_table(heads[0], [row[0] for row in rows], columns, width=width)


def basis(result: Any) -> dict[str, Any]:
    """What a result rests on, as titles put it in."""
    return {
        "runs": result.runs,
        "fusion": tr(result.fusion),
        "cars": cars_words(result.cars),
    }


def first_reasons(driven: Sequence[str]) -> list[str]:
    """Reasons why most of the other possible runs are not driven.

    The last one says how many reasons are not printed.
    """
    n_left = len(driven) - 1 - _MOST_REASONS
    if n_left > 0:
        more = [
            trn(
                "and {n} more reason in the report's list",
                "and {n} more reasons in the report's list",
                n_left,
            )
        ]
    else:
        more = []
    return [*driven[1 : 1 + _MOST_REASONS], *more]


def table(
    heads: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    n_left: int = 1,
    indent: int = 2,
    widths: Sequence[int | None] | None = None,
    width: int = WIDTH,
) -> list[str]:
    """Lines of a table.

    The cells of the first `n_left` columns begin on the left; those of the others end
    on the right. A left one is made narrower, and its cells go on below, where the
    table would be too wide. `widths` of columns are by default what the cells need.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    shown = Table(box=None, padding=(0, _GAP, 0, 0), pad_edge=False)
    for index, head in enumerate(heads):
        is_left = index < n_left
        shown.add_column(
            Text(head, overflow="fold"),
            justify="left" if is_left else "right",
            width=None if widths is None else widths[index],
            no_wrap=widths is None and not is_left,
        )
    for row in rows:
        cells = enumerate(row)
        shown.add_row(
            *(Text(cell, overflow="fold", no_wrap=n >= n_left) for n, cell in cells)
        )
    output = StringIO()
    Console(file=output, width=width - indent, color_system=None).print(shown)
    lines = (line.rstrip() for line in output.getvalue().splitlines())
    return [(" " * indent + line).rstrip() for line in lines]


def listing(
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    below: Sequence[str] = (),
    *,
    width: int = WIDTH,
) -> list[str]:
    """A table without cuts.

    A long id has its own line, and `below` stand texts under the rows.
    """
    longest, *widths = (
        max(map(len, cells)) for cells in zip(heads, *rows, strict=True)
    )
    first = min(longest, width - 2 - sum(widths) - 2 * len(widths))

    def line(head: str, cells: Sequence[str]) -> str:
        ends = (f"  {cell:>{wide}}" for cell, wide in zip(cells, widths, strict=True))
        return f"  {head:<{first}}{''.join(ends)}".rstrip()

    lines = [line(heads[0], heads[1:])]
    for index, row in enumerate(rows):
        is_long = len(row[0]) > first
        if is_long:
            lines += [f"  {row[0]}"]
        lines.append(line("" if is_long else row[0], row[1:]))
        if below and below[index]:
            lines += sentences(below[index], indent=4, width=width)
    return lines


def wide_table(
    head: str,
    rows: Sequence[str],
    columns: Mapping[str, Sequence[str]],
    *,
    width: int = WIDTH,
) -> list[str]:
    """Lines of a table with many columns.

    As many side by side as fit, the others below.

    Each block repeats the first column, with `head` and `rows`. A head of several words
    stands on several lines.
    """
    first = max(map(len, (head, *rows)))
    # The widest columns among those that need the fewest blocks.
    blocks = min(
        (_in_blocks(columns, first, widest, width) for widest in _HEAD_WIDTHS), key=len
    )
    lines: list[str] = []
    for widths in blocks:
        cells = zip(rows, *(columns[name] for name in widths), strict=True)
        if lines:
            lines += [""]
        lines += table(
            [head, *widths], cells, widths=[first, *widths.values()], width=width
        )
    return lines


def _in_blocks(
    columns: Mapping[str, Sequence[str]], first: int, widest: int, most: int
) -> list[dict[str, int]]:
    """Widths of columns that fit side by side, by block.

    Heads are at most so wide, words 20.
    """
    blocks: list[dict[str, int]] = []
    left = 0
    for head, cells in columns.items():
        longest_word = max(map(len, head.split()), default=0)
        width = max(
            *map(len, cells), min(longest_word, _WIDEST_WORD), min(len(head), widest)
        )
        if width + _GAP > left:
            blocks.append({})
            left = most - 2 - first
        blocks[-1][head] = width
        left -= width + _GAP
    return blocks
