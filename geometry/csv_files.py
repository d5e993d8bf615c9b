"""Rows of CSV as people write it."""

import csv
import io
from collections.abc import Iterator

from .errors import InputError, Unquoted, refuse


def csv_rows(
    text: str, where: str, *, separators: str = ",", noun: str = "fields"
) -> Iterator[tuple[str, list[str]]]:
    """Rows of CSV without empty ones: file and line, and the cells.

    The header comes first. Spaces around cells are removed.

    The first line says which of the separators it is.

    Raises
    ------
    InputError
        It is no CSV, or a row has other numbers of cells than the header;
        `noun` is what the message calls these.
    """
    # The separator that the header has most of.
    separator = max(separators, key=text.partition("\n")[0].count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    n_cells = 0
    try:
        for row in reader:
            here = f"{where}: line {reader.line_num}"
            cells = [cell.strip() for cell in row]
            if not any(cells):
                continue
            n_cells = n_cells or len(cells)
            if len(cells) != n_cells:
                refuse(here, f"{len(cells)} {noun}", f"{n_cells}")
            yield here, cells
    except csv.Error as error:
        raise InputError(
            f"{where}: line {reader.line_num}", Unquoted(error), "a CSV file"
        ) from None
