"""Layouts by the decision to brake, next to their APR by detection."""

from collections.abc import Mapping
from typing import Annotated

from geometry.registry import load_entry
from placement.compute import Compute
from placement.evaluation import Evaluation
from placement.located_choice import LocatedChoice
from placement.setting import Setting

from ..language import tr
from ..results.numbers import percent
from ..results.record import Record, Share, says
from . import Part
from .section import Section

LIMITS = (0.05, 0.10, 0.25)
"""Shares of the twins that a rule may brake for, where the best one is sought."""
LOCATED_M = (0.35, 0.40)


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
    judge = load_entry("experiments.parts.decision_judging:judge_by_decision")
    record: DecisionRecord = judge(name_or_path, setting, evaluations, compute=compute)
    return record


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


def part(record: DecisionRecord | None) -> Part:
    """Words and table for a terminal; an empty part where nothing was asked."""
    if record is None:
        return Part()
    build = load_entry("experiments.parts.decision_section:build_part")
    found: Part = build(record)
    return found


def section(record: DecisionRecord | None) -> Section | None:
    """Words, table and figure; None where nothing was asked."""
    if record is None:
        return None
    build = load_entry("experiments.parts.decision_section:build_section")
    found: Section = build(record)
    return found
