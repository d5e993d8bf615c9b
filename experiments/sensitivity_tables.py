"""What if an assumption is wrong: as one plain object, in sentences, as tables of the report."""

from collections.abc import Mapping, Sequence
from typing import Any

from placement.outcomes import Outcome
from placement.sensitivity import Sensitivity

from .pictures import build_picture
from .sensitivity_figures import QUANTITIES, plot_sensitivity
from .sensitivity_words import TITLES, phrase, value_text
from .sentences import NOTHING, count_runs, number
from .tables import percent

_MAX_NAMED = 3
_SAME = 1.0e-9


def summarise_sensitivity(found: Sequence[Sensitivity]) -> dict[str, Any]:
    """What :func:`placement.sensitivity.find_sensitivity` found.

    Parameters
    ----------
    found : sequence of Sensitivity
        Of one layout, at least one.

    Returns
    -------
    summary : dict
        Ready for JSON; ratios are 0 .. 1. ``{"planned": {"apr", "apr_one_failed",
        "smallest_margin_s"}, "assumptions": [{"name", "planned_value", "reason", "is_ours",
        "left_out", "varied": [{"value", "apr", "apr_one_failed", "smallest_margin_s", "lost_runs":
        [id], "unmoved": [unit id]}]}]}``. A smallest margin of None: nothing is avoided, or chance
        decides, as where messages are lost.
    """
    return {
        "planned": _outcome_record(found[0].planned),
        "assumptions": [
            {
                "name": one.assumption.name,
                "planned_value": one.planned_value,
                "reason": one.assumption.reason,
                "is_ours": one.assumption.is_ours,
                "left_out": one.left_out,
                "varied": [
                    {
                        "value": varied.value,
                        **_outcome_record(varied.outcome),
                        "lost_runs": list(varied.lost_runs),
                        "unmoved": list(varied.unmoved),
                    }
                    for varied in one.varied
                ],
            }
            for one in found
        ],
    }


def _outcome_record(outcome: Outcome) -> dict[str, Any]:
    return {
        "apr": outcome.apr,
        "apr_one_failed": outcome.apr_one_failed,
        "smallest_margin_s": outcome.smallest_margin_s,
    }


def sensitivity_sentences(summary: Mapping[str, Any]) -> list[str]:
    """What the layout's worth hangs on, in sentences.

    Parameters
    ----------
    summary : mapping
        By :func:`summarise_sensitivity`.
    """
    planned = summary["planned"]
    varied = [one for one in summary["assumptions"] if one["varied"]]
    if not varied:
        return ["No assumption was varied."]
    worst = [(min(one["varied"], key=lambda value: value["apr"]), one) for one in varied]
    hits = sorted(
        (pair for pair in worst if pair[0]["apr"] < planned["apr"] - _SAME),
        key=lambda pair: pair[0]["apr"],
    )
    if not hits:
        sentences = [
            f"Of {_count(len(varied))} assumptions, varied one at a time, none lowers the APR "
            f"below the {percent(planned['apr'])} as planned."
        ]
    else:
        named = "; ".join(
            f"{phrase(one['name'], value['value'])} ({percent(value['apr'])})"
            for value, one in hits[:_MAX_NAMED]
        )
        lowers = "lowers" if len(hits) == 1 else "lower"
        most = f", most of all {named}" if len(hits) > _MAX_NAMED else f": {named}"
        sentences = [
            f"Of {_count(len(varied))} assumptions, varied one at a time, {_count(len(hits))} "
            f"{lowers} the APR of {percent(planned['apr'])} as planned{most}."
        ]
    tightest = _tightest(summary)
    if tightest is not None:
        value, one = tightest
        sentences.append(
            f"The smallest time to spare in the runs that are avoided, "
            f"{number(planned['smallest_margin_s'])} s as planned, shrinks most with "
            f"{phrase(one['name'], value['value'])}: to {number(value['smallest_margin_s'])} s."
        )
    stuck = sorted({unit for one in varied for value in one["varied"] for unit in value["unmoved"]})
    if stuck:
        sentences.append(
            "Left where they are, since they would be inside something: " + ", ".join(stuck) + "."
        )
    return sentences


def _tightest(summary: Mapping[str, Any]) -> tuple[Mapping[str, Any], Mapping[str, Any]] | None:
    """The value, and its assumption, with the least time to spare; None if none has less."""
    planned = summary["planned"]["smallest_margin_s"]
    pairs = [
        (value, one)
        for one in summary["assumptions"]
        for value in one["varied"]
        if value["smallest_margin_s"] is not None
    ]
    if planned is None or not pairs:
        return None
    value, one = min(pairs, key=lambda pair: float(pair[0]["smallest_margin_s"]))
    return (value, one) if value["smallest_margin_s"] < planned - _SAME else None


def sensitivity_table(summary: Mapping[str, Any]) -> dict[str, Any]:
    """A row for the plan, and one for every value of every assumption.

    Parameters
    ----------
    summary : mapping
        By :func:`summarise_sensitivity`.

    Returns
    -------
    table : dict
        Caption, columns and rows of text.
    """
    rows = [["all as planned", NOTHING, NOTHING, *_worth(summary["planned"], False), NOTHING]]
    for one in summary["assumptions"]:
        planned = one["planned_value"]
        before = NOTHING if planned is None else value_text(one["name"], planned)
        if not one["varied"]:
            rows.append([_title(one), before, one["left_out"], *[NOTHING] * 4])
        for value in one["varied"]:
            is_chance = one["name"] == "packet_loss"
            rows.append(
                [
                    _title(one),
                    before,
                    value_text(one["name"], value["value"]),
                    *_worth(value, is_chance),
                    str(len(value["lost_runs"])),
                ]
            )
    return {
        "caption": "One assumption at a time, all others as planned",
        "columns": [
            "assumption",
            "as planned",
            "instead",
            "APR",
            "APR if the most needed unit fails",
            "smallest time to spare (s)",
            "runs lost",
        ],
        "rows": rows,
    }


def _worth(value: Mapping[str, Any], is_chance: bool) -> list[str]:
    margin = value["smallest_margin_s"]
    return [
        percent(value["apr"]),
        percent(value["apr_one_failed"]),
        "by chance" if is_chance else number(margin),
    ]


def reason_rows(summary: Mapping[str, Any]) -> list[list[str]]:
    """Why each assumption is varied so far: name, reason, and who says so."""
    return [
        [_title(one), one["reason"], "our assumption" if one["is_ours"] else "source"]
        for one in summary["assumptions"]
    ]


def sensitivity_part(summary: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """What ``templates/sensitivity.html.j2`` shows.

    Parameters
    ----------
    summary : mapping or None
        By :func:`summarise_sensitivity`; None: nothing was varied.
    """
    if summary is None:
        return None
    figures = []
    for quantity, (words, _) in QUANTITIES.items():
        if any(one["varied"] for one in summary["assumptions"]):
            figures.append(
                build_picture(
                    plot_sensitivity(summary, quantity=quantity),
                    title=f"What moves the {words}",
                    caption="Plain bars to the right of the line: better than planned; hatched "
                    "ones to the left: worse. The values are those at the ends."
                    + _margin_note(quantity),
                    alt=_alt(summary, quantity, words),
                )
            )
    return {
        "sentences": sensitivity_sentences(summary),
        "figures": figures,
        "table": sensitivity_table(summary),
        "reasons": reason_rows(summary),
        "lost": lost_runs_rows(summary),
    }


def _margin_note(quantity: str) -> str:
    if quantity != "smallest_margin_s":
        return ""
    return " A star: runs are lost there, which no longer count, so that the rest looks better."


def _alt(summary: Mapping[str, Any], quantity: str, words: str) -> str:
    show = percent if quantity == "apr" else _seconds
    planned = summary["planned"][quantity]
    parts = []
    for one in summary["assumptions"]:
        values = [value for value in one["varied"] if value[quantity] is not None]
        if values:
            low = min(values, key=lambda value: float(value[quantity]))
            high = max(values, key=lambda value: float(value[quantity]))
            parts.append(f"{_title(one)} {show(low[quantity])} to {show(high[quantity])}")
    shown = NOTHING if planned is None else show(planned)
    return f"Bars of the {words}, {shown} as planned. " + "; ".join(parts) + "."


def _seconds(value_s: float) -> str:
    return f"{number(value_s)} s"


def _title(one: Mapping[str, Any]) -> str:
    return TITLES[one["name"]]


def _count(n: int) -> str:
    return "one" if n == 1 else str(n)


def lost_runs_rows(summary: Mapping[str, Any]) -> list[list[str]]:
    """Which runs each value loses: a row for each that loses any, for the details of the report."""
    return [
        [
            phrase(one["name"], value["value"]),
            count_runs(len(value["lost_runs"])),
            ", ".join(value["lost_runs"]),
        ]
        for one in summary["assumptions"]
        for value in one["varied"]
        if value["lost_runs"]
    ]
