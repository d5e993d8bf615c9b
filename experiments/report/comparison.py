"""Layouts side by side: their worth, the runs on which they differ, how sure the difference is."""

from collections.abc import Mapping, Sequence

import msgspec

from placement.evaluation import Evaluation

from ..results.numbers import NOTHING, count_runs, number, or_nan, percent
from ..results.result import DifferenceRecord, Result, build_difference_records
from ..results.sampled_worlds import SampledPairRecord, SampledRecord
from ..results.tables import margin_s
from .sampled_worlds import is_open, plot_differences
from .section import Block, Bullets, Section, Subheading, Table, build_picture

_MAX_DRAWN_PAIRS = 28  # of eight layouts; the table has all
_MAX_SENTENCES = 6


def side_by_side_table(result: Result, evaluations: Mapping[str, Evaluation]) -> Table:
    """A row per layout; the first evaluation is the result's, then those compared, in order."""
    costs = [(result.cost_eur, result.evaluation)]
    costs += [(other.cost_eur, other.evaluation) for other in result.compared or ()]
    return Table(
        caption="The layouts side by side, all units of each together",
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
                f"{cost_eur:,.0f}",
                percent(shares.rsu_all.all),
                f"{int(item.rsu_all.is_avoided.sum())} of {item.axis.n_runs}",
                percent(shares.apr_without_worst_unit),
                number(_smallest_margin_s(item)),
            ]
            for (name, item), (cost_eur, shares) in zip(evaluations.items(), costs, strict=True)
        ],
        numeric=range(1, 7),
    )


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
    """Layouts side by side; None where none are compared.

    The first of the evaluations is the result's, the others are those compared, in order.
    """
    if not result.compared:
        return None
    differences = build_difference_records(evaluations)
    rows = difference_rows(differences)
    blocks: list[Block] = [
        side_by_side_table(result, evaluations),
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
