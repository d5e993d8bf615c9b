"""What stands beside an answer: how many runs are driven, and what was written."""

from collections.abc import Sequence
from pathlib import Path

from ..language import tr
from ..results.numbers import joined
from .terminal import first_reasons, sentences


def driven_lines(
    driven: Sequence[str], without_effect: Sequence[str] = ()
) -> list[str]:
    """How many possible runs are driven, and why most others are not.

    Also what was asked for and changes nothing.
    """
    reasons = sentences(*first_reasons(driven), indent=2, hanging=2)
    return [*sentences(*driven[:1]), *reasons, *sentences(*without_effect)]


def closing_lines(
    driven: Sequence[str],
    without_effect: Sequence[str],
    out: Path | None,
    files: Sequence[str],
) -> list[str]:
    """What stands below an answer: what is driven, and the files that were written."""
    lines = []
    below = driven_lines(driven, without_effect)
    if below:
        lines += ["", *below]
    if out is not None:
        names = joined(files)
        lines += ["", tr("Written to {out}: {files}.", out=out, files=names)]
    return lines
