"""CSV that people open in spreadsheets: a text that looks like a formula must not run as one.

Names come from scenes and layouts of anybody. Spreadsheets run a cell that begins with one of
``= + - @``, a tab or a line break; an apostrophe before it makes it text [1]_.

References
----------
.. [1] OWASP, "CSV Injection", https://owasp.org/www-community/attacks/CSV_Injection
"""

import unicodedata
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

_BEGINNINGS = (*"=+-@", "\t", "\r", "\n")


def csv_text(table: "pd.DataFrame") -> str:
    """A table as CSV, every text in it safe to open in a spreadsheet."""
    text: str = table.map(safe_cell).to_csv(index=False, lineterminator="\n")
    return text


def safe_cell(cell: Any) -> Any:
    """A cell as it is, or behind an apostrophe if a spreadsheet would take it for a formula.

    Examples
    --------
    >>> safe_cell("=SUM(A1)"), safe_cell("-3.5"), safe_cell("north")
    ("'=SUM(A1)", '-3.5', 'north')
    """
    return f"'{cell}" if _is_like_formula(cell) else cell


def plain_cell(cell: Any) -> Any:
    """The cell that :func:`safe_cell` was given."""
    is_safe = isinstance(cell, str) and cell.startswith("'") and _is_like_formula(cell[1:])
    return cell[1:] if is_safe else cell


def _is_like_formula(cell: Any) -> bool:
    """A text begins as formulas do; also one that has such an apostrophe already."""
    if not isinstance(cell, str) or len(cell) == 1:
        return False
    first = unicodedata.normalize("NFKC", cell.lstrip("'")[:1])  # also as wide as in Japanese
    if not first.startswith(_BEGINNINGS):
        return False
    try:
        float(cell)
    except ValueError:
        return True
    return False
