"""What if an assumption is wrong: as one plain object, in sentences, as tables of the report."""

from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes

from geometry.errors import InputError

from ..figures.axes import BLUE, VERMILION, WIDTH_IN, new_axes
from ..results.numbers import NOTHING, count_runs, number, percent
from .pictures import build_picture

# ---------- assumptions and their values in words, for tables and figures alike


TITLES = {
    "latency_s": "end-to-end latency",
    "n_confirmations": "frames that confirm",
    "deceleration_mps2": "deceleration",
    "packet_loss": "messages lost",
    "min_box_height_share": "detector's smallest box",
    "min_iou": "overlap (IoU) it needs",
    "yaw_deg": "all units turned",
    "pitch_deg": "all units tilted",
    "height_m": "all units lifted",
    "position_m": "all units moved ahead",
}
_PHRASES = {
    "latency_s": "an end-to-end latency of {}",
    "n_confirmations": "{} frames that confirm",
    "deceleration_mps2": "a deceleration of {}",
    "packet_loss": "{} of the messages lost",
    "min_box_height_share": "a detector whose smallest box is {} of the plan's",
    "min_iou": "a detector that needs an overlap (IoU) of {}",
    "yaw_deg": "all units turned by {}",
    "pitch_deg": "all units tilted by {}",
    "height_m": "all units lifted by {}",
    "position_m": "all units moved ahead by {}",
}
_MINUS = "\N{MINUS SIGN}"


def value_text(name: str, value: float) -> str:
    """A value of an assumption, with its unit.

    Parameters
    ----------
    name : str
        One of :data:`placement.explain.sensitivity.RANGES`.
    value : float
        In the unit that the name ends in.

    Examples
    --------
    >>> value_text("latency_s", 0.3), value_text("packet_loss", 0.05), value_text("height_m", 0.25)
    ('300 ms', '5 %', '+25 cm')
    """
    if name == "latency_s":
        return f"{1000.0 * value:g} ms"
    if name == "n_confirmations":
        return f"{value:g}"
    if name == "deceleration_mps2":
        return f"{value:g} m/s\N{SUPERSCRIPT TWO}"
    if name in ("packet_loss", "min_box_height_share"):
        return f"{100.0 * value:g} %"
    if name == "min_iou":
        return f"{value:g}"
    sign = "+" if value > 0.0 else _MINUS if value < 0.0 else ""
    if name in ("height_m", "position_m"):
        return f"{sign}{100.0 * abs(value):g} cm"
    return f"{sign}{abs(value):g}\N{DEGREE SIGN}"


def phrase(name: str, value: float) -> str:
    """An assumption with a value, as part of a sentence.

    Examples
    --------
    >>> phrase("latency_s", 0.3)
    'an end-to-end latency of 300 ms'
    """
    return _PHRASES[name].format(value_text(name, value))


# ---------- tornado: how far each assumption moves a layout's worth, the widest bar on top


# By name: in words, and how many of the axis' units one of ours is.
QUANTITIES = {
    "apr": ("share of the runs avoided (APR)", 100.0),
    "smallest_margin_s": ("smallest time to spare", 1.0),
}
_AXIS_LABELS = {
    "apr": "share of the runs avoided, APR (%)",
    "smallest_margin_s": "smallest time to spare in the runs that are avoided (s)",
}
_NOTHING_MOVES = 1.0e-9
_LEAST_SPAN = {"apr": 2.0, "smallest_margin_s": 0.2}  # so that nothing tiny fills the figure
_ROOM = 0.22  # for the values beside the bars, of the span


def plot_sensitivity(
    summary: Mapping[str, Any], *, quantity: str = "apr", axes: Axes | None = None
) -> Axes:
    """A bar for each assumption, from the worst to the best that its values lead to.

    Parameters
    ----------
    summary : mapping
        By :func:`experiments.report.sensitivity.summarise_sensitivity`.
    quantity : {"apr", "smallest_margin_s"}
        What is drawn.
    axes : Axes, optional
        Where to; by default in a figure of their own.

    Returns
    -------
    axes : Axes
        Worse than planned: to the left of the line, hatched; better: to the right, plain. The
        values stand at the ends of the bars. What moves nothing has no bar.

    Raises
    ------
    InputError
        There is no such quantity.
    """
    if quantity not in QUANTITIES:
        raise InputError("quantity", quantity, "one of " + ", ".join(QUANTITIES))
    scale = QUANTITIES[quantity][1]
    planned = scale * (summary["planned"][quantity] or 0.0)
    rows = [one for one in summary["assumptions"] if one["varied"]]
    ends = {one["name"]: _ends(one, quantity, scale) for one in rows}
    # The widest on top; where nothing is known, at the bottom.
    rows.sort(key=lambda one: _span(ends[one["name"]], planned))
    if axes is None:
        axes = new_axes(WIDTH_IN, 0.9 + 0.3 * max(len(rows), 1))
    for row, one in enumerate(rows):
        _draw_row(axes, row, one["name"], ends[one["name"]], planned)
    axes.axvline(planned, color="black", linewidth=1.2, zorder=4, gid="planned")
    axes.set_yticks(range(len(rows)), [TITLES[one["name"]] for one in rows], fontsize=8)
    axes.set_ylim(-0.6, len(rows) - 0.4)
    reached = [planned, *(end[0] for pair in ends.values() for end in pair)]
    span = max(max(reached) - min(reached), _LEAST_SPAN[quantity])
    axes.set_xlim(min(reached) - _ROOM * span, max(reached) + _ROOM * span)
    axes.set_xlabel(_AXIS_LABELS[quantity] + "; line: as planned", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    return axes


def _ends(one: Mapping[str, Any], quantity: str, scale: float) -> list[tuple[float, str]]:
    """The worst and the best of an assumption's values, with what they are; none if unknown."""
    known = [value for value in one["varied"] if value[quantity] is not None]
    if not known:
        return []
    worst = min(known, key=lambda value: float(value[quantity]))
    best = max(known, key=lambda value: float(value[quantity]))
    found = []
    for value in (worst, best):
        star = "*" if quantity != "apr" and value["lost_runs"] else ""
        found.append((scale * value[quantity], value_text(one["name"], value["value"]) + star))
    return found


def _span(ends: list[tuple[float, str]], planned: float) -> float:
    if not ends:
        return -1.0
    return max(ends[1][0], planned) - min(ends[0][0], planned)


def _draw_row(
    axes: Axes, row: int, name: str, ends: list[tuple[float, str]], planned: float
) -> None:
    if not ends:
        _note(axes, planned, row, "left to chance" if name == "packet_loss" else "nothing avoided")
        return
    (worst, worst_text), (best, best_text) = ends
    if best - planned <= _NOTHING_MOVES and planned - worst <= _NOTHING_MOVES:
        _note(axes, planned, row, "no change")
        return
    if worst < planned - _NOTHING_MOVES:
        axes.barh(
            row, planned - worst, left=worst, height=0.62, facecolor=VERMILION, edgecolor="black",
            linewidth=0.6, hatch="////", gid=f"{name} worse",
        )  # fmt: skip
        _label(axes, worst, row, worst_text, side="left")
    if best > planned + _NOTHING_MOVES:
        axes.barh(
            row, best - planned, left=planned, height=0.62, facecolor=BLUE, edgecolor="black",
            linewidth=0.6, gid=f"{name} better",
        )  # fmt: skip
        _label(axes, best, row, best_text, side="right")


def _label(axes: Axes, x: float, row: int, text: str, *, side: str) -> None:
    is_left = side == "left"
    axes.annotate(
        text,
        (x, row),
        xytext=(-4.0 if is_left else 4.0, 0.0),
        textcoords="offset points",
        ha="right" if is_left else "left",
        va="center",
        fontsize=8,
    )


def _note(axes: Axes, planned: float, row: int, text: str) -> None:
    axes.annotate(
        text,
        (planned, row),
        xytext=(5.0, 0.0),
        textcoords="offset points",
        va="center",
        fontsize=7,
        color="#555555",
    )


# ---------- what if an assumption is wrong


_MAX_NAMED = 3
_SAME = 1.0e-9


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
