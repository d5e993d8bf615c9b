"""Answers of placements, evaluations and comparisons as lists of parts, for a terminal.

Parts that are short fit on a screen together: what is not avoided, what to mount, the
proof, and what it is compared with. With ``--verbose`` all are printed.
"""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from geometry.junction import compass_bearing_deg
from placement.candidates import load_candidate_grid
from placement.explain.agreement import Disagreement
from placement.explain.unavoided import Unavoided

from ..language import localized, mark, tr, trn
from ..parts import (
    Part,
    answer,
    baselines,
    comparison,
    dangers,
    decision,
    explanation,
    front,
    proof,
    road_users,
    sampled_worlds,
    study_cases,
)
from ..parts.assumptions import assumption_sentences
from ..parts.baselines import Score
from ..parts.bill_of_materials import left_out_sentence
from ..parts.comparison import HIGHEST, Compared
from ..parts.headline import headline
from ..parts.result import ComparisonResult, EvaluationResult, PlacementResult, Result
from ..parts.section import Table
from ..parts.units import tilt_words
from ..results.numbers import (
    euros,
    first_of,
    grouped,
    layout_words,
    number,
    percent,
    shortened,
)
from ..results.record import EvaluationRecord, PartyAprRecord, UnitRecord
from .terminal import basis, first_reasons

_MAX_UNITS = 24
_MAX_SHORT_UNITS = 12
_NAME_WIDTH = 40
_VUT_ALONE = mark("VUT alone")
_EVALUATED = mark("Evaluated by full perception and emergency braking:")
_NO_RUNS = mark("none")
_MOST_ASSUMED = 4
_MAX_DISAGREEMENTS = 5
_Apr = PartyAprRecord | Score


def placement_parts(result: PlacementResult, out: Path) -> list[Part]:
    """The best layout, its proof, and what it is compared with."""
    others = {"greedy": result.greedy}
    if result.highest is not None and result.highest.compared is not None:
        others = {HIGHEST: result.highest.compared, **others}
    parties: dict[str, _Apr] = {
        tr("this layout, fused"): result.evaluation.judged,
        **dict([_other_view(result.evaluation)]),
        tr(_VUT_ALONE): result.evaluation.vut,
        tr("greedy, fused"): result.greedy.evaluation.judged,
    }
    if result.baseline is not None:
        others[result.baseline.name] = result.baseline
        name = tr("{name} fused", name=result.baseline.name)
        parties[name] = result.baseline.evaluation.judged
    if result.baselines.expert is not None:
        parties[tr("expert rule, fused")] = result.baselines.expert.score
    further = explanation.next_unit_sentence(result.next_unit)
    best = tr(
        "Best {n} of {poses} poses on {runs} runs (fusion {fusion}{cars}):",
        n=len(result.layout),
        poses=result.candidates,
        **basis(result),
    )
    note = tr("{fused}; greedy: units chosen one by one.", fused=_together(result))
    return [
        *_head(result),
        Part(
            title=best,
            table=_units_table(result.layout, result.existing),
            notes=[*unit_notes(result.layout), _cost(result)],
            is_short=True,
        ),
        Part(notes=[*map(tr, result.assumed_prices)]),
        _said(f"{proof.words(result)}."),
        Part(table=proof.table(result), notes=proof.conditions(result)),
        *_judged(result, others, parties | _announced(result.evaluation), note),
        *([_said(f"{further}.")] if further else []),
        _said(*answer.doubts(result)),
        *_explained(result),
        *_besides(result),
        Part(
            words=[
                tr(
                    "Table and evaluator disagree on {share} of the runs.",
                    share=percent(result.surrogate_disagreement),
                )
            ],
            notes=_disagreements(result.disagreements),
        ),
        _last(out),
    ]


def evaluation_parts(result: EvaluationResult, out: Path | None) -> list[Part]:
    """One layout: its units and the APR of each.

    Of many units, those of the highest APR.
    """
    evaluation = result.evaluation
    alone = list(evaluation.units.items())
    if len(alone) > _MAX_UNITS:
        alone.sort(key=lambda item: item[1].all or 0.0, reverse=True)
    shown = dict(alone[:_MAX_UNITS])
    n_left = len(alone) - len(shown)
    more = tr(
        "and {n} more units in apr.csv, none with a higher APR by itself", n=n_left
    )
    if out is None:
        more = tr(
            "and {n} more units, none with a higher APR by itself (--out lists them"
            " in apr.csv)",
            n=n_left,
        )
    units = [unit for unit in result.layout if unit.id in shown]
    cost = _cost(result)
    is_long = len(units) > _MAX_SHORT_UNITS
    in_short = tr(
        "{name}: {n} units; {cost}.", n=len(result.layout), name=result.name, cost=cost
    )
    parties: dict[str, _Apr] = {
        **shown,
        tr("all, fused"): evaluation.judged,
        **dict([_other_view(evaluation)]),
        tr(_VUT_ALONE): evaluation.vut,
        **_announced(evaluation),
    }
    return [
        *_head(result),
        Part(
            title=tr("{name} on {runs} runs{cars}:", name=result.name, **basis(result)),
            table=_units_table(units, result.existing),
            notes=[*([more] if n_left else []), *unit_notes(units), cost],
            is_short=not is_long,
        ),
        *([_said(in_short)] if is_long else []),
        *_judged(
            result,
            {},
            parties,
            tr("each unit by itself; {fused}.", fused=_together(result)),
        ),
        _said(*answer.doubts(result)),
        _said(*answer.private_ground(result)),
        _last(out),
    ]


def comparison_parts(result: ComparisonResult, out: Path | None) -> list[Part]:
    """Layouts side by side, and the runs in which the first differs from each other."""
    others = {other.name: other for other in result.compared}
    parties: dict[str, _Apr] = {}
    judged = {name: other.evaluation for name, other in others.items()}
    for name, evaluation in {result.name: result.evaluation, **judged}.items():
        parties[name] = evaluation.judged
        alone = tr("{name} alone", name=name)
        if result.cars:
            other_view = alone
        else:
            other_view = tr("{name} and VUT", name=name)
        parties[other_view] = _other_view(evaluation)[1]
    if result.baselines and result.baselines.expert is not None:
        parties[tr(comparison.EXPERT)] = result.baselines.expert.score
    parties[tr(_VUT_ALONE)] = result.evaluation.vut
    note = tr("each layout's units are {fused}.", fused=_together(result))
    return [
        *_head(result),
        *_judged(result, others, parties, note),
        _said(*(f"{text}." for text in comparison.words(result.name, result.compared))),
        _said(*answer.doubts(result)),
        *_besides(result),
        *(
            Part(
                title=tr(over if len(others) > 1 else alone, name=name),
                words=[", ".join(runs) or tr(_NO_RUNS)],
            )
            for name, other in others.items()
            for over, alone, runs in (
                (
                    mark("Runs gained compared with {name}:"),
                    mark("Runs gained:"),
                    other.runs_gained,
                ),
                (
                    mark("Runs lost compared with {name}:"),
                    mark("Runs lost:"),
                    other.runs_lost,
                ),
            )
        ),
        _last(out),
    ]


def _judged(
    result: Result,
    others: Mapping[str, Compared],
    parties: Mapping[str, _Apr],
    note: str,
) -> list[Part]:
    """The layout, `others`, and the APR of all `parties` by the evaluator."""
    title = tr(_EVALUATED)
    notes = failure_notes(result.evaluation)
    if isinstance(result, ComparisonResult):
        values = {"name": result.name, "names": ", ".join(others), **basis(result)}
        title = tr("{name} compared with {names} on {runs} runs{cars}:", **values)
        notes = []
    summary = _summary_table(result, others)
    return [
        Part(title=title, table=summary, notes=notes, is_short=True),
        Part(table=_apr_table(parties), notes=[note]),
        _impacts(result, others),
        *_decided(result),
    ]


def _decided(result: Result) -> list[Part]:
    """Who is located, and the decision to brake, where that was asked for."""
    return [_said(*answer.located(result)), decision.part(result.decision)]


def _besides(result: PlacementResult | ComparisonResult) -> list[Part]:
    """What was asked for besides, and baselines."""
    without = baselines.words(result.baselines, n_units=len(result.layout))
    study = result.study_cases and study_cases.table(result.study_cases)
    by_study = tr("On the study's cases, as the study defines them (evaluator):")
    return [
        _said(*answer.private_ground(result)),
        _said(*answer.refinement(result)),
        *_sampled(result),
        *([Part(title=tr("Without an optimiser:"), words=without)] if without else []),
        *([Part(title=by_study, table=study)] if study else []),
    ]


def _impacts(result: Result, others: Mapping[str, Compared]) -> Part:
    """What is left of the impacts."""
    parties = {
        result.name: result.evaluation.judged,
        **{tr(name): other.evaluation.judged for name, other in others.items()},
        tr(_VUT_ALONE): result.evaluation.vut,
    }
    left = ", ".join(
        f"{name} {number(party.mean_impact_speed_kmh, 1)}"
        for name, party in parties.items()
    )
    words = tr(
        "Mean speed of the VUT at contact (avoided runs count as 0): {speeds} km/h.",
        speeds=left,
    )
    return Part(words=[words])


def _said(*sentences: str) -> Part:
    """A part that is sentences, which all are short."""
    return Part(words=sentences, is_short=True)


def _head(result: Result) -> list[Part]:
    """The head: runs not avoided, better layouts, what was assumed.

    Also what was left out.
    """
    groups = result.road_users
    return [
        _said(*answer.private_views(result)),
        _said(
            *headline(result),
            *dangers.words(result.dangers, result.runs, cars=result.cars),
        ),
        _said(*answer.preferred(result), *answer.planned_only(result)),
        _said(*result.driven[:1], *result.without_effect),
        Part(notes=first_reasons(result.driven)),
        *([_said(" ".join(road_users.words(groups)))] if groups else []),
        *(
            [Part(table=road_users.table(groups))]
            if groups and len(groups.groups) > 1
            else []
        ),
        *assumption_parts(result),
    ]


def assumption_parts(result: Result) -> list[Part]:
    """How much was assumed of the map; and the most important of it."""
    assumed = assumption_sentences(result)
    if not assumed:
        return []
    n_left = len(assumed) - _MOST_ASSUMED
    return [
        _said(
            trn(
                "{n} detail of the map is assumed.",
                "{n} details of the map are assumed.",
                len(assumed),
            )
        ),
        Part(
            title=tr("Assumed because the map does not give it:"),
            words=assumed[:_MOST_ASSUMED],
            notes=(
                [tr("and {n} more: in the report and `scene show`", n=n_left)]
                if n_left > 0
                else []
            ),
        ),
    ]


def _explained(result: PlacementResult) -> list[Part]:
    """What fewer units give, and what is missed."""
    if result.front is None:
        return explanation_parts(result.explained)
    bought = Part(
        title=tr(
            "The highest APR with fewer units, without giving up APR for failures:"
        ),
        words=result.front.sentences,
        table=front.table(result.front),
        notes=front.notes(result.front),
    )
    return [bought, *explanation_parts(result.explained)]


def _sampled(result: PlacementResult | ComparisonResult) -> list[Part]:
    if result.sampled is None:
        return []
    words = answer.uncertainty(result)
    if result.sampled.growth is None:
        n_first = 1
    else:
        n_first = 2
    table = sampled_worlds.table(result.sampled)
    return [_said(*words[:n_first]), Part(words=words[n_first:], table=table)]


def _last(out: Path | None) -> Part:
    """Where the rest is."""
    if out is None:
        written = []
    else:
        written = [tr("Written to {out}: report.html and more.", out=out)]
    return _said(
        *written,
        tr("--verbose adds the reasons, the APR by case and all other details."),
    )


def _units_table(units: Sequence[UnitRecord], existing: Collection[str]) -> Table:
    """Units, where they are mounted and look; `existing` are ids of mounted ones."""
    rows = []
    for unit in units:
        if unit.assumed:
            site = tr("{site} (assumed)", site=unit.site)
        else:
            site = unit.site
        tilt = tilt_words(unit.pitch_deg)
        bearing = compass_bearing_deg(unit.yaw_deg)
        height_m = unit.z_m if unit.height_m is None else unit.height_m
        looks = [localized(f"{height_m:.2f}"), localized(f"{bearing:.1f}"), tilt]
        stands = [localized(f"{unit.x_m:.2f}"), localized(f"{unit.y_m:.2f}")]
        kind = tr(unit.kind or "-")
        place = site
        if unit.place:
            if site:
                place = f"{site}, {tr(unit.place)}"
            else:
                place = tr(unit.place)
        if unit.id in existing:
            place = tr("{place} (existing)", place=place)
        rows.append([unit.id, kind, *looks, *stands, place])
    columns = [
        tr("unit"),
        tr("kind"),
        tr("height m"),
        tr("bearing"),
        tr("tilt"),
        tr("east m"),
        tr("north m"),
        tr("at"),
    ]
    return Table(caption=tr("Units"), columns=columns, rows=rows, numeric=range(1, 7))


def unit_notes(units: Sequence[UnitRecord]) -> list[str]:
    """How the table of units is to be read, and what they are, if not the default."""
    units_of = grouped((unit.camera or unit.lidar or "", unit.id) for unit in units)
    models = "; ".join(f"{model} ({', '.join(ids)})" for model, ids in units_of.items())
    is_default = set(units_of) == {
        sensor.name for sensor in load_candidate_grid().sensors
    }
    bearing = tr("bearing: degrees clockwise from north")
    if is_default:
        return [bearing]
    return [bearing, tr("models: {models}", models=models)]


def _cost(result: Result) -> str:
    """Cost of what there is to buy, as far as it is known, and what it leaves out."""
    n_existing = len(result.existing)
    n_to_buy = len(result.layout) - n_existing
    if not n_to_buy:
        return tr("cost: nothing to buy; all {n} sensors exist", n=n_existing)
    values = {"n": n_to_buy, "sensors": euros(result.sensors_eur)}
    bought = trn(
        "{n} sensor {sensors} (catalogue)",
        "{n} sensors {sensors} (catalogue)",
        n_to_buy,
        **values,
    )
    if n_existing:
        bought = trn(
            "{n} new sensor {sensors} (catalogue; {n_existing} exist)",
            "{n} new sensors {sensors} (catalogue; {n_existing} exist)",
            n_to_buy,
            n_existing=n_existing,
            **values,
        )
    # A sum with an unknown part would look like the whole price.
    total = None
    if result.sensors_eur is not None and result.sites_eur is not None:
        total = result.sensors_eur + result.sites_eur
    source = tr("own prices")
    if result.assumed_prices:
        source = tr("assumed")
    return tr(
        "cost: {total}: {bought}, poles {sites} ({source}). {left_out}",
        total=euros(total),
        bought=bought,
        sites=euros(result.sites_eur),
        source=source,
        left_out=left_out_sentence(),
    )


def _summary_table(result: Result, others: Mapping[str, Compared]) -> Table:
    """A row per sensing party.

    APR, when the most needed unit fails, and on the study's cases.
    """
    parties = () if result.study_cases is None else result.study_cases.parties
    study = {party.name: percent(party.all) for party in parties}
    evaluation = result.evaluation

    def row_of(name: str, one: Result | Compared) -> list[str | None]:
        judged = one.evaluation
        shares = percent(judged.judged.all), percent(judged.apr_without_worst_unit)
        return [layout_words(name), str(len(one.layout)), *shares, study.get(name)]

    rows = [
        row_of(result.name, result),
        _other_row(evaluation),
        [tr(_VUT_ALONE), "", percent(evaluation.vut.all), "", study.get(_VUT_ALONE)],
        *(_row(name, party) for name, party in _announced(evaluation).items()),
    ]
    for name, other in others.items():
        rows.append(row_of(name, other))
        if isinstance(result, ComparisonResult):
            rows.append(_other_row(other.evaluation))
    found = result.baselines
    if found is not None and (expert := found.expert) is not None:
        shares = percent(expert.score.all), percent(expert.apr_without_worst_unit)
        name = comparison.EXPERT
        rows.append([tr(name), str(len(expert.layout)), *shares, study.get(name)])
    if found is not None and found.random is not None:
        name = tr("random, mean of {n} on the table", n=found.random.layouts)
        rows.append(
            [name, str(found.random.units), percent(found.random.mean), "", None]
        )
    columns = [
        "",
        *[tr("units"), tr("APR"), tr("if one fails"), tr("on the study's cases")],
    ]
    if study:
        n_columns = len(columns)
    else:
        n_columns = len(columns) - 1
    return Table(
        caption=tr("APR"),
        columns=columns[:n_columns],
        rows=[
            [
                shortened(row[0] or "", _NAME_WIDTH),
                *(cell or "" for cell in row[1:n_columns]),
            ]
            for row in rows
        ],
        numeric=range(1, n_columns),
    )


def _other_view(evaluation: EvaluationRecord) -> tuple[str, PartyAprRecord]:
    """Units with the VUT where cars are blind, else units alone."""
    if evaluation.headline is None:
        return tr("with the VUT"), evaluation.vut_and_rsus
    return tr("units alone"), evaluation.rsu_all


def _other_row(evaluation: EvaluationRecord) -> list[str | None]:
    words, party = _other_view(evaluation)
    return _row(f"  {words}", party)


def _row(name: str, party: PartyAprRecord) -> list[str | None]:
    return [name, "", percent(party.all), "", None]


def _together(result: Result) -> str:
    """What it means that units are fused, and who else is one."""
    if not result.cars:
        return tr("fused: a frame counts as detected if any unit detects")
    if result.cars == 1.0:
        return tr("fused: a frame counts as detected if any unit or the VUT detects")
    return tr(
        "fused: a frame counts as detected if any unit detects or, in {share} of the"
        " cars, the VUT",
        share=percent(result.cars),
    )


def _announced(evaluation: EvaluationRecord) -> dict[str, PartyAprRecord]:
    """Road users who announce themselves, where there are any."""
    parties = {
        tr("VAM alone"): evaluation.vam,
        tr("all and VAM"): evaluation.all_sources,
    }
    return {name: party for name, party in parties.items() if party is not None}


def _apr_table(parties: Mapping[str, _Apr]) -> Table:
    """APR by case and by position along the arms.

    A row for each, a column per party.
    """
    all_of = list(parties.values())
    first = all_of[0]
    if len(first.by_position) > 1:
        positions = list(first.by_position)
    else:
        positions = []
    rows = [[tr("all runs"), *(percent(party.all) for party in all_of)]]
    rows += [
        [case, *(percent(party.by_case[case]) for party in all_of)]
        for case in first.by_case
    ]
    rows += [
        [
            tr("at {position} m", position=at),
            *(percent(party.by_position.get(at)) for party in all_of),
        ]
        for at in positions
    ]
    numeric = range(1, 1 + len(parties))
    return Table(
        caption=tr("APR"), columns=[tr("APR"), *parties], rows=rows, numeric=numeric
    )


def failure_notes(evaluation: EvaluationRecord) -> list[str]:
    """APR of the others when a pole fails that carries several units."""
    share = evaluation.apr_without_worst_site
    if share is None:
        return []
    return [
        tr(
            "if the most important pole fails with all its units, the others reach"
            " {share}.",
            share=percent(share),
        )
    ]


def _disagreements(found: Sequence[Disagreement]) -> list[str]:
    """Runs that table and evaluator see differently, the first few."""
    by_table = mark("{one.party} in {one.run_id}: avoided only by the table; {cause}")
    by_evaluator = mark(
        "{one.party} in {one.run_id}: avoided only by the evaluator; {cause}"
    )
    lines = [
        tr(by_table if one.on_table else by_evaluator, one=one, cause=tr(one.cause))
        for one in found[:_MAX_DISAGREEMENTS]
    ]
    n_left = len(found) - _MAX_DISAGREEMENTS
    return lines + ([_more(n_left)] if n_left > 0 else [])


def _more(n_left: int) -> str:
    return tr("and {n} more in summary.json", n=n_left)


_MAX_RUNS = 3
_MAX_MISSED = 8


def explanation_parts(explained: explanation.ExplainedRecord) -> list[Part]:
    """What is missed, and why.

    Runs alike together, but for numbers.
    """
    groups = _alike(explained.not_avoided)
    n_left = sum(map(len, groups[_MAX_MISSED:]))
    return [
        Part(
            words=[" ".join(explanation.missed_sentences(explained))],
            notes=[
                *map(_missed_in_short, groups[:_MAX_MISSED]),
                *([_more(n_left)] if n_left else []),
            ],
        ),
    ]


def _alike(missed: Sequence[Unavoided]) -> list[list[Unavoided]]:
    """Runs that have the same said of them, but for numbers.

    The largest group first.
    """
    groups = grouped((tuple(_said_of(entry).values()), entry) for entry in missed)
    return sorted(groups.values(), key=len, reverse=True)


def _said_of(entry: Unavoided) -> dict[str, str]:
    return {
        "outcome": explanation.outcome_words(entry.outcome),
        "unit": entry.unit,
        "cause": explanation.cause(entry.reasons[0]) if entry.reasons else "",
        "rescue": entry.rescue.unit if entry.rescue else "",
    }


def _missed_in_short(group: Sequence[Unavoided]) -> str:
    first = group[0]
    values = _said_of(first) | {
        "runs": first_of([entry.run for entry in group], _MAX_RUNS)
    }
    if first.reasons and first.rescue:
        return tr(
            "{runs}: {outcome}; for {unit} {cause}; avoidable with {rescue}",
            **values,
        )
    if first.reasons:
        return tr("{runs}: {outcome}; for {unit} {cause}", **values)
    if first.rescue:
        return tr("{runs}: {outcome}; avoidable with {rescue}", **values)
    return tr("{runs}: {outcome}", **values)
