"""Judge layouts by a decision rule: the records of :mod:`experiments.parts.decision`.

Loaded by name, where ``--decision`` asks for it: nothing else needs the filter.
"""

import math
from collections.abc import Mapping

import numpy as np

from geometry.sensors import CameraModel
from placement.compute import Compute
from placement.decisions import Decided, LayoutDecisions, judge_decisions
from placement.detectors.evidence import Interval
from placement.detectors.fitting import wilson
from placement.evaluation import Evaluation
from placement.setting import Setting
from scenarios.decision import DecisionRule, load_decision_rule, rule_values

from .decision import (
    LIMITS,
    LOCATED_M,
    ONE_UNIT,
    AimedDecision,
    BestRule,
    DecisionRecord,
    LayoutDecision,
)

_N_THRESHOLDS = 51


def judge_by_decision(
    name_or_path: str,
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    compute: Compute,
) -> DecisionRecord:
    """Judge evaluations, by display name, by a rule.

    Raises InputError if the rule cannot be read or used.
    """
    rule = load_decision_rule(name_or_path)
    decisions = judge_decisions([*evaluations.values()], setting, rule, compute=compute)
    # By one unit, and by as many as a layout has.
    by_unit = false_brakings_per_hour(setting.detector, rule)
    false_brakings = {}
    if by_unit is not None:
        false_brakings[ONE_UNIT] = by_unit
        for name, one in evaluations.items():
            sensors = [unit.sensor for unit in one.layout.units]
            # Of LiDARs' tracks of nothing no rate is known.
            if all(isinstance(sensor, CameraModel) for sensor in sensors):
                false_brakings[name] = by_unit.times(len(sensors))
    return DecisionRecord(
        false_brakings_per_hour={
            name: (one.value, one.low, one.high) for name, one in false_brakings.items()
        },
        rule=rule_values(rule),
        layouts=tuple(
            build_layout(name, one, rule.reserve_s, rule.threshold)
            for name, one in zip(evaluations, decisions, strict=True)
        ),
    )


def false_brakings_per_hour(detector: object, rule: DecisionRule) -> Interval | None:
    """How often a car brakes for nothing that one unit reports, in an hour.

    Rate of the detector's tracks of nothing times the share that the decision let
    through on recordings; ends of the interval are products of ends, so that it holds
    with more than 95 %. None where the detector's rate is unknown.
    """
    rate = getattr(detector, "false_tracks_per_hour", None)
    if rate is None:
        return None
    share = wilson(rule.false_tracks_braked_for, rule.false_tracks)
    return Interval(
        rate.value * share.value, rate.low * share.low, rate.high * share.high
    )


def build_layout(
    name: str, decisions: LayoutDecisions, reserve_s: float, threshold: float
) -> LayoutDecision:
    """What a record has of a layout, by a rule of this reserve and threshold."""
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
    yaw_deg, pitch_deg = decided.aim_sd_deg
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
