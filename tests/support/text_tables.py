"""Tables of tests written as text: a row for each line, cells between bars."""

import ast
import math

NUMBERS = {"inf": math.inf, "nan": math.nan}


class _NamedNumbers(ast.NodeTransformer):
    """Puts numbers in the place of their names."""

    def visit_Name(self, node):
        return ast.Constant(NUMBERS[node.id])


def rows_of(text, *, n_texts=None):
    """Rows of a table, for parametrize: a tuple each.

    A line that is indented farther than the first one goes on with the row before. What
    follows a # at the begin of a line, or two spaces and a #, is a comment.

    Parameters
    ----------
    text : str
        Lines such as "highway=street_lamp | lamp post".
    n_texts : int, optional
        So many cells of a row are texts, by default all; the others are values in
        Python's words, such as None, (1.0, 2.0) or inf.
    """
    lines = []
    first_indent = None
    for line in text.splitlines():
        told = line.partition("  # ")[0].strip()
        if not told or told.startswith("#"):
            continue
        indent = len(line) - len(line.lstrip())
        if first_indent is None:
            first_indent = indent
        if indent > first_indent:
            lines[-1] += f" {told}"
        else:
            lines.append(told)

    rows = []
    for line in lines:
        cells = [cell.strip() for cell in f" {line} ".split(" | ")]
        if n_texts is not None:
            cells[n_texts:] = map(value_of, cells[n_texts:])
        rows.append(tuple(cells))
    return rows


def value_of(text):
    """A value in Python's words."""
    tree = ast.parse(text, mode="eval")
    return ast.literal_eval(_NamedNumbers().visit(tree))


def changes_of(text):
    """Rows of fields to change and what is told then, for parametrize.

    Lines are such as "width_m=0.0, height_m=nan | expected metres, > 0".
    """
    rows = []
    for change, *told in rows_of(text):
        call = ast.parse(f"dict({change})", mode="eval").body
        fields = {}
        for keyword in call.keywords:
            fields[keyword.arg] = value_of(ast.unparse(keyword.value))
        rows.append((fields, *told))
    return rows
