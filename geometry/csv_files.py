"""Rows of CSV as people write it."""

import csv
import io
import logging
import re
from collections.abc import Iterator
from pathlib import Path

from .errors import Faults, InputError, Unquoted, gathering, refuse
from .opening import read_bytes

_log = logging.getLogger(__name__)
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
# The line by which Excel is told how cells are separated.
_SEPARATOR_LINE = re.compile(r'"?sep=([^"\r\n])"?[ \t;,]*(?:\r?\n|$)', re.IGNORECASE)


def read_csv_text(path: Path) -> str:
    """Text of a CSV file: UTF-8, UTF-16 with its mark, or else Windows-1252.

    Excel of Western Europe writes Windows-1252, and "Unicode text" as UTF-16. What
    is not UTF-8 is logged.

    Raises
    ------
    InputError
        The file cannot be read, or is text of no such kind.
    """
    content = read_bytes(path)
    if content.startswith(_UTF16_MARKS):
        encodings = ["utf-16"]
    else:
        encodings = ["utf-8-sig", "cp1252"]
    problem: UnicodeDecodeError | None = None
    for encoding in encodings:
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError as error:
            problem = problem or error
            continue
        if encoding == "cp1252":
            # Every file of bytes would pass for Windows-1252.
            if "\0" in text:
                break
            _log.warning("%s: not UTF-8: read as Windows-1252", path)
        return text
    raise InputError(
        str(path), Unquoted(problem), "a CSV file in UTF-8 or Windows-1252"
    )


def csv_rows(
    text: str,
    where: str,
    *,
    separators: str = ",",
    noun: str = "fields",
    faults: Faults | None = None,
) -> Iterator[tuple[str, list[str]]]:
    """Rows of CSV without empty ones: file and line, and the cells.

    The header comes first. Spaces around cells are removed.

    The first line says which of the separators it is; Excel's line ``sep=;`` above
    the header says so, too, and is left out.

    Parameters
    ----------
    text : str
        Content of the file.
    where : str
        File, for messages.
    separators : str
        Characters that may stand between cells.
    noun : str
        What messages call the cells of a row.
    faults : Faults or None
        Takes what is wrong with a row, which is left out then; None: it is raised.

    Yields
    ------
    row : (str, list of str)
        File and line, and the cells.

    Raises
    ------
    InputError
        It is no CSV, or a row has other numbers of cells than the header.
    """
    told = _SEPARATOR_LINE.match(text)
    if told is not None:
        separator = told[1]
    else:
        # The separator that the header has most of.
        separator = max(separators, key=text.partition("\n")[0].count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    n_cells = 0
    try:
        if told is not None:
            next(reader)
        for row in reader:
            here = f"{where}: line {reader.line_num}"
            cells = [cell.strip() for cell in row]
            if not any(cells):
                continue
            n_cells = n_cells or len(cells)
            if len(cells) == n_cells:
                yield here, cells
                continue
            with gathering(faults):
                refuse(here, f"{len(cells)} {noun}", f"{n_cells}")
    except csv.Error as error:
        raise InputError(
            f"{where}: line {reader.line_num}", Unquoted(error), "a CSV file"
        ) from None
