"""``place-rsus retrofit``: what to remove, re-aim or add where units hang already."""

from pathlib import Path

import click

from placement.compute import Compute
from placement.question import Question

from ..progress import StageProgress
from .options import (
    JUDGED,
    MOUNTED,
    SectionedCommand,
    compute_options,
    fields_in,
    json_option,
    layout_option,
    option,
    question_options,
    quiet_option,
)
from .pareto import FRONT_SOUGHT
from .running import begin, command_line, load_one_layout, print_result

_TIME_LIMIT_S = 60.0
# What hangs there is --layout; what is added is asked for by money alone.
_ASKED = ("budget_cost", *fields_in(MOUNTED, but=("keep", "within", "force_site")))


@click.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus retrofit --layout carlancap-12
  place-rsus retrofit --layout results/latest/layout.json --budget-cost 4000
  place-rsus retrofit --layout mine.json --sensors carla-ncap-lidar
  place-rsus retrofit --layout carlancap-12 --visit-cost 300 --json""",
)
@layout_option
@option(
    "--visit-cost",
    "visit_eur",
    type=click.FloatRange(min=0.0),
    metavar="EUR",
    expected="euros, at least 0",
    help="Of a re-aim or a removal; default: people and a lift, by the project's assumptions.",
)
@option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder for retrofit.csv and retrofit.json; else none.",
)
@question_options(*_ASKED, *FRONT_SOUGHT, *JUDGED, defaults={"time_limit_s": _TIME_LIMIT_S})
@json_option
@quiet_option
@compute_options(has_cache=True)
@click.pass_obj
def retrofit(
    progress: StageProgress,
    *,
    layout_names: tuple[str, ...],
    visit_eur: float | None,
    out: Path | None,
    question: Question,
    as_json: bool,
    quiet: bool,
    compute: Compute,
) -> None:
    """What to change about units that hang already: remove, re-aim or add one, each priced.

    A unit keeps its pole, height and sensor when it is re-aimed. With --budget-cost, the best
    re-aims and additions together for the money, too.
    """
    layout = load_one_layout(layout_names)
    begin(progress, quiet=quiet)
    from ..jobs.retrofit import retrofit_text, run_retrofit

    summary = run_retrofit(
        question,
        layout=layout,
        visit_eur=visit_eur,
        out=out,
        compute=compute,
        command=command_line(),
        progress=progress,
    )
    print_result(summary, progress, as_json, lambda: retrofit_text(summary, out))
