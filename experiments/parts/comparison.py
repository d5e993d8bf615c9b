"""Layouts side by side.

Their worth, the runs on which they differ, how sure the difference is.
"""

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations
from typing import Annotated

import msgspec
import numpy as np

from placement.evaluation import (
    Evaluation,
    Verdict,
    apr,
    apr_one_failed,
    headline_apr,
    mean_impact_speed_kmh,
)
from scenarios.aeb import AebRule

from ..language import localized, mark, tr
from ..results.numbers import (
    NOTHING,
    count_runs,
    in_points,
    layout_words,
    number,
    or_nan,
    percent,
)
from ..results.record import (
    EvaluationRecord,
    Record,
    UnitRecord,
    build_evaluation_record,
    build_unit_records,
    price_eur,
    says,
)
from ..results.tables import margin_s
from .accidents import layouts_table
from .baselines import Baselines
from .baselines import words as baseline_words
from .sampled_worlds import SampledPairRecord, SampledRecord, is_open
from .section import Block, Bullets, Section, Subheading, Table, tabulate
from .units import PrivateGroundRecord

GREEDY = mark("greedy")
EXPERT = mark("expert rule")
HIGHEST = mark("highest APR")
"""Display names of layouts to compare with: they appear in tables and bars only."""


class Compared(Record, frozen=True, kw_only=True):
    """Another layout on the same runs."""

    name: Annotated[str, says("Of the layout.")]
    layout: Annotated[tuple[UnitRecord, ...], says("Its units.")]
    cost_eur: Annotated[
        float, says("The units by the catalogue, without poles, in EUR.")
    ]
    evaluation: Annotated[EvaluationRecord, says("By the evaluator.")]
    runs_gained: Annotated[
        tuple[str, ...], says("Runs that only the first layout avoids.")
    ]
    runs_lost: Annotated[tuple[str, ...], says("Runs that only this one avoids.")]
    private_ground: Annotated[
        PrivateGroundRecord | None, says("Only with --no-look.")
    ] = None


def build_compared(
    subject: Evaluation,
    other: Evaluation,
    rule: AebRule,
    private_ground: PrivateGroundRecord | None = None,
) -> Compared:
    """Another layout next to the first one, on the same runs."""
    return Compared(
        name=other.layout.name,
        layout=build_unit_records(other.layout),
        cost_eur=price_eur(other),
        evaluation=build_evaluation_record(other, rule),
        runs_gained=_only_first(subject, other),
        runs_lost=_only_first(other, subject),
        private_ground=private_ground,
    )


class Difference(Record, frozen=True, kw_only=True):
    """Runs that only one of two layouts avoids, all units of each together."""

    first: Annotated[str, says("Name of the one layout.")]
    second: Annotated[str, says("Name of the other one.")]
    only_first: Annotated[
        tuple[str, ...], says("Runs that the first one alone avoids.")
    ]
    only_second: Annotated[
        tuple[str, ...], says("Runs that the second one alone avoids.")
    ]


def find_differences(evaluations: Mapping[str, Evaluation]) -> tuple[Difference, ...]:
    """Which runs only one of two layouts avoids, for any two.

    Evaluations by display name.
    """
    return tuple(
        Difference(
            first=first,
            second=second,
            only_first=_only_first(one, other),
            only_second=_only_first(other, one),
        )
        for (first, one), (second, other) in combinations(evaluations.items(), 2)
    )


def _only_first(one: Evaluation, other: Evaluation) -> tuple[str, ...]:
    """Runs that the first of two layouts avoids and the second one does not."""
    runs = np.array(one.axis.run_ids)
    return tuple(runs[one.headline.is_avoided & ~other.headline.is_avoided].tolist())


def words(name: str, compared: Sequence[Compared]) -> list[str]:
    """Numbers of runs that only one of two layouts avoids.

    The first layout against each other one.
    """
    return [
        tr(
            "{name} avoids {gained} that {other} does not, and {other} avoids "
            "{lost} that {name} does not",
            name=name,
            other=other.name,
            gained=len(other.runs_gained),
            lost=len(other.runs_lost),
        )
        for other in compared
    ]


def side_by_side_table(
    evaluations: Mapping[str, Evaluation],
    rule: AebRule,
    baselines: Baselines | None = None,
    existing: Collection[str] = (),
) -> Table:
    """A row per layout, of the VUT alone, and of random layouts.

    Units of `existing`, ids, are not paid for.
    """
    subject = next(iter(evaluations.values()))
    axis = subject.axis

    def of_verdict(verdict: Verdict, share: float) -> tuple[list[str], list[str]]:
        """Cells before and behind that of a failure."""
        avoided = tr("{n} of {all}", n=int(verdict.is_avoided.sum()), all=axis.n_runs)
        spare_s = margin_s(verdict, axis)[verdict.is_avoided & (axis.weight > 0.0)]
        behind = [
            number(float(spare_s.min()) if len(spare_s) else None),
            number(mean_impact_speed_kmh(verdict, axis), 1),
        ]
        return [percent(share), avoided], behind

    rows = []
    for name, item in evaluations.items():
        first, last = of_verdict(item.headline, headline_apr(item))
        to_buy = [unit for unit in item.layout.units if unit.id not in existing]
        money = localized(f"{sum(unit.sensor.price_eur for unit in to_buy):,.0f}")
        failed = percent(apr_one_failed(item, rule))
        rows.append(
            [
                layout_words(name),
                str(len(item.layout.units)),
                money,
                *first,
                failed,
                *last,
            ]
        )
    first, last = of_verdict(subject.vut, apr(subject.vut, axis))
    rows.append([tr("VUT alone"), NOTHING, NOTHING, *first, NOTHING, *last])
    random = None if baselines is None else baselines.random
    # What is known is the APR on the table alone.
    if random is not None:
        mean = percent(random.mean)
        head = tr("random: mean of {n}, on the detection table", n=random.layouts)
        rows.append([head, str(random.units), NOTHING, mean, *[NOTHING] * 4])
    columns = [
        tr("layout"),
        tr("units"),
        tr("units to buy (EUR)"),
        tr("APR"),
        tr("runs avoided"),
        tr("APR if the most needed unit fails"),
        tr("smallest time to spare (s)"),
        tr("mean speed at contact (km/h)"),
    ]
    return Table(
        caption=tr(
            "The layouts side by side, all units of each together, by the evaluator"
        ),
        columns=columns,
        rows=rows,
        numeric=range(1, len(columns)),
    )


def difference_rows(differences: Sequence[Difference]) -> list[list[str]]:
    """The runs themselves.

    A row for each layout that avoids any that another does not.
    """
    rows = []
    for pair in differences:
        rows.append((pair.first, pair.second, pair.only_first))
        rows.append((pair.second, pair.first, pair.only_second))
    return [
        [tr(a), tr(b), count_runs(len(runs)), ", ".join(runs)]
        for a, b, runs in rows
        if runs
    ]


def significance_table(sampled: SampledRecord) -> Table:
    """Every pair of layouts in the same sampled worlds.

    The one that avoids more comes first.
    """
    return tabulate(
        tr("Differences of the APR in the same {n} sampled worlds", n=sampled.samples),
        map(_better_first, sampled.pairs),
        {
            tr("layout"): lambda pair: tr(pair.first),
            tr("against"): lambda pair: tr(pair.second),
            tr("more in"): lambda pair: percent(pair.more_share),
            tr("the same in"): lambda pair: percent(pair.equal_share),
            tr("less in"): lambda pair: percent(pair.less_share),
            tr("mean difference (points)"): lambda pair: in_points(pair.mean),
            tr("95 % interval (points)"): lambda pair: tr(
                "{low} to {high}", low=in_points(pair.low), high=in_points(pair.high)
            ),
            tr("significant?"): lambda pair: (
                tr("no significant difference") if is_open(pair) else tr("yes")
            ),
        },
        numeric=range(2, 7),
    )


def _better_first(pair: SampledPairRecord) -> SampledPairRecord:
    """A pair the way round in which the mean difference is not negative."""
    if or_nan(pair.mean) >= 0.0:
        return pair
    names = {"first": pair.second, "second": pair.first}
    shares = {"more_share": pair.less_share, "less_share": pair.more_share}
    mean, low, high = (-or_nan(share) for share in (pair.mean, pair.high, pair.low))
    return msgspec.structs.replace(
        pair, mean=mean, low=low, high=high, **names, **shares
    )


def section(
    evaluations: Mapping[str, Evaluation],
    rule: AebRule,
    baselines: Baselines | None = None,
    sampled: SampledRecord | None = None,
    existing: Collection[str] = (),
) -> Section | None:
    """Layouts by display name side by side, the subject first.

    None where it stands alone. `existing` are ids of mounted units.
    """
    if len(evaluations) < 2:
        return None
    n_units = len(next(iter(evaluations.values())).layout.units)
    differences = find_differences(evaluations)
    rows = difference_rows(differences)
    sentences = baseline_words(baselines, n_units=n_units)
    blocks: list[Block] = [
        side_by_side_table(evaluations, rule, baselines, existing),
        _meaning(),
        *([Bullets(sentences)] if sentences else []),
        layouts_table(evaluations),
    ]
    if rows:
        differ = tr("Runs that only one of two layouts avoids")
        columns = [tr("avoided by"), tr("not by"), tr("how many"), tr("which")]
        table = Table(caption=differ, columns=columns, rows=rows, summary=differ)
        blocks.append(table)
    else:
        blocks.append(tr("All layouts avoid the same runs."))
    if sampled is not None and sampled.pairs:
        blocks += [
            Subheading(tr("Is the difference significant?")),
            tr(
                "The comparison is paired: all layouts face the same random draws,"
                " so the difference in each world counts, not the spread between"
                " worlds. Each interval holds by itself: one in twenty may miss the"
                " true difference."
            ),
            significance_table(sampled),
        ]
    return Section("comparison", tr("Side by side"), blocks)


def _meaning() -> str:
    """How speeds at contact are to be read."""
    return tr(
        "Mean speed at contact: the speed at which the VUT touches the road user"
        " although it brakes from the confirmation on, averaged over all runs by"
        " weight. Avoided runs count as 0."
    )
