"""``place-rsus certify``: a layout over worlds, and what it may lack."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from placement.question import N_BLOCKS, N_JUDGED, N_SAMPLES

from ..language import tr
from ..results.numbers import joined
from . import options
from .driven import driven_lines
from .running import QuestionCall, command_line
from .terminal import sentences, table

if TYPE_CHECKING:
    from ..parts.certified import CertifiedResult

_ASKED = ("budget", "budget_cost", *options.fields_in(options.MOUNTED))
_SOUGHT = (
    "solver",
    "time_limit_s",
    "gap",
    "fusion",
    "samples",
    "uncertainty",
    "traffic",
)


_EXAMPLES = """\b
Examples:
  place-rsus certify --budget 3 --detector response
  place-rsus certify --budget 2 --samples 16 --blocks 4 --detector response
  place-rsus certify --budget 3 --detector response --out results/certified
  place-rsus verify results/certified"""


@click.command(cls=options.SectionedCommand, epilog=_EXAMPLES)
@options.option(
    "--blocks",
    "n_blocks",
    type=click.IntRange(min=2),
    default=N_BLOCKS,
    metavar="N",
    expected="a whole number, at least 2",
    help="Blocks of --samples worlds each; a layout and a bound is found in each.",
)
@options.option(
    "--judge",
    "n_judged",
    type=click.IntRange(min=2),
    default=N_JUDGED,
    metavar="N",
    expected="a whole number, at least 2",
    help=(
        "Fresh worlds to choose among these layouts in, and as many others to judge the"
        " best in."
    ),
)
@options.folder_option("layout.json and certified.json")
@options.sign_option
@options.engine_options
@options.asking(*_ASKED, *_SOUGHT, *options.JUDGED, defaults={"samples": N_SAMPLES})
def certify(
    job: QuestionCall, *, out: Path | None, engine: dict[str, Any], **asked: Any
) -> None:
    """The best layout over all worlds that may turn out to be.

    With a gap that holds with 95 %.

    Worlds differ in mounting errors, traffic, misses and lost messages. In each of some
    blocks of worlds the best layout is found, and a bound is proven. The mean of the
    bounds limits what any layout can prevent over all worlds; the best of the layouts
    is judged in worlds of its own.
    """
    job = job.begin()
    from ..engine.start import EngineWish
    from ..parts.certified import run_certify

    result = run_certify(
        job.question,
        out=out,
        engine=EngineWish(workers=job.compute.workers, **engine),
        tell=job.announce,
        command=command_line(),
        **asked,
        **job.means,
    )
    job.print(result, lambda: certified_text(result, out))


def certified_text(result: "CertifiedResult", out: Path | None) -> str:
    """The layout and its gap, then the layouts that it was chosen among."""
    from ..parts import certified

    first, *others = certified.words(result)
    pool = certified.table(result)
    rows = [[str(cell) for cell in row] for row in pool.rows]
    lines = [
        *sentences(first),
        *driven_lines(result.driven, result.without_effect),
        *sentences(*others),
        "",
        *table(pool.columns, rows, n_left=1),
    ]
    if out is not None:
        files = joined(("layout.json", "certified.json"))
        lines += ["", tr("Written to {out}: {files}.", out=out, files=files)]
    return "\n".join(lines)
