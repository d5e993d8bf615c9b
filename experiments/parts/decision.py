"""Layouts by the decision to brake, next to their APR by detection."""

from collections.abc import Mapping
from typing import Annotated, Any

from geometry.registry import load_entry
from placement.compute import Compute
from placement.evaluation import Evaluation
from placement.setting import Setting

from ..results.record import Record, Share, says
from . import Part
from .section import Section

LIMITS = (0.05, 0.10, 0.25)
"""Shares of the twins that a rule may brake for, where the best one is sought."""
LOCATED_M = (0.35, 0.40)
ONE_UNIT = "one unit"
"""Key of the false brakings that a single unit causes."""


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


class LocatedRecord(Record, frozen=True, kw_only=True):
    """How well a layout locates road users."""

    name: Annotated[str, says("Display name.")]
    located: Annotated[tuple[Share, ...], says("Of the runs, for each of tilt_sd_deg.")]


class AimsRecord(Record, frozen=True, kw_only=True):
    """Located APR of the layouts, by how well their aims are known."""

    limit_m: Annotated[
        float, says("What counts as located: one standard deviation, in metres.")
    ]
    tilt_sd_deg: Annotated[
        tuple[float, ...], says("Error of the tilt in degrees: calibrated, by eye.")
    ]
    layouts: Annotated[
        tuple[LocatedRecord, ...], says("The layout, and others that were asked about.")
    ]


class DecisionRecord(Record, frozen=True, kw_only=True):
    """Layouts by the decision to brake; only with --decision."""

    rule: Annotated[dict[str, float], says("See scenarios/data/decision.toml.")]
    layouts: Annotated[tuple[LayoutDecision, ...], says("The layouts.")]
    false_brakings_per_hour: Annotated[
        dict[str, tuple[float, ...]],
        says(
            "For tracks of nothing, with a car always near: by one unit, and by layout;"
            " figure and 95 % interval. Empty: unknown of this detector."
        ),
    ]


def judge_by_decision(
    name_or_path: str,
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    compute: Compute,
) -> dict[str, Any]:
    """What aims and decisions do to evaluations, by display name: parts of an answer.

    "decision" is None where no rule is named. Raises InputError if it cannot be read or
    used.
    """
    judge = load_entry("experiments.parts.aims:judge_aims_and_decision")
    return dict(judge(name_or_path, setting, evaluations, compute=compute))


# ---------- words, table, figure
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
