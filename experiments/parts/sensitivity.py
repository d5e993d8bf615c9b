"""Sensitivity to assumptions ("what if"): in tables, a figure, and as a section."""

from operator import attrgetter
from typing import NamedTuple

from matplotlib.axes import Axes

from placement.explain.sensitivity import Sensitivity, Varied, VariedAssumption, Worth

from ..figures.axes import BLUE, VERMILION, WIDTH_IN, finish_axes, new_axes, write_beside
from ..results.numbers import NOTHING, count_runs, number, or_nan, percent
from .section import Block, Section, Table, build_picture

# ---------- assumptions and their values in words, for tables and figures alike


class _Words(NamedTuple):
    """An assumption: its title, a phrase about its value, and the unit that this is shown in."""

    title: str
    phrase: str
    unit: str = ""
    scale: float = 1.0  # of these units in one of ours


WORDS = {
    "latency_s": _Words("end-to-end latency", "an end-to-end latency of {}", " ms", 1000.0),
    "n_confirmations": _Words("frames that confirm", "{} frames that confirm"),
    "track_memory_s": _Words("memory of tracks", "tracks kept {} without detections", " s"),
    "deceleration_mps2": _Words("deceleration", "a deceleration of {}", " m/s\N{SUPERSCRIPT TWO}"),
    "packet_loss": _Words("messages lost", "{} of the messages lost", " %", 100.0),
    "min_box_height_share": _Words(
        "detector's smallest box",
        "a detector whose smallest box is {} of the plan's",
        " %",
        100.0,
    ),
    "min_iou": _Words("overlap (IoU) it needs", "a detector that needs an overlap (IoU) of {}"),
    "yaw_deg": _Words("all units turned", "all units turned by {}", "\N{DEGREE SIGN}"),
    "pitch_deg": _Words("all units tilted", "all units tilted by {}", "\N{DEGREE SIGN}"),
    "height_m": _Words("all units lifted", "all units lifted by {}", " cm", 100.0),
    "position_m": _Words("all units moved ahead", "all units moved ahead by {}", " cm", 100.0),
}
_SIGNED = ("yaw_deg", "pitch_deg", "height_m", "position_m")
_MINUS = "\N{MINUS SIGN}"


def value_text(name: str, value: float | None) -> str:
    """A value of an assumption, with its unit; None: infinite.

    Examples
    --------
    >>> value_text("latency_s", 0.3), value_text("packet_loss", 0.05), value_text("height_m", 0.25)
    ('300 ms', '5 %', '+25 cm')
    """
    if value is None:
        return "for ever"
    words = WORDS[name]
    shown = f"{words.scale * abs(value):g}{words.unit}"
    if name not in _SIGNED or value == 0.0:
        return shown
    return f"{'+' if value > 0.0 else _MINUS}{shown}"


def phrase(name: str, value: float | None) -> str:
    """An assumption with a value, as part of a sentence.

    Examples
    --------
    >>> phrase("latency_s", 0.3)
    'an end-to-end latency of 300 ms'
    """
    return WORDS[name].phrase.format(value_text(name, value))


# ---------- the figure, a tornado: how far each assumption moves a layout's worth, the most on top


_NOTHING_MOVES = 1.0e-9
_LEAST_SPAN = 2.0  # points of APR, so that nothing tiny fills the figure
_ROOM = 0.22  # for the values next to the bars, of the span


def plot_sensitivity(found: Sensitivity) -> Axes:
    """A bar for each assumption, from the worst to the best APR that its values lead to.

    Worse than planned: to the left of the line, hatched; better: to the right, plain. The values
    stand at the ends of the bars. What moves nothing has no bar.
    """
    planned = 100.0 * or_nan(found.planned.apr)
    rows = [one for one in found.assumptions if one.varied]
    ends = {one.name: _ends(one) for one in rows}
    # The widest on top; where nothing is known, at the bottom.
    rows.sort(key=lambda one: _span(ends[one.name], planned))
    axes = new_axes(WIDTH_IN, 0.9 + 0.3 * max(len(rows), 1))
    for row, one in enumerate(rows):
        _draw_row(axes, row, one.name, ends[one.name], planned)
    axes.axvline(planned, color="black", linewidth=1.2, zorder=4, gid="planned")
    axes.set_yticks(range(len(rows)), [WORDS[one.name].title for one in rows], fontsize=8)
    axes.set_ylim(-0.6, len(rows) - 0.4)
    reached = [planned, *(end[0] for pair in ends.values() for end in pair)]
    span = max(max(reached) - min(reached), _LEAST_SPAN)
    axes.set_xlim(min(reached) - _ROOM * span, max(reached) + _ROOM * span)
    axes.tick_params(axis="y", length=0)
    finish_axes(
        axes,
        x="share of the runs avoided, APR (%); line: as planned",
        grid="x",
        hidden=("top", "right", "left"),
    )
    return axes


def _ends(one: VariedAssumption) -> list[tuple[float, str]]:
    """The worst and the best APR of an assumption's values, with what they are; none if unknown."""
    return [
        (100.0 * or_nan(value.apr), value_text(one.name, value.value))
        for value in _worst_and_best(one)
    ]


def _worst_and_best(one: VariedAssumption) -> list[Varied]:
    """The values that lead to the least and to the highest APR; none where that is not known."""
    known = [value for value in one.varied if value.apr is not None]
    by_apr = attrgetter("apr")
    return [min(known, key=by_apr), max(known, key=by_apr)] if known else []


def _span(ends: list[tuple[float, str]], planned: float) -> float:
    if not ends:
        return -1.0
    return max(ends[1][0], planned) - min(ends[0][0], planned)


def _draw_row(
    axes: Axes, row: int, name: str, ends: list[tuple[float, str]], planned: float
) -> None:
    if not ends:
        _note(axes, planned, row, "nothing avoided")
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
    away, ha = (-4.0, "right") if side == "left" else (4.0, "left")
    write_beside(axes, text, (x, row), away_pt=(away, 0.0), ha=ha)


def _note(axes: Axes, planned: float, row: int, text: str) -> None:
    write_beside(axes, text, (planned, row), away_pt=(5.0, 0.0), fontsize=7, color="#555555")


# ---------- tables, and the section of the report


def sensitivity_table(found: Sensitivity) -> Table:
    """A row for the plan, and one for every value of every assumption."""
    rows = [["all as planned", NOTHING, NOTHING, *_worth(found.planned, False), NOTHING]]
    for one in found.assumptions:
        has_none = one.planned_value is None and one.name != "track_memory_s"
        before = NOTHING if has_none else value_text(one.name, one.planned_value)
        if not one.varied:
            rows.append([_title(one), before, one.left_out, *[NOTHING] * 4])
        for value in one.varied:
            is_chance = one.name == "packet_loss"
            rows.append(
                [
                    _title(one),
                    before,
                    value_text(one.name, value.value),
                    *_worth(value, is_chance),
                    str(len(value.lost_runs)),
                ]
            )
    return Table(
        caption="One assumption at a time, all others as planned",
        columns=[
            "assumption",
            "as planned",
            "instead",
            "APR",
            "APR if the most needed unit fails",
            "smallest time to spare (s)",
            "runs lost",
        ],
        rows=rows,
        numeric=range(3, 7),
    )


def _worth(value: Worth, is_chance: bool) -> list[str]:
    margin = "by chance" if is_chance else number(value.smallest_margin_s)
    return [percent(value.apr), percent(value.apr_one_failed), margin]


def reason_rows(found: Sensitivity) -> list[list[str]]:
    """Why each assumption is varied so far: name, reason, and who says so."""
    return [
        [_title(one), one.reason, "our assumption" if one.is_ours else "source"]
        for one in found.assumptions
    ]


def sensitivity_section(found: Sensitivity | None) -> Section | None:
    """What becomes of the layout if an assumption is wrong; None where nothing was varied."""
    if not found:
        return None
    blocks: list[Block] = []
    if any(one.varied for one in found.assumptions):
        blocks.append(
            build_picture(
                plot_sensitivity(found),
                title="What moves the share of the runs avoided (APR)",
                caption="Plain bars to the right of the line: better than planned; hatched "
                "ones to the left: worse. The values are those at the ends.",
                alt=_alt(found),
            )
        )
    stuck = {unit for one in found.assumptions for value in one.varied for unit in value.unmoved}
    if stuck:
        blocks.append(
            "Left where they are, since they would be inside something: "
            f"{', '.join(sorted(stuck))}."
        )
    blocks += [
        sensitivity_table(found),
        "On the detection table of these units, on which no message is lost. Mounting errors are "
        "common to all units: each is turned (counter-clockwise), tilted (up), lifted or moved "
        "ahead alike. Where messages are lost, shares are expected values, and a run counts as "
        "lost if it is avoided in less than 99 % of the drives. The smallest time to spare is that "
        "of the runs still avoided: a run that is lost no longer counts. Units with a latency of "
        "their own keep it.",
    ]
    lost = lost_runs_rows(found)
    if lost:
        blocks.append(
            Table(
                caption="Runs that are avoided as planned, and then no longer",
                columns=["if", "how many", "which"],
                rows=lost,
                summary="Which runs are lost",
            )
        )
    blocks.append(
        Table(
            caption="How far each assumption is varied, and why",
            columns=["assumption", "reason", "whose"],
            rows=reason_rows(found),
            summary="Why these values",
        )
    )
    return Section("sensitivity", "What if an assumption is wrong?", blocks)


def _alt(found: Sensitivity) -> str:
    parts = [
        f"{_title(one)} {percent(ends[0].apr)} to {percent(ends[1].apr)}"
        for one in found.assumptions
        if (ends := _worst_and_best(one))
    ]
    return f"Bars of the APR, {percent(found.planned.apr)} as planned. " + "; ".join(parts) + "."


def _title(one: VariedAssumption) -> str:
    return WORDS[one.name].title


def lost_runs_rows(found: Sensitivity) -> list[list[str]]:
    """Runs that each value loses: a row for each value that loses any."""
    return [
        [
            phrase(one.name, value.value),
            count_runs(len(value.lost_runs)),
            ", ".join(value.lost_runs),
        ]
        for one in found.assumptions
        for value in one.varied
        if value.lost_runs
    ]
