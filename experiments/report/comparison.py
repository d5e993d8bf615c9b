"""Layouts side by side: their worth, the runs on which they differ, how sure the difference is."""

from collections.abc import Mapping, Sequence

import msgspec
from msgspec import UnsetType

from placement.evaluation import Evaluation, apr

from ..parts.sampled_worlds import is_open, plot_differences
from ..parts.section import Block, Bullets, Section, Subheading, Table, build_picture
from ..results.baselines import StudyCasesRecord
from ..results.evaluations import DifferenceRecord, build_difference_records
from ..results.numbers import NOTHING, count_runs, number, or_nan, percent, several
from ..results.result import Result
from ..results.sampled_worlds import SampledPairRecord, SampledRecord
from ..results.tables import margin_s

GREEDY, EXPERT = "greedy", "expert rule"
"""Display names of layouts to compare with: they appear in tables and bars only."""

_MAX_DRAWN_PAIRS = 28  # of eight layouts; the table has all
_MAX_SENTENCES = 6


def side_by_side_table(result: Result, evaluations: Mapping[str, Evaluation]) -> Table:
    """A row per layout, by display name, and one of what random layouts prevent.

    Those that a result found or was asked about have their APR in it, and so has the expert's.
    """
    return Table(
        caption="The layouts side by side, all units of each together, by the evaluator",
        columns=[
            "layout",
            "units",
            "cost of the units (EUR)",
            "APR",
            "runs avoided",
            "APR if the most needed unit fails",
            "smallest time to spare (s)",
        ],
        rows=[
            [
                name,
                str(len(item.layout.units)),
                f"{sum(unit.sensor.price_eur for unit in item.layout.units):,.0f}",
                percent(apr(item.rsu_all, item.axis)),
                f"{int(item.rsu_all.is_avoided.sum())} of {item.axis.n_runs}",
                percent(_apr_one_failed(result, name)),
                number(_smallest_margin_s(item)),
            ]
            for name, item in evaluations.items()
        ]
        + _random_rows(result),
        numeric=range(1, 7),
    )


def _random_rows(result: Result) -> list[list[str]]:
    """The row of random layouts, whose APR is known on the detection table alone; or none."""
    random = result.baselines.random if result.baselines else None
    if random is None:
        return []
    name = f"random: mean of {random.layouts}, on the detection table"
    return [[name, str(random.units), NOTHING, percent(random.mean), NOTHING, NOTHING, NOTHING]]


def _apr_one_failed(result: Result, name: str) -> float | None:
    """APR of a layout, by its display name, if the unit that is needed most fails."""
    expert = result.baselines.expert if result.baselines else None
    if name == EXPERT and expert is not None:
        return expert.apr_without_worst_unit
    if name == GREEDY and result.greedy:
        return result.greedy.apr_without_worst_unit
    records = {other.name: other.evaluation for other in result.compared or ()}
    if result.baseline_name and result.baseline is not None:
        records.setdefault(result.baseline_name, result.baseline)
    return records.get(name, result.evaluation).apr_without_worst_unit


def baseline_sentences(result: Result) -> list[str]:
    """What layouts prevent that need no optimiser: random ones, and an expert's rule of thumb."""
    if not result.baselines:
        return []
    sentences = []
    random, expert = result.baselines.random, result.baselines.expert
    if random is not None:
        found = f" (the layout found: {percent(result.apr)})" if result.stages else ""
        sentences.append(
            f"Random: {random.layouts} layouts of {several(random.units, 'pose', 'poses')} drawn "
            f"within the same limits have a mean APR of {percent(random.mean)} on the detection "
            f"table{found}; 5 % of them have no more than {percent(random.low)}, 5 % no less than "
            f"{percent(random.high)}."
        )
    if random is not None and random.in_worlds:
        worlds = random.in_worlds
        sentences.append(
            f"Over the {worlds.worlds} sampled worlds that the layout was chosen in, their mean is "
            f"{percent(worlds.mean)} (95 % interval {percent(worlds.low)} to "
            f"{percent(worlds.high)})."
        )
    if expert is not None:
        corners = ", ".join(expert.corners)
        sentences.append(
            f"Expert rule: at each corner of the junction the nearest site, there the pose that "
            f"looks at the middle the most directly; the corner whose camera prevents the most "
            f"comes first ({corners or 'no corner fits'}). {percent(expert.on_table)} on the "
            f"detection table, {percent(expert.score.all)} by the evaluator."
        )
        n_wanted = len(result.layout)
        if len(expert.layout) < n_wanted:
            sentences.append(
                f"The expert's layout has {several(len(expert.layout), 'unit', 'units')}, not "
                f"{n_wanted}: the rule knows one for each corner that fits."
            )
    return sentences


def _smallest_margin_s(evaluation: Evaluation) -> float | None:
    """Least time to spare in the runs that are avoided and count; None if there is none."""
    verdict, axis = evaluation.rsu_all, evaluation.axis
    margin = margin_s(verdict, axis)[verdict.is_avoided & (axis.weight > 0.0)]
    return float(margin.min()) if len(margin) else None


def difference_matrix(names: Sequence[str], differences: Sequence[DifferenceRecord]) -> Table:
    """How many runs the layout of a row avoids and that of a column does not."""
    only: dict[tuple[str, str], int] = {}
    for pair in differences:
        only[pair.first, pair.second] = len(pair.only_first)
        only[pair.second, pair.first] = len(pair.only_second)
    return Table(
        caption="Runs that the layout of the row avoids, and that of the column does not",
        columns=["avoided by", *(f"not by {name}" for name in names)],
        rows=[
            [row, *(NOTHING if row == column else str(only[row, column]) for column in names)]
            for row in names
        ],
        numeric=range(1, len(names) + 1),
    )


def difference_rows(differences: Sequence[DifferenceRecord]) -> list[list[str]]:
    """The runs themselves: a row for each layout that avoids any that another does not."""
    return [
        [ours, theirs, count_runs(len(runs)), ", ".join(runs)]
        for pair in differences
        for ours, theirs, runs in (
            (pair.first, pair.second, pair.only_first),
            (pair.second, pair.first, pair.only_second),
        )
        if runs
    ]


# ---------- in sampled worlds


def significance_table(sampled: SampledRecord) -> Table:
    """Every pair of layouts in the same sampled worlds: the one that avoids more comes first."""
    return Table(
        caption=f"Differences of the APR in the same {sampled.samples} sampled worlds",
        columns=[
            "layout",
            "against",
            "more in",
            "the same in",
            "less in",
            "mean difference (points)",
            "95 % interval (points)",
            "is that sure?",
        ],
        rows=[
            [
                pair.first,
                pair.second,
                percent(pair.more_share),
                percent(pair.equal_share),
                percent(pair.less_share),
                _points(pair.mean),
                f"{_points(pair.low)} to {_points(pair.high)}",
                "no sure difference" if is_open(pair) else "yes",
            ]
            for pair in map(_better_first, sampled.pairs)
        ],
        numeric=range(2, 7),
    )


def significance_sentences(sampled: SampledRecord) -> list[str]:
    """The differences in words, the largest sure one first, and how they are to be read."""
    pairs = [_better_first(pair) for pair in sampled.pairs]
    sure = sorted((p for p in pairs if not is_open(p)), key=lambda p: -abs(or_nan(p.mean)))
    sentences = [
        f"{pair.first} prevents more accidents than {pair.second} in "
        f"{percent(pair.more_share)} of the worlds, "
        f"{_points(pair.mean)} points on average (95 % interval "
        f"{_points(pair.low)} to {_points(pair.high)})."
        for pair in sure[:_MAX_SENTENCES]
    ]
    if len(sure) > _MAX_SENTENCES:
        sentences.append(f"So do {len(sure) - _MAX_SENTENCES} more pairs of the table.")
    n_open = len(pairs) - len(sure)
    if n_open == 1:
        (pair,) = (p for p in pairs if is_open(p))
        sentences.append(
            f"Between {pair.first} and {pair.second} there is no sure difference (95 % "
            f"interval {_points(pair.low)} to {_points(pair.high)} points)."
        )
    elif n_open:
        sentences.append(f"Between the layouts of {n_open} pairs there is no sure difference.")
    sentences.append(
        "Paired on the same worlds: what is drawn hits all layouts alike, so that the difference "
        "in each world counts, not the spread between worlds."
    )
    if len(pairs) > 1:
        sentences.append(
            "Each interval holds by itself: of twenty such, one may miss the true difference."
        )
    return sentences


def _better_first(pair: SampledPairRecord) -> SampledPairRecord:
    """A pair the way round in which the mean difference is not negative."""
    if or_nan(pair.mean) >= 0.0:
        return pair
    return msgspec.structs.replace(
        pair,
        first=pair.second,
        second=pair.first,
        mean=-or_nan(pair.mean),
        low=-or_nan(pair.high),
        high=-or_nan(pair.low),
        more_share=pair.less_share,
        less_share=pair.more_share,
    )


def _points(share: float | None) -> str:
    return number(100.0 * or_nan(share), 1)


# ---------- the section of the report


def comparison_section(result: Result, evaluations: Mapping[str, Evaluation]) -> Section | None:
    """Layouts by display name side by side, the result's first; None where it stands alone."""
    if len(evaluations) < 2:
        return None
    differences = build_difference_records(evaluations)
    rows = difference_rows(differences)
    sentences = baseline_sentences(result)
    blocks: list[Block] = [
        side_by_side_table(result, evaluations),
        *([Bullets(sentences)] if sentences else []),
        Subheading("Which runs differ"),
        difference_matrix(list(evaluations), differences),
    ]
    if rows:
        blocks.append(
            Table(
                caption="Runs that only one of two layouts avoids",
                columns=["avoided by", "not by", "how many", "which"],
                rows=rows,
                summary="The runs themselves",
            )
        )
    else:
        blocks.append("All layouts avoid the same runs.")
    if result.sampled and result.sampled.pairs:
        blocks += _sampled_blocks(result.sampled)
    return Section("comparison", "Side by side", blocks)


def _sampled_blocks(sampled: SampledRecord) -> list[Block]:
    table = significance_table(sampled)
    blocks: list[Block] = [
        Subheading("Is the difference sure?"),
        Bullets(significance_sentences(sampled)),
    ]
    if len(sampled.pairs) <= _MAX_DRAWN_PAIRS:
        blocks.append(
            build_picture(
                plot_differences([_better_first(pair) for pair in sampled.pairs]),
                title="Differences in sampled worlds",
                caption="Right of zero: the first one of the pair avoids more. An open dot: the "
                "interval holds zero.",
                alt="Dots with whiskers. "
                + "; ".join(
                    f"{row[0]} minus {row[1]}: {row[5]}, {row[6]} points" for row in table.rows
                )
                + ".",
            )
        )
    return [*blocks, table]


# ---------- the study's cases, beside the question that was asked


def study_cases_section(record: StudyCasesRecord | UnsetType) -> Section | None:
    """The layouts on the study's cases; None where these are what was asked about."""
    if not record:
        return None
    return Section(
        "study-cases", "On the study's cases", [STUDY_CASES_NOTE, study_cases_table(record)]
    )


STUDY_CASES_NOTE = (
    "What the CarlaNCAP study drives, as it reads it: its cases by day, each at its one place, "
    "every run alike, and a track that is confirmed once lives for ever. All else is as in the "
    "question above. By the evaluator; layouts were not chosen for these runs."
)


def study_cases_table(record: StudyCasesRecord) -> Table:
    """APR of each layout and of the car by itself: a row for all runs, and for each case."""
    cases = list(record.parties[0].by_case)
    return Table(
        caption=f"APR on the study's {count_runs(record.runs)}",
        columns=["case", *(party.name for party in record.parties)],
        rows=[
            ["all runs", *(percent(party.all) for party in record.parties)],
            [
                "runs avoided",
                *(f"{party.runs_avoided} of {record.runs}" for party in record.parties),
            ],
            *(
                [case, *(percent(party.by_case[case]) for party in record.parties)]
                for case in cases
            ),
        ],
        numeric=range(1, 1 + len(record.parties)),
    )
