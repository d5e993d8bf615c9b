"""Tables of verdicts, for other programs.

Ratios by group, and every run's outcome.
"""

import csv
import io
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources.abc import Traversable
from itertools import product
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray
from placement.evaluation import Evaluation, Verdict, apr
from scenarios.positions import sort_positions
from scenarios.runs import FrameAxis

from ..language import mark
from .numbers import finite_or_none

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

ALL = "all"
GROUP_COLUMNS = ("case", "approach", "position", "weather", "vut_speed_kmh")
"""Columns of apr.csv that say which runs; each a word of the run, or ALL."""
GroupedBy = Literal["case", "direction", "position", "speed", "weather"]
HEADS_OF_GROUPS: dict[GroupedBy, str] = {
    "case": mark("case"),
    "speed": mark("speed (km/h)"),
    "direction": mark("from"),
    "position": mark("at"),
}
"""Heads of the column that names the groups."""
RunGroup = tuple[str, BoolArray]
"""Its name, and which runs are in it: (n_runs,) bool."""
_BEGINNINGS = (*"=+-@", "\t", "\r", "\n")


def parties(evaluation: Evaluation) -> dict[str, Verdict]:
    """Every sensing party of an evaluation.

    "vut", each unit's id, "rsu_all" and so on.
    """
    return {
        "vut": evaluation.vut,
        **evaluation.units,
        "rsu_all": evaluation.rsu_all,
        "vut_and_rsus": evaluation.vut_and_rsus,
        **evaluation.others,
    }


def margin_s(verdict: Verdict, axis: FrameAxis) -> FloatArray:
    """Last brake time minus (confirmation + latency), per run.

    Parameters
    ----------
    verdict : Verdict
        Whose.
    axis : FrameAxis
        Runs.

    Returns
    -------
    margin_s : (n_runs,) float
        Negative: too late. Minus infinity: never confirmed, or no braking avoids. [s]
    """
    # At most one infinity of each sign: an onset is never -inf, so this is never NaN.
    margin: FloatArray = axis.last_brake_time_s - verdict.onset_time_s
    return margin


def apr_records(evaluations: Mapping[str, Evaluation]) -> list[dict[str, Any]]:
    """Accident prevention ratios of every party by groups of runs.

    By case, approach, position, weather and speed.

    Parameters
    ----------
    evaluations : mapping of str to Evaluation
        By the layout's display name.

    Returns
    -------
    records : list of dict
        Fields layout, party, case, approach, position, weather, vut_speed_kmh, apr,
        n_runs, n_avoided. "all" stands for every case, approach, position, weather or
        speed; a single position, weather or speed has no records of its own. Speeds are
        told of all approaches, positions and weathers together, positions of all
        weathers and speeds, either of all approaches or of all cases together. The
        ratio is None where none of the runs has weight.
    """
    records = []
    for name, evaluation in evaluations.items():
        groups = _run_groups(evaluation.axis)
        for party, verdict in parties(evaluation).items():
            for group, mask in groups:
                ratio = apr(verdict, evaluation.axis, mask)
                records.append(
                    {
                        "layout": name,
                        "party": party,
                        **group,
                        "apr": finite_or_none(ratio),
                        "n_runs": int(mask.sum()),
                        "n_avoided": int((verdict.is_avoided & mask).sum()),
                    }
                )
    return records


def runs_table(evaluations: Mapping[str, Evaluation]) -> "pa.Table":
    """Every run's outcome for every party.

    Parameters
    ----------
    evaluations : mapping of str to Evaluation
        By the layout's display name.

    Returns
    -------
    table : Table
        One row per layout, party and run. Times that do not exist (never confirmed, no
        braking avoids) are missing.
    """
    import pyarrow as pa

    return pa.concat_tables(
        _runs_of(name, party, verdict, evaluation.axis)
        for name, evaluation in evaluations.items()
        for party, verdict in parties(evaluation).items()
    )


def _runs_of(layout: str, party: str, verdict: Verdict, axis: FrameAxis) -> "pa.Table":
    """Every run's outcome for one party of a layout."""
    import pyarrow as pa

    n_frames = np.diff(axis.run_start)
    n_detected = np.add.reduceat(verdict.detected, axis.run_start[:-1])
    impact_speed_kmh = verdict.impact_speed_kmh
    if impact_speed_kmh is None:
        impact_speed_kmh = np.full(axis.n_runs, np.nan)
    columns: dict[str, Any] = {
        "layout": [layout] * axis.n_runs,
        "party": [party] * axis.n_runs,
        "run": axis.run_ids,
        "case": axis.cases,
        "approach": axis.approaches,
        "position": axis.positions,
        "weather": axis.weathers,
        "vut_speed_kmh": axis.vut_speed_kmh,
        "weight": axis.weight,
        "last_brake_time_s": axis.last_brake_time_s,
        "confirmation_time_s": verdict.confirmation_time_s,
        "margin_s": margin_s(verdict, axis),
        "is_avoided": verdict.is_avoided,
        "detected_share": n_detected / n_frames,
        "impact_speed_kmh": impact_speed_kmh,
    }
    arrays = [_column(values) for values in columns.values()]
    return pa.Table.from_arrays(arrays, names=[*columns])


def _column(values: Sequence[str] | FloatArray | BoolArray) -> "pa.Array":
    """Column of a table from texts or numbers (n,); what is not finite is missing.

    Built from its parts as Arrow lays them out, for ``pyarrow.array`` loads pandas,
    which takes longer than all of the table.
    """
    import pyarrow as pa

    n = len(values)
    if isinstance(values, np.ndarray):
        is_there = np.packbits(np.isfinite(values), bitorder="little")
        content: NDArray[Any]
        if values.dtype == bool:
            kind = pa.bool_()
            content = np.packbits(values.astype(bool), bitorder="little")
        else:
            kind = pa.float64()
            content = np.ascontiguousarray(values, dtype=np.float64)
        buffers = [pa.py_buffer(is_there), pa.py_buffer(content)]
        return pa.Array.from_buffers(kind, n, buffers)
    words = [value.encode() for value in values]
    lengths = [len(word) for word in words]
    ends = np.cumsum([0, *lengths], dtype=np.int32)
    buffers = [None, pa.py_buffer(ends), pa.py_buffer(b"".join(words))]
    return pa.Array.from_buffers(pa.string(), n, buffers)


def _run_groups(axis: FrameAxis) -> list[tuple[dict[str, str], BoolArray]]:
    """Groups of runs by their words, each with its runs; none is empty."""

    def several(what: GroupedBy) -> list[RunGroup]:
        groups = groups_by(axis, what)
        if len(groups) > 1:
            return groups
        return []

    every: list[RunGroup] = [(ALL, np.ones(axis.n_runs, dtype=bool))]
    cases = [*every, *groups_by(axis, "case")]
    arms = groups_by(axis, "direction")
    positions = several("position")
    weathers = several("weather")
    speeds = several("speed")
    wanted = [
        *product(cases, [*every, *arms], every, [*every, *weathers], every),
        *product(cases, every, every, every, speeds),
        *product(cases, every, positions, every, every),
        *product(every, arms, positions, every, every),
    ]
    groups = []
    for parts in wanted:
        mask: BoolArray = np.logical_and.reduce([runs for _, runs in parts])
        if mask.any():
            words = (word for word, _ in parts)
            groups.append((dict(zip(GROUP_COLUMNS, words, strict=True)), mask))
    return groups


def groups_by(axis: FrameAxis, what: GroupedBy) -> list[RunGroup]:
    """A group per case, direction or weather as they appear.

    Per position or speed, ascending.
    """
    speeds = [f"{speed:g}" for speed in axis.vut_speed_kmh]
    ascending = [f"{speed:g}" for speed in np.unique(axis.vut_speed_kmh)]
    words, order = {
        "case": (axis.cases, axis.cases),
        "direction": (axis.approaches, axis.approaches),
        "position": (axis.positions, sort_positions(axis.positions)),
        "speed": (speeds, ascending),
        "weather": (axis.weathers, axis.weathers),
    }[what]
    return [(word, np.array(words) == word) for word in dict.fromkeys(order)]


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table in Markdown."""
    lines = ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows)]


def page_of(template: Traversable, **values: Any) -> str:
    """A text of a Jinja template.

    Its filter `table` makes Markdown of rows, with their heads.
    """
    from jinja2 import Environment, StrictUndefined

    page = Environment(
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    page.filters["table"] = lambda rows, *header: "\n".join(
        markdown_table(header, rows)
    )
    return page.from_string(template.read_text(encoding="utf-8")).render(values)


def csv_text(table: "pd.DataFrame") -> str:
    """A table as CSV, every text in it safe to open in a spreadsheet."""
    text: str = table.map(safe_cell).to_csv(index=False, lineterminator="\n")
    return text


def records_csv(
    records: Sequence[Mapping[str, Any]], columns: Sequence[str] = ()
) -> str:
    """Records as the CSV that :func:`csv_text` writes of their table, without pandas.

    `columns` come first, those that further records have follow. A field that a record
    does not have, or that is None, is empty. Numbers are Python's own.
    """
    heads = dict.fromkeys(columns)
    for record in records:
        heads |= dict.fromkeys(record)
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(heads)
    for record in records:
        writer.writerow([safe_cell(record.get(head)) for head in heads])
    return buffer.getvalue()


def safe_cell(cell: Any) -> Any:
    """A cell that no spreadsheet takes for a formula.

    Behind an apostrophe if it would be taken for one, else as it is.

    Examples
    --------
    >>> safe_cell("=SUM(A1)"), safe_cell("-3.5"), safe_cell("north")
    ("'=SUM(A1)", '-3.5', 'north')
    """
    if _is_like_formula(cell):
        return f"'{cell}"
    return cell


def plain_cell(cell: Any) -> Any:
    """The cell that :func:`safe_cell` was given."""
    is_safe = (
        isinstance(cell, str) and cell.startswith("'") and _is_like_formula(cell[1:])
    )
    if is_safe:
        return cell[1:]
    return cell


def _is_like_formula(cell: Any) -> bool:
    """A text begins as formulas do.

    Also one that has such an apostrophe already.
    """
    if not isinstance(cell, str) or len(cell) == 1:
        return False
    # Also as wide as in Japanese.
    first = unicodedata.normalize("NFKC", cell.lstrip("'")[:1])
    if not first.startswith(_BEGINNINGS):
        return False
    try:
        float(cell)
    except ValueError:
        return True
    return False
