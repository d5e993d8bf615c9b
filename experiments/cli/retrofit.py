"""``place-rsus retrofit``: what to remove, re-aim or add where units hang already."""

from pathlib import Path

import click

from placement.compute import Compute
from placement.question import Question

from ..progress import (
    StageProgress,
    cache_folder,
    command_line,
    load_one_layout,
    print_result,
    warn_of_slow_rays,
)
from .latency import latency_budget_options
from .options import (
    Number,
    SectionedCommand,
    cache_option,
    json_option,
    layout_option,
    question_options,
    quiet_option,
    seed_option,
    workers_option,
)
from .pareto import leave_out
from .planning import planning_options

_TIME_LIMIT_S = 60.0
# What hangs there is --layout; what is added is asked for by money alone.
_NOT_ASKED = (
    *("budget", "target", "least", "min_case_apr", "survive", "stage_weights"),
    *("keep", "within", "force_site", "study_poses"),
)


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
@click.option(
    "--visit-cost",
    "visit_eur",
    type=Number("EUR", "euros", may_be_zero=True),
    help="Of a re-aim or a removal; default: people and a lift, by the project's assumptions.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Folder for retrofit.csv and retrofit.json; else none.",
)
@planning_options(has_samples=False)
@question_options()
@latency_budget_options()
@json_option
@quiet_option
@seed_option
@workers_option
@cache_option
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
    seed: int,
    workers: int,
    uses_cache: bool,
) -> None:
    """What to change about units that hang already: remove, re-aim or add one, each priced.

    A unit keeps its pole, height and sensor when it is re-aimed. With --budget-cost, the best
    re-aims and additions together for the money, too.
    """
    layout = load_one_layout(layout_names)
    progress.start(quiet=quiet)
    from ..jobs.retrofit import retrofit_text, run_retrofit

    warn_of_slow_rays()
    summary = run_retrofit(
        question,
        layout=layout,
        visit_eur=visit_eur,
        out=out,
        compute=Compute(
            seed=seed,
            workers=workers,
            cache_folder=cache_folder() if uses_cache else None,
            progress=progress,
        ),
        command=command_line(),
        progress=progress,
    )
    print_result(summary, progress, as_json, lambda: retrofit_text(summary, out))


leave_out(retrofit, _NOT_ASKED, time_limit_s=_TIME_LIMIT_S)
