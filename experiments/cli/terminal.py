"""Text for a terminal: tables and sentences, without colours. Rich is loaded when it is needed."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from io import StringIO

WIDTH = 80
"""Columns of a terminal; nothing is wider."""
_HEAD_WIDTH, _WIDEST_WORD = 12, 20
_GAP = 2


def sentences(*texts: str, indent: int = 0, hanging: int = 0, head: str = "") -> list[str]:
    """Lines of paragraphs; an empty text gives none.

    Parameters
    ----------
    indent, hanging : int
        Spaces before every line, and so many more before all but the first.
    head : str
        Stands before each text, on its first line alone.
    """
    return [
        line
        for text in texts
        for line in textwrap.wrap(
            head + text,
            WIDTH,
            initial_indent=" " * indent,
            subsequent_indent=" " * (indent + hanging),
            break_on_hyphens=False,
        )
    ]


def table(
    heads: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    n_left: int = 1,
    indent: int = 2,
    widths: Sequence[int | None] | None = None,
) -> list[str]:
    """Lines of a table.

    Parameters
    ----------
    heads : sequence of str
        One per column.
    rows : iterable of sequence of str
        A cell per column.
    n_left : int
        Columns whose cells begin on the left; those of the others end on the right. A left one is
        made narrower, and its cells are cut, where the table would be too wide.
    indent : int
        Spaces before every line.
    widths : sequence of int or None, optional
        Of the columns; None: what the cells need.
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
        shown.add_row(*(Text(cell, overflow="ellipsis", no_wrap=True) for cell in row))
    output = StringIO()
    Console(file=output, width=WIDTH - indent, color_system=None).print(shown)
    lines = (line.rstrip() for line in output.getvalue().splitlines())
    return [(" " * indent + line).rstrip() for line in lines]


def wide_table(head: str, rows: Sequence[str], columns: Mapping[str, Sequence[str]]) -> list[str]:
    """Lines of a table with many columns: as many side by side as fit, the others below.

    Parameters
    ----------
    head : str
        Of the first column, which each block repeats.
    rows : sequence of str
        Cells of the first column.
    columns : mapping of str to sequence of str
        Cells by head; a head of several words stands on several lines.
    """
    first = max(map(len, (head, *rows)))
    widths = {name: _column_width(name, cells) for name, cells in columns.items()}
    blocks: list[list[str]] = [[]]
    left = WIDTH - 2 - first
    for name, width in widths.items():
        if width + _GAP > left and blocks[-1]:
            blocks.append([])
            left = WIDTH - 2 - first
        blocks[-1].append(name)
        left -= width + _GAP
    lines: list[str] = []
    for block in blocks:
        cells = zip(rows, *(columns[name] for name in block), strict=True)
        lines += [""] if lines else []
        lines += table([head, *block], cells, widths=[first, *(widths[name] for name in block)])
    return lines


def _column_width(head: str, cells: Sequence[str]) -> int:
    longest_word = max(map(len, head.split()), default=0)
    return max(
        *map(len, cells), min(longest_word, _WIDEST_WORD), min(len(head), _HEAD_WIDTH)
    )
