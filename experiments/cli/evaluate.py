"""``place-rsus evaluate``: what a layout prevents."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
from msgspec import UNSET, UnsetType

from placement.compute import Compute
from placement.question import Question

from ..progress import StageProgress
from ..results.numbers import percent, several
from .options import (
    JUDGED,
    SectionedCommand,
    folder_option,
    job_options,
    layout_option,
    question_options,
)
from .recording import check_recording_options, recording_options, recording_table
from .running import begin, command_line, load_one_layout, print_result
from .terminal import driven_lines, listing, sentences, table, wide_table

if TYPE_CHECKING:
    from ..results.baselines import ScoreRecord, StudyCasesRecord
    from ..results.evaluations import EvaluationRecord, PartyAprRecord
    from ..results.record import UnitRecord
    from ..results.result import Result

_MAX_UNITS = 24
TOGETHER = "fused: in each frame, any of the units may detect"


@click.command(
    cls=SectionedCommand,
    epilog="""\b
Examples:
  place-rsus evaluate --layout carlancap-12
  place-rsus evaluate --layout results/latest/layout.json --out results/mine
  place-rsus evaluate --recording ncap_data""",
)
@layout_option
@recording_options
@folder_option("a report")
@question_options("no_look", *JUDGED)
@job_options(has_cache=True)
@click.pass_obj
def evaluate(
    progress: StageProgress,
    *,
    layout_names: tuple[str, ...],
    recording: Path | None,
    min_confidence: float,
    out: Path | None,
    question: Question,
    as_json: bool,
    quiet: bool,
    compute: Compute,
) -> None:
    """Evaluate a layout by full perception and emergency braking, or recorded detections."""
    check_recording_options(recording)
    if recording is not None:
        progress.start(quiet=quiet)
        from ..parts import recording as recording_job

        summary = recording_job.run_recording(
            question,
            folder=recording,
            min_confidence=min_confidence,
            out=out,
            progress=progress,
        )
        print_result(summary, progress, as_json, lambda: recording_table(summary, out))
        return
    question = begin(progress, question, quiet=quiet)
    layout = load_one_layout(layout_names, question)
    from ..jobs import placement

    result = placement.run_evaluation(
        question,
        layout=layout,
        no_look=question.no_look,
        out=out,
        compute=compute,
        command=command_line(),
        progress=progress,
    )
    print_result(
        result,
        progress,
        as_json,
        lambda: evaluation_text(result, out),
    )


def evaluation_text(result: "Result", out: Path | None) -> str:
    """One layout's result: units and the APR of each; of many units, those of the highest APR."""
    evaluation = result.evaluation
    units = list(evaluation.units.items())
    if len(units) > _MAX_UNITS:
        units.sort(key=lambda item: item[1].all or 0.0, reverse=True)
    shown = dict(units[:_MAX_UNITS])
    n_left = len(units) - len(shown)
    lines = [
        *additions(result),
        *sentences(f"{result.name} on {result.runs} runs:"),
        *unit_lines([unit for unit in result.layout if unit.id in shown]),
    ]
    if n_left:
        place = "apr.csv" if out is not None else "apr.csv with --out"
        lines.append(f"  and {n_left} more units, none of a higher APR by itself: in {place}")
    lines += [
        *cost_lines(result),
        "",
        *apr_lines(
            {
                **shown,
                "all, fused": evaluation.rsu_all,
                "with the VUT": evaluation.vut_and_rsus,
                "VUT alone": evaluation.vut,
                **announced(evaluation),
            }
        ),
        *sentences(f"each unit by itself; {TOGETHER}.", indent=2),
        *failure_lines(evaluation),
        *written(out),
    ]
    return "\n".join(lines)


def failure_lines(evaluation: "EvaluationRecord") -> list[str]:
    """What is left of the APR of all units when the worst one, or the worst pole, fails."""
    if len(evaluation.units) == 1:
        return []
    text = f"if the worst unit fails, the others have {percent(evaluation.apr_without_worst_unit)}"
    of_site = evaluation.apr_without_worst_site
    if of_site is not UNSET:
        text += f"; if the worst pole fails with all its units, {percent(of_site)}"
    return sentences(f"{text}.", indent=2)


def unit_lines(units: Sequence["UnitRecord"]) -> list[str]:
    """A table of units, where they hang and look; below it what they are, if not the default."""
    from geometry.whereabouts import compass_bearing_deg
    from placement.candidates import load_candidate_grid

    units_of: dict[str, list[str]] = {}
    for unit in units:
        units_of.setdefault(unit.camera or unit.lidar or "", []).append(unit.id)
    models = [f"{model} ({', '.join(ids)})" for model, ids in units_of.items()]
    is_default = set(units_of) == {sensor.name for sensor in load_candidate_grid().sensors}
    rows = [
        [
            unit.id,
            unit.kind or "-",
            f"{unit.z_m:.2f}",
            f"{compass_bearing_deg(unit.yaw_deg):.1f}",
            _tilt(unit.pitch_deg),
            f"{unit.x_m:.2f}",
            f"{unit.y_m:.2f}",
        ]
        for unit in units
    ]
    heads = ["unit", "kind", "height m", "bearing", "tilt", "east m", "north m"]
    return [
        *listing(heads, rows, [_where(unit) for unit in units]),
        "  bearing: degrees clockwise from north",
        *([] if is_default else sentences(f"models: {'; '.join(models)}", indent=2, hanging=2)),
    ]


def _tilt(pitch_deg: float) -> str:
    return f"{abs(pitch_deg):.1f} {'down' if pitch_deg < 0.0 else 'up'}" if pitch_deg else "level"


def _where(unit: "UnitRecord") -> str:
    """The whole name of a unit's site, whether it is assumed, and where it is."""
    site = f"{unit.site} (assumed)" if unit.assumed else unit.site
    known = [text for text in (site, unit.place) if text]
    return f"at {', '.join(known)}" if known else ""


_MOST_ASSUMED = 4


def assumption_lines(result: "Result") -> list[str]:
    """The most important of what was assumed of the map, and how much more there is."""
    from ..report.assumptions import assumption_sentences

    found = assumption_sentences(result)
    if not found:
        return []
    n_left = len(found) - _MOST_ASSUMED
    more = [f"  and {n_left} more: in the report and `scene show`"] if n_left > 0 else []
    return [
        "Assumed, for the map does not say it:",
        *sentences(*found[:_MOST_ASSUMED], indent=2, hanging=2),
        *more,
    ]


def apr_lines(parties: "Mapping[str, PartyAprRecord | ScoreRecord]") -> list[str]:
    """APR by case and by position along the arms: a row for each, a column per party.

    As many columns as fit stand side by side.
    """
    first = next(iter(parties.values()))
    cases = list(first.by_case)
    positions = list(first.by_position) if len(first.by_position) > 1 else []
    columns = {
        name: [
            percent(party.all),
            *(percent(party.by_case[case]) for case in cases),
            *(percent(party.by_position.get(position)) for position in positions),
        ]
        for name, party in parties.items()
    }
    at = [f"at {position} m" for position in positions]
    return wide_table("APR", ["all runs", *cases, *at], columns)


def announced(evaluation: "EvaluationRecord") -> "dict[str, PartyAprRecord]":
    """Columns for road users who announce themselves, where there are any."""
    parties = {"VAM alone": evaluation.vam, "all and VAM": evaluation.all_sources}
    return {name: party for name, party in parties.items() if party is not UNSET}


def cost_lines(result: "Result") -> list[str]:
    """What the sensors cost, and making their sites ready as far as a price is known."""
    sensors = f"sensors {result.cost_eur:,.0f} EUR by the catalogue"
    if result.sites_eur is UNSET:
        return [f"  {sensors}, without poles or mounting"]
    n_sites = len({unit.site for unit in result.layout})
    by = "by prices assumed for their kinds" if result.assumed_prices else "by their own prices"
    sites = f"{several(n_sites, 'site', 'sites')} {result.sites_eur:,.0f} EUR {by}"
    whole = result.cost_eur + result.sites_eur
    return sentences(f"cost: {whole:,.0f} EUR: {sensors}, {sites}", indent=2, hanging=2)


def written(out: Path | None) -> list[str]:
    """Where the report is; no line where there is none."""
    return [] if out is None else ["", f"Written to {out}: report.html and more."]


def baseline_lines(result: "Result") -> list[str]:
    """What layouts prevent that need no optimiser; no line where none were compared."""
    from ..report.comparison import baseline_sentences

    said = sentences(*baseline_sentences(result), indent=2, hanging=2)
    return ["", "Without an optimiser:", *said] if said else []


def study_cases_lines(record: "StudyCasesRecord | UnsetType") -> list[str]:
    """Layouts on the study's cases; no line where these are what was asked about."""
    if not record:
        return []
    rows = [
        [party.name, f"{party.runs_avoided} of {record.runs}", percent(party.all)]
        for party in record.parties
    ]
    return [
        "",
        "On the study's cases, as the study reads them, by the evaluator:",
        *table(["", "runs avoided", "APR"], rows),
    ]


def additions(result: "Result") -> list[str]:
    """What a result has beside layout, proof and evaluation, each part before an empty line.

    First of all how many runs are not avoided, whether another layout does better by the evaluator
    or in fresh worlds, what one more unit or another lens would buy, and what would change the
    answer.
    """
    from ..parts.private_ground import private_ground_sentences
    from ..parts.refinement import refinement_sentences
    from ..parts.sampled_worlds import overtaken_sentences
    from ..report.alternatives import doubt_sentences, recommended_sentences
    from ..report.answer import danger_sentences
    from ..report.next_unit import next_unit_sentence, other_sensor_sentence
    from .explanations import explanation_text, uncertainty_text

    assumed = assumption_lines(result)
    parts = [assumed] if assumed else []
    driven = driven_lines(result.driven, result.without_effect)
    parts += [driven] if driven else []
    further = [f"{said}." for said in (next_unit_sentence(result), other_sensor_sentence(result))]
    overtaken = overtaken_sentences(result.sampled) if result.sampled else []
    told = [
        *danger_sentences(result),
        *recommended_sentences(result),
        *overtaken,
        *(said for said in further if said != "."),
        *doubt_sentences(result),
    ]
    head = sentences(*told)
    parts += [head] if head else []
    if result.front is not UNSET:
        said = sentences(*result.front.sentences, indent=2, hanging=2)
        parts.append(["What each unit buys:", *said])
    if result.explained is not UNSET:
        parts.append([explanation_text(result.explained)])
    if result.private_ground is not UNSET:
        parts.append(sentences(*private_ground_sentences(result)))
    if result.refinement is not UNSET:
        parts.append(sentences(*refinement_sentences(result.refinement)))
    if result.sampled is not UNSET:
        parts.append([uncertainty_text(result.sampled)])
    return [line for part in parts for line in (*part, "")]
