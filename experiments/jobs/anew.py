"""A result made anew, and compared with a folder file by file.

Everything is computed again without any cache: the detection table, the search, the
evaluator's pictures and verdicts, the comparisons, the bill. The report is then drawn
from the numbers that were found to be right. Only times are taken over from the folder.
"""

import math
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace as replace_fields

from geometry.errors import InputError, Unquoted
from geometry.opening import MAX_TEXT_BYTES, read_bytes
from geometry.parquet_files import open_parquet
from geometry.text_formats import parse_json
from placement.compute import Compute
from placement.proof_files import CERTIFICATE_FILE, INSTANCE_FILE
from placement.question import Question

from ..language import LANGUAGES, mark, speaking
from ..parts.reading import read_summary
from ..parts.result import PlacementResult, Result
from ..progress import WRITING, StageProgress
from ..results.folders import LAYOUT_FILE, MARKER, RUNS_FILE, listed_files
from ..results.record import to_plain

if TYPE_CHECKING:
    import pandas as pd

    from .placement import Answered

Add = Callable[[str, str, str], None]
"""Takes a check: its name, what is wrong or nothing, what to say if all is right."""

_TOLERANCE = 1.0e-9
# Keys of times: no two calls take as long.
_SECONDS = "seconds"
_VERSIONS = "versions"
# Times that are not known yet when the report is written.
_AFTERWARDS = (
    WRITING,
    "total",
)
# Differences of a file.
_MOST_TOLD = 3
_PICTURE = re.compile(r"data:[a-z/+]+;base64,[A-Za-z0-9+/=]*")


def compare_anew(
    folder: Path, question: Question, add: Add, progress: StageProgress
) -> None:
    """Make a placement anew and compare every file of its folder.

    Parameters
    ----------
    folder : Path
        Whose ``summary.json`` says what was asked.
    question : Question
        The same with its map imported.
    add : callable
        Takes the checks.
    progress : StageProgress
        Is told the stages.

    Raises
    ------
    InputError
        The folder is no placement's, does not say what was asked, names a network,
        which is a program, or the question cannot be answered here.
    """
    # They load the whole main job.
    from .placement import answer_placement, write_files
    from .search import search

    stored = read_summary(folder / MARKER)
    asked = stored.asked
    if not isinstance(stored, PlacementResult) or asked is None:
        got = Unquoted(f"{folder}, which does not say what was asked")
        raise InputError("--deep", got, "a placement of this version of place-rsus")
    where = f"{folder / MARKER}: asked"
    if ".onnx" in question.detector:
        expected = (
            "no network, which is a program: run the command again if you trust it"
        )
        raise InputError(f"{where}: detector", question.detector, expected)
    if asked.language not in LANGUAGES:
        raise InputError(f"{where}: language", asked.language, " or ".join(LANGUAGES))
    compute = Compute(seed=asked.seed, rays=asked.rays, progress=progress)
    with (
        tempfile.TemporaryDirectory(prefix="place-rsus-anew-") as temporary,
        speaking(asked.language),
    ):
        anew = Path(temporary) / "anew"
        found = search(question, compute=compute, progress=progress)
        answered = answer_placement(found)
        elsewhere = _other_layout(stored, answered)
        if elsewhere:
            add(f"anew: {LAYOUT_FILE}", elsewhere, "")
            return
        progress(mark("compare anew"), 0, 0)
        result = replace_fields(answered.result, seconds=stored.seconds, asked=asked)
        wrong = differences(to_plain(stored), to_plain(result))
        add(f"anew: {MARKER}", told(wrong), "every number, but for times")
        # The report shows times of stages, too: they are taken from the folder,
        # together with numbers that are known to be right.
        shown: Result = result if wrong else stored
        seconds = {
            stage: value
            for stage, value in stored.seconds.items()
            if stage not in _AFTERWARDS
        }
        anew.mkdir()
        write_files(anew, answered, replace_fields(shown, seconds=seconds))
        _compare_folders(folder, anew, add)


def _other_layout(stored: PlacementResult, answered: "Answered") -> str:
    """In words that the search has found another layout this time.

    Nothing if the same one.
    """
    found = answered.result
    if to_plain(found.layout) == to_plain(stored.layout):
        return ""
    units = ", ".join(f"{unit.id} at {unit.site or 'no site'}" for unit in found.layout)
    words = f"another layout is found: {units}"
    if any(stage.gap != 0.0 for stage in stored.stages):
        words += "; the search was not complete, and may end elsewhere each time"
    return words


def _compare_folders(folder: Path, anew: Path, add: Add) -> None:
    """Compare all files but the summary with those made anew."""
    there = listed_files(folder)
    expected = listed_files(anew)
    for name, path in expected.items():
        if name == MARKER:
            continue
        if name not in there:
            add(f"anew: {name}", "it is missing", "")
            continue
        wrong, right = _difference(name, there[name], path)
        add(f"anew: {name}", wrong, right)
    for name in sorted(set(there) - set(expected)):
        add(f"anew: {name}", "such a result has no such file", "")


def _difference(name: str, path: Path, anew: Path) -> tuple[str, str]:
    """What differs in a file, in words, or nothing.

    And what to say if nothing does.
    """
    if name == CERTIFICATE_FILE:
        wrong = differences(_json_of(path), _json_of(anew))
        return told(wrong), "every number, but for times"
    if name == INSTANCE_FILE:
        # An archive may be packed otherwise. The hash of what it holds is compared with
        # the one in the certificate, and that one with the certificate made anew.
        return "", f"by its hash in {CERTIFICATE_FILE}"
    if name == RUNS_FILE:
        return _difference_of_runs(path, anew), "every run of every party"
    got = read_bytes(path, max_bytes=MAX_TEXT_BYTES)
    wanted = read_bytes(anew, max_bytes=MAX_TEXT_BYTES)
    from ..report.page import FILE_NAME as REPORT_FILE

    if name == REPORT_FILE:
        return _difference_of_pages(got, wanted), "every figure, number and word"
    if path.suffix == ".png":
        if got == wanted:
            wrong_picture = ""
        else:
            wrong_picture = _OTHER_PICTURE
        return wrong_picture, "the same picture"
    return _difference_of_texts(got, wanted), "every word and number"


_OTHER_PICTURE = "another picture; other versions of matplotlib may draw it otherwise"


def _json_of(path: Path) -> Any:
    return parse_json(read_bytes(path), str(path), "JSON")


def _difference_of_runs(path: Path, anew: Path) -> str:
    """The first column of the table of runs that differs, in words.

    Or nothing.
    """
    tables = []
    for one in (path, anew):
        with open_parquet(
            one, max_bytes=MAX_TEXT_BYTES, expected="a table of runs"
        ) as file:
            tables.append(file.read().to_pandas(ignore_metadata=True))
    got, wanted = tables
    if list(got.columns) != list(wanted.columns) or len(got) != len(wanted):
        return "other columns or rows"
    for name in wanted.columns:
        if not _is_same_column(got[name], wanted[name]):
            return f"another {name}"
    return ""


def _is_same_column(got: "pd.Series[Any]", wanted: "pd.Series[Any]") -> bool:
    import numpy as np

    if wanted.dtype.kind != "f":
        return got.astype(str).tolist() == wanted.astype(str).tolist()
    if got.dtype.kind != "f":
        return False
    return bool(np.allclose(got, wanted, rtol=0.0, atol=_TOLERANCE, equal_nan=True))


def _difference_of_pages(got: bytes, wanted: bytes) -> str:
    """Words and numbers first.

    Where these are right, a picture is what differs.
    """
    if got == wanted:
        return ""
    page = got.decode("utf-8", "replace")
    other = wanted.decode("utf-8", "replace")
    text = _PICTURE.sub("picture", page)
    other_text = _PICTURE.sub("picture", other)
    if text == other_text:
        return _OTHER_PICTURE
    return _difference_of_texts(text.encode(), other_text.encode()) or "another text"


def _difference_of_texts(got: bytes, wanted: bytes) -> str:
    """The first line in which texts differ, numbers by more than rounding.

    Or nothing.
    """
    if got == wanted:
        return ""
    lines = got.decode("utf-8", "replace").split("\n")
    others = wanted.decode("utf-8", "replace").split("\n")
    for number, (line, other) in enumerate(zip(lines, others, strict=False), start=1):
        if not _is_same_line(line, other):
            return f"line {number} differs"
    if len(lines) != len(others):
        return f"{len(lines)} lines, not {len(others)}"
    return ""


def _is_same_line(line: str, other: str) -> bool:
    """Lines with the same cells between commas; numbers up to rounding."""
    if line == other:
        return True
    cells = line.split(",")
    wanted = other.split(",")
    if len(cells) != len(wanted):
        return False
    return all(map(_is_same_cell, cells, wanted))


def _is_same_cell(cell: str, other: str) -> bool:
    if cell == other:
        return True
    try:
        return abs(float(cell) - float(other)) <= _TOLERANCE
    except ValueError:
        return False


def differences(got: object, expected: object) -> list[str]:
    """Places in which plain values differ, such as ``stages[2].bound``.

    Times and versions of programs are left out; numbers are equal up to rounding.
    """
    return list(_differences(got, expected, ""))


def _differences(got: object, expected: object, place: str) -> Iterator[str]:
    if isinstance(got, Mapping) and isinstance(expected, Mapping):
        for key in dict.fromkeys([*expected, *got]):
            if key in (_SECONDS, _VERSIONS):
                continue
            if place:
                inner = f"{place}.{key}"
            else:
                inner = str(key)
            if key in got and key in expected:
                yield from _differences(got[key], expected[key], inner)
            else:
                yield inner
    elif isinstance(got, list | tuple) and isinstance(expected, list | tuple):
        if len(got) != len(expected):
            yield place
            return
        for index, (one, other) in enumerate(zip(got, expected, strict=True)):
            yield from _differences(one, other, f"{place}[{index}]")
    elif not agree(got, expected):
        yield place


def told(places: Sequence[str]) -> str:
    """The first places that differ, in words; nothing if there are none."""
    if not places:
        return ""
    words = ", ".join(places[:_MOST_TOLD])
    more = len(places) - _MOST_TOLD
    if more > 0:
        words += f" and {more} more"
    return f"made anew it differs in {words}"


def agree(got: object, expected: object) -> bool:
    """Two plain values are equal.

    Numbers up to rounding, an infinite one is None.
    """
    if isinstance(expected, Mapping):
        is_alike = isinstance(got, Mapping) and got.keys() == expected.keys()
        return is_alike and all(agree(got[key], expected[key]) for key in expected)  # type: ignore[index]
    if isinstance(expected, list):
        if not isinstance(got, list) or len(got) != len(expected):
            return False
        return all(agree(one, other) for one, other in zip(got, expected, strict=True))
    if isinstance(expected, float):
        if not math.isfinite(expected):
            return got is None
        is_number = isinstance(got, int | float) and not isinstance(got, bool)
        return is_number and abs(got - expected) <= _TOLERANCE * max(1.0, abs(expected))  # type: ignore[operator]
    return type(got) is type(expected) and got == expected
