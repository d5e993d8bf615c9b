"""The report's section on the decision to brake, with its figure."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from placement.sampling.uncertainty import BY_EYE, CALIBRATED

from ..figures.axes import UNIT_COLOURS, WIDTH_IN, finish_axes, literal, new_axes
from ..language import mark, tr
from ..results.numbers import layout_words, number, percent
from . import Part
from .decision import LIMITS, LOCATED_M, ONE_UNIT, DecisionRecord, LayoutDecision
from .section import Section, Table, build_picture

_MARKERS = "osD^v*"
_LINES = {CALIBRATED: "-", BY_EYE: "--"}
AIM_WORDS = {CALIBRATED: mark("calibrated"), BY_EYE: mark("by eye")}


def build_part(record: DecisionRecord) -> Part:
    """Words and table for a terminal."""
    return Part(
        title=tr("From detection to decision:"),
        words=words(record),
        table=table(record),
        notes=notes(record),
        is_short=True,
    )


def words(record: DecisionRecord) -> list[str]:
    """What the decision makes of the first layout."""
    first = record.layouts[0]
    sentences = [
        tr(
            "Road users are detected in time in {detected} of the runs. A car that "
            "braked for every detected person would also brake for {twins} of the "
            "people who stop short of its path or walk beside it.",
            detected=percent(first.detected),
            twins=percent(first.twins_detected),
        )
    ]
    for aimed, one in first.by_aim.items():
        sentences.append(
            tr(
                "A car that brakes at a probability of {threshold:g} or more avoids "
                "{avoided} with aims known to {aim:g}° ({aimed}), and brakes for "
                "{braked} of these people.",
                threshold=record.rule["threshold"],
                avoided=percent(one.avoided),
                aim=one.pitch_sd_deg,
                aimed=tr(AIM_WORDS[aimed]),
                braked=percent(one.braked_for),
            )
        )
    sentences += _false_braking(record)
    return sentences


def _false_braking(record: DecisionRecord) -> list[str]:
    """How often a car brakes for nothing at all, where that is known."""
    by_layout = record.false_brakings_per_hour
    first = record.layouts[0].name
    if first not in by_layout:
        return [
            tr(
                "How often cars brake for false tracks is not known: the rate of this "
                "detector has not been measured."
            )
        ]
    value, low, high = by_layout[first]
    return [
        tr(
            "If a car is always near, it brakes {value} times an hour for false "
            "tracks (95 %: {low} to {high}; one sensor: {one} to {most}). This is "
            "the detector's rate of false tracks times the share that passed the "
            "decision on recordings ({braked} of {tracks}).",
            value=_rate(value),
            low=_rate(low),
            high=_rate(high),
            one=_rate(by_layout[ONE_UNIT][1]),
            most=_rate(by_layout[ONE_UNIT][2]),
            braked=record.rule["false_tracks_braked_for"],
            tracks=record.rule["false_tracks"],
        )
    ]


def _rate(per_hour: float) -> str:
    """A rate, with a decimal only where it is small."""
    if per_hour < 10.0:
        return number(per_hour, 1)
    return number(per_hour, 0)


def table(record: DecisionRecord) -> Table:
    """A row for each layout and way of aiming."""
    rows = []
    for layout in record.layouts:
        for one in layout.by_aim.values():
            best = [percent(rule.avoided) for rule in one.best]
            located = [percent(share) for share in one.located.values()]
            rows.append(
                [
                    layout_words(layout.name),
                    tr("{aim:g}°", aim=one.pitch_sd_deg),
                    percent(layout.detected),
                    percent(one.avoided),
                    percent(one.braked_for),
                    *best,
                    *located,
                ]
            )
    limits = [tr("at most {share}", share=percent(limit)) for limit in LIMITS]
    located = [tr("within {limit:.2f} m", limit=limit_m) for limit_m in LOCATED_M]
    columns = [
        "",
        tr("aims"),
        tr("detected"),
        tr("avoided"),
        tr("braked for"),
        *limits,
        *located,
    ]
    return Table(
        caption=tr("APR by detection and by decision"),
        columns=columns,
        rows=rows,
        numeric=range(2, len(columns)),
    )


def notes(record: DecisionRecord) -> list[str]:
    """How the table is to be read."""
    return [
        tr(
            "avoided, braked for: by the rule, with a reserve of {reserve:g} s and a "
            "probability of at least {threshold:g}; at most ..: avoided by the best "
            "rule that brakes for at most this share of the twins; within ..: runs "
            "whose impact is located within this distance at the last moment.",
            reserve=record.rule["reserve_s"],
            threshold=record.rule["threshold"],
        )
    ]


def plot_decisions(layouts: Sequence[LayoutDecision]) -> Axes:
    """Runs avoided against twins braked for, over the threshold, per layout."""
    axes = new_axes(WIDTH_IN, 4.2)
    for index, layout in enumerate(layouts):
        colour = UNIT_COLOURS[index % len(UNIT_COLOURS)]
        for aimed, one in layout.by_aim.items():
            braked, avoided = 100.0 * np.array(one.curve).T
            name = literal(f"{layout_words(layout.name)}, {tr(AIM_WORDS[aimed])}")
            axes.plot(
                braked,
                avoided,
                linestyle=_LINES[aimed],
                color=colour,
                lw=1.4,
                label=name,
                gid=f"{layout.name} {aimed}",
            )
            # The rule's own threshold.
            axes.plot(
                100.0 * one.braked_for,
                100.0 * one.avoided,
                marker=_MARKERS[index % len(_MARKERS)],
                color=colour,
                markersize=5,
            )
    axes.set_xlim(0.0, 50.0)
    axes.set_ylim(0.0, 100.0)
    axes.legend(fontsize=7, frameon=False, loc="lower right")
    x = tr("twins braked for (%)")
    y = tr("runs avoided (%)")
    finish_axes(axes, x=x, y=y, grid="both")
    return axes


def build_section(record: DecisionRecord) -> Section:
    """Words, table and figure."""
    picture = build_picture(
        plot_decisions(record.layouts),
        title=tr("Avoided runs versus false braking"),
        caption=tr(
            "Each line shows one layout at all thresholds; the mark is at the rule's "
            "threshold. Up and to the left is better."
        ),
        alt=tr("Runs avoided versus twins braked for, one line per layout."),
    )
    how = tr(
        "A detection is not a decision: people stand at kerbs, stop and walk "
        "beside the road. Here the car brakes if the reported position and "
        "motion indicate that the paths cross. Twins are the same encounters "
        "without a collision: a person who would cross stops one metre short of "
        "the car's path; a person who would walk along it walks beside it. "
        "Tracks come from a Kalman filter with constant velocity; errors of "
        "positions, aims and the car's own position are drawn at random."
    )
    return Section(
        "decision",
        tr("From detection to decision"),
        [how, *words(record), table(record), *notes(record), picture],
    )
