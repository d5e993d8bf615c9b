"""Layouts by the decision to brake, next to their APR by detection."""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from matplotlib.axes import Axes

from placement.compute import Compute
from placement.decisions import Decided, LayoutDecisions, judge_decisions
from placement.evaluation import Evaluation
from placement.located import LocatedChoice
from placement.positions import BY_EYE, CALIBRATED, aim_sd_deg
from placement.setting import Setting
from scenarios.decision import load_decision_rule, rule_values

from ..figures.axes import UNIT_COLOURS, WIDTH_IN, finish_axes, literal, new_axes
from ..language import mark, tr
from ..results.numbers import layout_words, percent
from ..results.record import Record, Share, says
from .section import Section, Table, build_picture

LIMITS = (0.05, 0.10, 0.25)
"""Shares of the twins that a rule may brake for, where the best one is sought."""
LOCATED_M = (0.35, 0.40)
_N_THRESHOLDS = 51
_MARKERS = "osD^v*"
_LINES = {CALIBRATED: "-", BY_EYE: "--"}
_AIM_WORDS = {CALIBRATED: mark("calibrated"), BY_EYE: mark("by eye")}


class BestRule(Record, frozen=True, kw_only=True):
    """The rule that avoids most of those that brake for so many of the twins."""

    limit: Annotated[Share, says("Twins that it may brake for.")]
    avoided: Annotated[Share, says("Of the runs.")]
    reserve_s: Annotated[float, says("On top of the time to stop, in seconds.")]
    threshold: Annotated[float, says("Least probability of an overlap.")]


class AimedDecision(Record, frozen=True, kw_only=True):
    """What cars decide by a layout whose units are aimed in one way."""

    yaw_sd_deg: Annotated[float, says("Error of the bearing, in degrees.")]
    pitch_sd_deg: Annotated[float, says("Error of the tilt, in degrees.")]
    avoided: Annotated[Share, says("Of the runs, at the rule's threshold.")]
    braked_for: Annotated[
        Share, says("Of the twins whose road user stops or walks aside.")
    ]
    braked_for_others: Annotated[
        Share | None, says("Of the twins whose road user turns off; null: none does.")
    ]
    best: Annotated[
        tuple[BestRule, ...], says("The best of the rules that were tried.")
    ]
    located: Annotated[
        dict[str, Share],
        says(
            "Of the runs, at the last moment: the place of the impact across the car's"
            " way is known to so many metres, one standard deviation."
        ),
    ]
    curve: Annotated[
        tuple[tuple[Share, Share], ...],
        says("Twins braked for, and runs avoided, by rising threshold."),
    ]


class LayoutDecision(Record, frozen=True, kw_only=True):
    """A layout by detection and by decision."""

    name: Annotated[str, says("Display name.")]
    units: Annotated[int, says("Number of units.")]
    detected: Annotated[Share, says("APR by detection in time.")]
    twins_detected: Annotated[
        Share, says("Of the twins: confirmed, and on a way that might be the car's.")
    ]
    by_aim: Annotated[dict[str, AimedDecision], says("By how units are aimed.")]


class DecisionRecord(Record, frozen=True, kw_only=True):
    """Layouts by the decision to brake; only with --decision."""

    rule: Annotated[dict[str, float], says("See scenarios/data/decision.toml.")]
    layouts: Annotated[tuple[LayoutDecision, ...], says("The layouts.")]


def judge_by_decision(
    name_or_path: str,
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    compute: Compute,
) -> DecisionRecord | None:
    """Judge evaluations, by display name, by a rule. None: no rule is named.

    Raises InputError if the rule cannot be read or used.
    """
    if not name_or_path:
        return None
    rule = load_decision_rule(name_or_path)
    decisions = judge_decisions([*evaluations.values()], setting, rule, compute=compute)
    return DecisionRecord(
        rule=rule_values(rule),
        layouts=tuple(
            _build_layout(name, one, rule.reserve_s, rule.threshold)
            for name, one in zip(evaluations, decisions, strict=True)
        ),
    )


def _build_layout(
    name: str, decisions: LayoutDecisions, reserve_s: float, threshold: float
) -> LayoutDecision:
    return LayoutDecision(
        name=name,
        units=len(decisions.layout.units),
        detected=decisions.detected_apr,
        twins_detected=decisions.twins_detected,
        by_aim={
            aimed: build_aimed(decided, reserve_s, threshold)
            for aimed, decided in decisions.by_aim.items()
        },
    )


def build_aimed(decided: Decided, reserve_s: float, threshold: float) -> AimedDecision:
    """What a record has of decisions by a rule."""
    yaw_deg, pitch_deg = aim_sd_deg(decided.aimed)
    thresholds = np.linspace(0.0, 1.0, _N_THRESHOLDS)[1:-1].tolist()
    others = decided.braked_for(reserve_s, threshold, main=False)
    best = []
    for limit in LIMITS:
        avoided, of_reserve_s, of_threshold = decided.best_rule(limit)
        best.append(
            BestRule(
                limit=limit,
                avoided=avoided,
                reserve_s=of_reserve_s,
                threshold=of_threshold,
            )
        )
    return AimedDecision(
        yaw_sd_deg=yaw_deg,
        pitch_sd_deg=pitch_deg,
        avoided=decided.avoided(reserve_s, threshold),
        braked_for=decided.braked_for(reserve_s, threshold),
        braked_for_others=None if math.isnan(others) else others,
        best=tuple(best),
        located={f"{limit_m:.2f}": decided.located(limit_m) for limit_m in LOCATED_M},
        curve=tuple(
            (decided.braked_for(reserve_s, one), decided.avoided(reserve_s, one))
            for one in thresholds
        ),
    )


# ---------- words, table, figure
def located_words(choice: LocatedChoice | None) -> list[str]:
    """How many runs the chosen layout locates; none where that was not asked."""
    if choice is None:
        return []
    values = {
        "limit": choice.limit_m,
        "share": percent(choice.share),
        "before": percent(choice.share_before),
        "n": choice.n_judged,
    }
    if choice.share <= choice.share_before:
        return [
            tr(
                "With aims known to 1 degree, {share} of the runs are located within"
                " {limit:g} m at the last moment. None of {n} layouts judged locates"
                " more; that is not proven of all.",
                **values,
            )
        ]
    return [
        tr(
            "With aims known to 1 degree, {share} of the runs are located within"
            " {limit:g} m at the last moment; {before} by the layout that keeps most"
            " when a sensor fails. It is the best of {n} layouts judged; that is not"
            " proven of all.",
            **values,
        )
    ]


def words(record: DecisionRecord) -> list[str]:
    """What the decision makes of the first layout."""
    first = record.layouts[0]
    sentences = [
        tr(
            "Detected in time are {detected} of the runs. A car that braked for whoever"
            " is detected would brake for {twins} of the people who stop before its way"
            " or walk beside it.",
            detected=percent(first.detected),
            twins=percent(first.twins_detected),
        )
    ]
    for aimed, one in first.by_aim.items():
        sentences.append(
            tr(
                "A car that brakes from a probability of {threshold:g} on avoids"
                " {avoided} with aims known to {aim:g} degrees ({aimed}), and brakes"
                " for {braked} of these people.",
                threshold=record.rule["threshold"],
                avoided=percent(one.avoided),
                aim=one.pitch_sd_deg,
                aimed=tr(_AIM_WORDS[aimed]),
                braked=percent(one.braked_for),
            )
        )
    return sentences


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
                    tr("{aim:g} degrees", aim=one.pitch_sd_deg),
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
            "avoided, braked for: by the rule, with a reserve of {reserve:g} s and from"
            " a probability of {threshold:g} on; at most ..: avoided by the best rule"
            " that brakes for so many of the twins; within ..: runs whose impact is"
            " located so well at the last moment.",
            reserve=record.rule["reserve_s"],
            threshold=record.rule["threshold"],
        )
    ]


def plot_decisions(layouts: Sequence[LayoutDecision]) -> Axes:
    """Runs avoided against twins braked for, over the threshold, per layout."""
    axes = new_axes(WIDTH_IN, 4.2)
    for number, layout in enumerate(layouts):
        colour = UNIT_COLOURS[number % len(UNIT_COLOURS)]
        for aimed, one in layout.by_aim.items():
            braked, avoided = 100.0 * np.array(one.curve).T
            name = literal(f"{layout_words(layout.name)}, {tr(_AIM_WORDS[aimed])}")
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
                marker=_MARKERS[number % len(_MARKERS)],
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


def section(record: DecisionRecord | None) -> Section | None:
    """Words, table and figure; None where nothing was asked."""
    if record is None:
        return None
    picture = build_picture(
        plot_decisions(record.layouts),
        title=tr("Avoided against false braking"),
        caption=tr(
            "Each line has all thresholds of one layout; marks are at the rule's own."
            " Up and to the left is better."
        ),
        alt=tr("Runs avoided against twins braked for, a line for each layout."),
    )
    how = tr(
        "A detection is not a decision: people stand at kerbs, stop and walk beside the"
        " road. Here the car brakes if the reported position and motion say that paths"
        " cross. Twins are the same encounters without a collision: whoever would cross"
        " stops a metre before the car's way, whoever walks along it walks aside."
        " Tracks are those of a Kalman filter of constant velocity; errors of"
        " positions, aims and the car's own place are drawn."
    )
    return Section(
        "decision",
        tr("From detection to decision"),
        [how, *words(record), table(record), *notes(record), picture],
    )
