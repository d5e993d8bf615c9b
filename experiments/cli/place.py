"""``place-rsus``: the best layout, proven, evaluated, compared with the study's, reported."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
from msgspec import UNSET

from placement.compute import Compute
from placement.question import Question

from ..progress import StageProgress
from ..results.numbers import percent
from .evaluate import (
    TOGETHER,
    additions,
    announced,
    apr_lines,
    baseline_lines,
    cost_lines,
    failure_lines,
    study_cases_lines,
    unit_lines,
)
from .options import (
    JUDGED,
    PLANNED,
    SectionedGroup,
    is_given,
    job_options,
    option,
    option_name,
    question_options,
)
from .recording import check_recording_options, recorded_placement_table, recording_options
from .running import begin, command_line, print_result
from .terminal import sentences, table

if TYPE_CHECKING:
    from ..results.baselines import ScoreRecord
    from ..results.evaluations import PartyAprRecord
    from ..results.result import DisagreementRecord, Result

_MAX_DISAGREEMENTS = 5

DEFAULT_OUT = Path("results/latest")


@click.group(
    cls=SectionedGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="""\b
Examples:
  place-rsus --budget 3                            the best three cameras
  place-rsus --target 0.99 --least cost            the cheapest way to 99 %
  place-rsus --budget 3 --within carlancap-12      three of the study's own
  place-rsus --budget-cost 9000 --site-cost 2000   the best for the money
  place-rsus --budget 2 --fusion single            each must confirm alone
  place-rsus --budget 3 --json --quiet | jq .apr   for a machine
  place-rsus --budget 3 --cases protocol-4.5.1 --weights case
  place-rsus --budget 3 --cases CPNCO-50,CBNA --speeds 40-60
  place-rsus --budget 3 --weather day,night,fog --detector response
  place-rsus scenarios list                        what can be driven here
  place-rsus evaluate --layout carlancap-12        the study's 12 cameras
  place-rsus --budget 3 --recording ncap_data      the best recorded units
  place-rsus compare results/latest/layout.json carlancap-12
  place-rsus --scene city.osm --junction "A / B" --budget 3
  place-rsus scene import city.osm -o scene        your own junction ..
  place-rsus --scene scene --budget 3              .. and the best three there
  place-rsus pareto --max 8                        what each further unit buys
  place-rsus retrofit --layout carlancap-12        remove, re-aim or add
  place-rsus sheet --layout results/latest/layout.json --out mounting.pdf
  place-rsus verify results/latest                 check a certificate
  place-rsus doctor                                what is installed here
  place-rsus export --layout results/latest/layout.json --format carla

Exit codes: 0 done, 1 `verify`, `scene check` or `doctor` found a fault, 2 the input is wrong or
cannot be met (one line says what), 130 interrupted, 143 terminated.""",
)
@click.version_option(package_name="place-rsus")
@option(
    "--out",
    type=click.Path(path_type=Path),
    default=DEFAULT_OUT,
    show_default=True,
    help="Folder for report, layout, tables and figures; earlier results there are replaced.",
)
@recording_options
@question_options(*PLANNED, *JUDGED)
@job_options(has_cache=True)
@click.pass_context
def cli(
    context: click.Context,
    *,
    recording: Path | None,
    min_confidence: float,
    question: Question,
    out: Path,
    as_json: bool,
    quiet: bool,
    compute: Compute,
) -> None:
    """Where to mount roadside cameras so that pedestrians and cyclists are not hit.

    Finds the best layout for the junction of the CarlaNCAP study, proves that it is, evaluates it
    by full perception and emergency braking, compares it with the study's 12 cameras, and writes
    a report.
    """
    if context.invoked_subcommand is not None:
        given = [
            option_name(param) for param in context.command.params if is_given(str(param.name))
        ]
        if given:
            raise click.UsageError(
                f"{given[0]}: options of {context.invoked_subcommand} go behind its name"
            )
        return
    if question.budget is None and question.budget_cost is None and not question.target:
        raise click.UsageError(
            "--budget: got nothing; expected a whole number of units, at least 1 (or --target, or "
            "--budget-cost)"
        )
    progress: StageProgress = context.obj
    check_recording_options(recording)
    if recording is not None:
        progress.start(quiet=quiet)
        from ..parts import recording as recording_job

        folder = out if is_given("out") else None
        summary = recording_job.run_recorded_placement(
            question,
            folder=recording,
            min_confidence=min_confidence,
            out=folder,
            progress=progress,
        )
        print_result(summary, progress, as_json, lambda: recorded_placement_table(summary, folder))
        return
    question = begin(progress, question, quiet=quiet)
    from ..report.beside import drawing_beside

    asks_much = not (is_given("cases") or question.speeds or question.approaches)
    with drawing_beside(asks_much and compute.workers > 1) as beside:  # loads while this one does
        from ..jobs import placement

        result = placement.run_placement(
            question,
            out=out,
            compute=compute,
            command=command_line(),
            progress=progress,
            beside=beside,
        )
    print_result(result, progress, as_json, lambda: placement_text(result, out))


def placement_text(result: "Result", out: Path) -> str:
    """The main job's result: units, proof, APR of all parties."""
    evaluation, baseline = result.evaluation, result.baseline
    assert result.stages is not UNSET
    assert result.greedy is not UNSET
    assert result.disagreements is not UNSET
    stages = [
        [
            _label(stage.name, result),
            _value(stage.name, stage.objective),
            _value(stage.name, stage.bound),
            "proven" if stage.gap == 0.0 else _gap(stage.gap),
        ]
        for stage in result.stages
    ]
    parties: dict[str, PartyAprRecord | ScoreRecord] = {
        "these, fused": evaluation.rsu_all,
        "with the VUT": evaluation.vut_and_rsus,
        "VUT alone": evaluation.vut,
        "greedy, fused": result.greedy.rsu_all,
    }
    if baseline is not None:
        parties[f"{result.baseline_name} fused"] = baseline.rsu_all
    expert = result.baselines.expert if result.baselines else None
    if expert is not None:
        parties["expert rule, fused"] = expert.score
    lines = [
        *additions(result),
        f"Best {len(result.layout)} of {result.candidates} poses on {result.runs} runs "
        f"(fusion {result.fusion}):",
        *unit_lines(result.layout),
        *cost_lines(result),
        *sentences(*(result.assumed_prices or ()), indent=2, hanging=2),
        "",
        *table(["on the detection table", "found", "bound", "gap"], stages),
        "",
        "Evaluated by full perception and emergency braking:",
        *apr_lines(parties | announced(evaluation)),
        *sentences(f"{TOGETHER}; greedy: units chosen one by one.", indent=2),
        *failure_lines(evaluation),
        *baseline_lines(result),
        *study_cases_lines(result.study_cases),
        "",
        f"Table and evaluator disagree on {percent(result.surrogate_disagreement)} of the runs.",
        *_disagreements(result.disagreements),
        f"Written to {out}: report.html and more.",
    ]
    return "\n".join(lines)


def _seconds(value: float) -> str:
    return f"{value:.3f} s"


_OBJECTIVES: dict[str, tuple[str, Callable[[float], str]]] = {
    "units": ("units", "{:.0f}".format),
    "apr_survived": ("if the worst ones fail", percent),
    "apr": ("accidents prevented", percent),
    "apr_one_failed": ("if the worst one fails", percent),
    "smallest_margin_s": ("smallest margin", _seconds),
    "mean_margin_s": ("mean margin", _seconds),
    "cost_eur": ("cost, EUR", "{:,.0f}".format),
}


def _label(name: str, result: "Result") -> str:
    label = _OBJECTIVES[name][0]
    by_site = result.failing is not UNSET
    return label.replace("one fails", "pole fails").replace("ones", "poles") if by_site else label


def _value(objective: str, value: float | None) -> str:
    return "open" if value is None else _OBJECTIVES[objective][1](value)


def _gap(gap: float | None) -> str:
    return "open" if gap is None or not math.isfinite(gap) else f"{100.0 * gap:.2f} %"


def _disagreements(disagreements: "Sequence[DisagreementRecord]") -> list[str]:
    """One entry per unit and run that they see differently, the first few."""
    lines = []
    for entry in disagreements[:_MAX_DISAGREEMENTS]:
        verdict = "table avoids" if entry.on_table else "evaluator avoids"
        lines += sentences(
            f"{entry.party} in {entry.run_id}: only the {verdict}; {entry.cause}",
            indent=2,
            hanging=2,
        )
    n_left = len(disagreements) - _MAX_DISAGREEMENTS
    return lines + ([f"  and {n_left} more in summary.json"] if n_left > 0 else [])
