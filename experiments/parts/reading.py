"""A folder of results read back.

Summary, layout, and the tables of runs and of ratios.

Files are checked to be whole, of this version, and to belong together.
"""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from pandas.api.types import is_bool_dtype, is_numeric_dtype, is_string_dtype

from geometry.errors import InputError, Unquoted
from geometry.opening import MAX_TEXT_BYTES, read_bytes
from geometry.parquet_files import open_parquet
from geometry.tables import read_table
from geometry.text_formats import parse_json
from placement.layout import Layout, load_layout

from ..results.folders import APR_FILE, LAYOUT_FILE, MARKER, RUNS_FILE
from ..results.tables import plain_cell
from .result import KINDS, Result

_KINDS = {
    "text": is_string_dtype,
    "numbers": is_numeric_dtype,
    "true or false": is_bool_dtype,
}
_RUNS_COLUMNS = {
    **dict.fromkeys(
        ("layout", "party", "run", "case", "approach", "position", "weather"), "text"
    ),
    **dict.fromkeys(("vut_speed_kmh", "weight", "last_brake_time_s"), "numbers"),
    **dict.fromkeys(("confirmation_time_s", "margin_s"), "numbers"),
    "is_avoided": "true or false",
    "detected_share": "numbers",
    "impact_speed_kmh": "numbers",
}
_APR_COLUMNS = {
    **dict.fromkeys(
        ("layout", "party", "case", "approach", "position", "weather"), "text"
    ),
    # A speed, or "all".
    "vut_speed_kmh": "text",
    **dict.fromkeys(("apr", "n_runs", "n_avoided"), "numbers"),
}
_OLDER = "place-rsus/result/"
_A_WHOLE = "a whole file, as place-rsus has written it"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StoredResult:
    """What a placement, an evaluation or a comparison has written to a folder.

    Attributes
    ----------
    folder : Path
        Where it was read from.
    summary : Result
        The numbers of ``summary.json``.
    layout : Layout
        What was found or evaluated; of a comparison the first one.
    runs : DataFrame
        A row per layout, sensing party and run; see
        :func:`experiments.results.tables.runs_table`.
    apr : DataFrame
        A row per layout, sensing party and group of runs; see
        :func:`experiments.results.tables.apr_records`.
    """

    folder: Path
    summary: Result
    # Found or evaluated; of a comparison the first one.
    layout: Layout
    # A row per layout, sensing party and run.
    runs: pd.DataFrame
    # A row per layout, sensing party and group of runs.
    apr: pd.DataFrame

    def __repr__(self) -> str:
        return (
            f"Result({self.layout.name!r}, {self.summary.runs} runs,"
            f" {str(self.folder)!r})"
        )


def load_result(folder: Path | str) -> StoredResult:
    """Results from the folder that ``--out`` names.

    Parameters
    ----------
    folder : Path or str
        Written by a placement, an evaluation or a comparison.

    Returns
    -------
    result : StoredResult
        All of it, checked to be whole and to belong together.

    Raises
    ------
    InputError
        A file is missing, broken, of another version, or not of the same results as the
        others.

    Examples
    --------
    >>> result = load_result("results/latest")  # doctest: +SKIP
    >>> together = result.runs.query("party == 'rsu_all'")  # doctest: +SKIP
    >>> together[~together.is_avoided].groupby("case").size()  # doctest: +SKIP
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(str(folder), Unquoted("no folder"), "a folder of results")
    summary = read_summary(folder / MARKER)
    layout = load_layout(folder / LAYOUT_FILE)
    ids = [unit.id for unit in layout.units]
    expected = [unit.id for unit in summary.layout]
    if ids != expected:
        got = Unquoted(f"units {', '.join(ids)}")
        wanted = f"{', '.join(expected)}, those of {MARKER}"
        raise InputError(str(folder / LAYOUT_FILE), got, wanted)
    runs = _load_runs(folder / RUNS_FILE, summary)
    apr = _load_apr(folder / APR_FILE, runs)
    return StoredResult(
        folder=folder, summary=summary, layout=layout, runs=runs, apr=apr
    )


def read_summary(path: Path) -> Result:
    """A ``summary.json``; InputError if it is none of this version."""
    try:
        summary = parse_json(read_bytes(path), str(path), _A_WHOLE)
    except InputError as error:
        raise InputError(str(path), error.got, _A_WHOLE) from None
    if not isinstance(summary, dict):
        raise InputError(str(path), Unquoted("no object"), "an object with a schema")
    return read_table(summary, KINDS[check_schema(summary, str(path))], str(path))


def check_schema(summary: Mapping[str, object], where: str) -> str:
    """Kind and version of a summary, known to be one of today's.

    Else InputError names those.
    """
    schema = summary.get("schema", Unquoted("nothing"))
    if schema not in KINDS:
        if str(schema).startswith(_OLDER):
            older = ": an older version, make it anew"
        else:
            older = ""
        raise InputError(f"{where}: schema", schema, " or ".join(KINDS) + older)
    return str(schema)


def _load_runs(path: Path, summary: Result) -> pd.DataFrame:
    with open_parquet(path, max_bytes=MAX_TEXT_BYTES, expected=_A_WHOLE) as file:
        # What pandas notes in the file about itself is not needed, and may be broken,
        # too.
        runs: pd.DataFrame = file.read().to_pandas(ignore_metadata=True)
    is_text = runs.dtypes == "category"
    runs = runs.astype(dict.fromkeys(runs.columns[is_text], object))
    _check_columns(runs, _RUNS_COLUMNS, path)
    if summary.name not in set(runs["layout"]):
        got = Unquoted(f"no run of {summary.name}")
        raise InputError(f"{path}: layout", got, f"those of {MARKER}")
    n_runs = summary.runs
    names = set(runs["run"])
    for (layout, party), of_party in runs.groupby(["layout", "party"], sort=False):
        if (
            len(of_party) != n_runs
            or set(of_party["run"]) != names
            or len(names) != n_runs
        ):
            got = Unquoted(f"{of_party['run'].nunique()} runs of {layout}, {party}")
            raise InputError(
                str(path), got, f"each of the {n_runs} runs of {MARKER} once"
            )
    return runs


def _load_apr(path: Path, runs: pd.DataFrame) -> pd.DataFrame:
    data = read_bytes(path)
    if not data.endswith(b"\n"):
        raise InputError(str(path), Unquoted("no line break at the end"), _A_WHOLE)
    text = [name for name, kind in _APR_COLUMNS.items() if kind == "text"]
    try:
        # Layouts may be called "nan" or "12": only a ratio may be missing.
        apr = pd.read_csv(
            io.BytesIO(data),
            dtype=dict.fromkeys(text, str),
            keep_default_na=False,
            na_values={"apr": [""]},
        )
    except ValueError as error:
        # No table, no UTF-8.
        raise InputError(str(path), Unquoted(_first_line(error)), _A_WHOLE) from None
    _check_columns(apr, _APR_COLUMNS, path)
    apr[text] = apr[text].map(plain_cell)
    # Groups of runs are the same for every party: a file that is cut off has fewer for
    # the last.
    n_rows = apr.groupby(["layout", "party"]).size()
    if (
        set(n_rows.index) != set(runs.groupby(["layout", "party"]).groups)
        or n_rows.nunique() != 1
    ):
        got = Unquoted(f"{len(apr)} rows, not the same ones for every layout and party")
        raise InputError(
            str(path), got, f"those of {RUNS_FILE}, with the same rows for each"
        )
    return apr


def _check_columns(table: pd.DataFrame, columns: Mapping[str, str], path: Path) -> None:
    missing = [name for name in columns if name not in table.columns]
    if missing:
        got = Unquoted(f"no column {missing[0]}")
        raise InputError(str(path), got, f"columns {', '.join(columns)}")
    for name, kind in columns.items():
        column = table[name]
        # An empty or mixed column has no kind of its own: is_string_dtype looks at the
        # values.
        if not len(column) or not _KINDS[kind](column):
            raise InputError(
                f"{path}: {name}", Unquoted(f"{column.dtype} values"), kind
            )


def _first_line(error: Exception) -> str:
    """Message of a library, short enough for one line."""
    lines = str(error).splitlines() or [type(error).__name__]
    return lines[0][:100]
