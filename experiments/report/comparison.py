"""Layouts side by side: their worth, the runs on which they differ, how sure the difference is."""

from collections.abc import Mapping, Sequence
from typing import Any

from placement.evaluation import Evaluation

from ..results.numbers import NOTHING, count_runs, number, percent
from ..results.record import to_plain
from ..results.result import build_difference_records
from ..results.tables import margin_s
from .pictures import build_picture
from .sampled_worlds import plot_differences

_MAX_DRAWN_PAIRS = 28  # of eight layouts; the table has all
_MAX_SENTENCES = 6


def side_by_side_table(
    summary: Mapping[str, Any], evaluations: Mapping[str, Evaluation]
) -> dict[str, Any]:
    """A row per layout.

    Parameters
    ----------
    summary : mapping
        By :func:`.summarise_comparison`.
    evaluations : mapping of str to Evaluation
        By display name; the first one is the subject, the others are those compared, in order.

    Returns
    -------
    table : dict
        Caption, columns and rows.
    """
    records = [summary, *summary["compared"]]
    return {
        "caption": "The layouts side by side, all units of each together",
        "columns": [
            "layout",
            "units",
            "cost of the units (EUR)",
            "APR",
            "runs avoided",
            "APR if the most needed unit fails",
            "smallest time to spare (s)",
        ],
        "rows": [
            [
                name,
                str(len(item.layout.units)),
                f"{record['cost_eur']:,.0f}",
                percent(record["evaluation"]["rsu_all"]["all"]),
                f"{int(item.rsu_all.is_avoided.sum())} of {item.axis.n_runs}",
                percent(record["evaluation"]["apr_without_worst_unit"]),
                number(_smallest_margin_s(item)),
            ]
            for (name, item), record in zip(evaluations.items(), records, strict=True)
        ],
    }


def _smallest_margin_s(evaluation: Evaluation) -> float | None:
    """Least time to spare in the runs that are avoided and count; None if there is none."""
    verdict, axis = evaluation.rsu_all, evaluation.axis
    margin = margin_s(verdict, axis)[verdict.is_avoided & (axis.weight > 0.0)]
    return float(margin.min()) if len(margin) else None


def difference_matrix(
    names: Sequence[str], differences: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """How many runs the layout of a row avoids and that of a column does not.

    Parameters
    ----------
    names : sequence of str
        Of the layouts.
    differences : sequence of mapping
        By :func:`summarise_differences`.

    Returns
    -------
    table : dict
        Caption, columns and rows; a dash on the diagonal.
    """
    only: dict[tuple[str, str], int] = {}
    for pair in differences:
        only[pair["first"], pair["second"]] = len(pair["only_first"])
        only[pair["second"], pair["first"]] = len(pair["only_second"])
    return {
        "caption": "Runs that the layout of the row avoids, and that of the column does not",
        "columns": ["avoided by", *(f"not by {name}" for name in names)],
        "rows": [
            [row, *(NOTHING if row == column else str(only[row, column]) for column in names)]
            for row in names
        ],
    }


def difference_rows(differences: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """The runs themselves: a row for each layout that avoids any that another does not."""
    return [
        [pair[ours], pair[theirs], count_runs(len(pair[only])), ", ".join(pair[only])]
        for pair in differences
        for ours, theirs, only in (
            ("first", "second", "only_first"),
            ("second", "first", "only_second"),
        )
        if pair[only]
    ]


# ---------------------------------------------------------------- in sampled worlds


def significance_table(sampled: Mapping[str, Any]) -> dict[str, Any]:
    """Every pair of layouts in the same sampled worlds: the one that avoids more comes first.

    Parameters
    ----------
    sampled : mapping
        By :func:`.summarise_uncertainty`.

    Returns
    -------
    table : dict
        Caption, columns and rows.
    """
    return {
        "caption": f"Differences of the APR in the same {sampled['samples']} sampled worlds",
        "columns": [
            "layout",
            "against",
            "more in",
            "the same in",
            "less in",
            "mean difference (points)",
            "95 % interval (points)",
            "is that sure?",
        ],
        "rows": [
            [
                pair["first"],
                pair["second"],
                percent(pair["more_share"]),
                percent(pair["equal_share"]),
                percent(pair["less_share"]),
                _points(pair["mean"]),
                f"{_points(pair['low'])} to {_points(pair['high'])}",
                "no sure difference" if _is_open(pair) else "yes",
            ]
            for pair in map(_better_first, sampled["pairs"])
        ],
    }


def significance_sentences(sampled: Mapping[str, Any]) -> list[str]:
    """The differences in words, the surest first, and how they are to be read.

    Parameters
    ----------
    sampled : mapping
        By :func:`.summarise_uncertainty`.
    """
    pairs = [_better_first(pair) for pair in sampled["pairs"]]
    sure = sorted((p for p in pairs if not _is_open(p)), key=lambda p: -abs(p["mean"]))
    sentences = [
        f"{pair['first']} prevents more accidents than {pair['second']} in "
        f"{percent(pair['more_share'])} of the worlds, "
        f"{_points(pair['mean'])} points on average (95 % interval "
        f"{_points(pair['low'])} to {_points(pair['high'])})."
        for pair in sure[:_MAX_SENTENCES]
    ]
    if len(sure) > _MAX_SENTENCES:
        sentences.append(f"So do {len(sure) - _MAX_SENTENCES} more pairs of the table.")
    n_open = len(pairs) - len(sure)
    if n_open == 1:
        (pair,) = (p for p in pairs if _is_open(p))
        sentences.append(
            f"Between {pair['first']} and {pair['second']} there is no sure difference (95 % "
            f"interval {_points(pair['low'])} to {_points(pair['high'])} points)."
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


def _better_first(pair: Mapping[str, Any]) -> dict[str, Any]:
    """A pair the way round in which the mean difference is not negative."""
    if pair["mean"] >= 0.0:
        return dict(pair)
    return {
        **pair,
        "first": pair["second"],
        "second": pair["first"],
        "mean": -pair["mean"],
        "low": -pair["high"],
        "high": -pair["low"],
        "more_share": pair["less_share"],
        "less_share": pair["more_share"],
    }


def _is_open(pair: Mapping[str, Any]) -> bool:
    return bool(pair["low"] <= 0.0 <= pair["high"])


def _points(share: float) -> str:
    return number(100.0 * share, 1)


# ---------------------------------------------------------------- for the template


def comparison_part(
    summary: Mapping[str, Any], evaluations: Mapping[str, Evaluation]
) -> dict[str, Any] | None:
    """What ``templates/comparison.html.j2`` shows; None where no layouts are compared.

    Parameters
    ----------
    summary : mapping
        By :func:`.summarise_comparison`, with "sampled" where worlds were
        sampled.
    evaluations : mapping of str to Evaluation
        By display name; the first one is the subject, the others are those compared, in order.
    """
    if "compared" not in summary:
        return None
    differences = [to_plain(pair) for pair in build_difference_records(evaluations)]  # border
    return {
        "table": side_by_side_table(summary, evaluations),
        "matrix": difference_matrix(list(evaluations), differences),
        "differences": difference_rows(differences),
        "sampled": _sampled_part(summary.get("sampled")),
    }


def _sampled_part(sampled: Mapping[str, Any] | None) -> dict[str, Any] | None:
    if sampled is None or not sampled["pairs"]:
        return None
    sentences, table = significance_sentences(sampled), significance_table(sampled)
    pairs = [_better_first(pair) for pair in sampled["pairs"]]
    figure = None
    if len(pairs) <= _MAX_DRAWN_PAIRS:
        figure = build_picture(
            plot_differences(pairs),
            title="Differences in sampled worlds",
            caption="Right of zero: the first one of the pair avoids more. An open dot: the "
            "interval holds zero.",
            alt="Dots with whiskers. "
            + "; ".join(
                f"{row[0]} minus {row[1]}: {row[5]}, {row[6]} points" for row in table["rows"]
            )
            + ".",
        )
    return {"sentences": sentences, "table": table, "figure": figure}
