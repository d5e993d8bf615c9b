"""How well layouts locate road users, with aims that are calibrated or set by eye.

Loaded by name, once layouts are evaluated: the first lines of an answer do not wait for
it.
"""

from collections.abc import Mapping

from geometry.registry import load_entry
from placement.cache import cached_value
from placement.compute import Compute
from placement.decisions import AIMS, find_located_shares, impact_heading_rad
from placement.evaluation import Evaluation
from placement.located_choice import LocatedChoice
from placement.positions import aim_sd_deg, box_noise_of, build_feet
from placement.setting import Setting
from scenarios.decision import load_decision_rule

from ..language import tr
from ..results.numbers import layout_words, percent
from .comparison import EXPERT, GREEDY, HIGHEST
from .decision import AimsRecord, DecisionRecord, LocatedRecord

LIMIT_M = 0.4
"""What every answer calls located, as one standard deviation. [m]"""
_CALIBRATE = 0.05
"""From this loss on, the sentence begins with what there is to do. [share]"""


def judge_aims(
    setting: Setting, evaluations: Mapping[str, Evaluation], *, compute: Compute
) -> AimsRecord | None:
    """Located APR of evaluations, by display name, for each way of aiming.

    None where a share of the cars sees: they know more than those that do not. Raises
    InputError where a detector's box noise is no number between 0 and 1.
    """
    if 0.0 < setting.cars < 1.0:
        return None
    # Layouts for comparison alone are left out: each costs as much as the first one.
    names = [name for name in evaluations if name not in (GREEDY, EXPERT, HIGHEST)]
    found = [evaluations[name] for name in names]
    detected = [
        [one.vut.detected, *(unit.detected for unit in one.units.values())]
        for one in found
    ]
    rule = load_decision_rule()
    feet = build_feet(setting.runs)
    shares = cached_value(
        compute.cache_folder,
        "located",
        lambda: find_located_shares(found, setting, limit_m=LIMIT_M),
        kind=tuple[tuple[float, ...], ...],
        made_from=(
            [one.layout.units for one in found],
            detected,
            # All of the runs that decides; to hash the runs themselves takes long.
            feet.foot_m,
            feet.size_m,
            impact_heading_rad(setting.runs),
            # The car's own camera counts where cars see.
            [run.vut_position_m for run in setting.runs],
            [run.vut_yaw_deg for run in setting.runs],
            setting.axis,
            setting.rule,
            setting.cars,
            box_noise_of(setting.detector, rule),
            LIMIT_M,
        ),
    )
    return AimsRecord(
        limit_m=LIMIT_M,
        tilt_sd_deg=tuple(aim_sd_deg(aimed)[1] for aimed in AIMS),
        layouts=tuple(
            LocatedRecord(name=name, located=row)
            for name, row in zip(names, shares, strict=True)
        ),
    )


def judge_aims_and_decision(
    name_or_path: str,
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    compute: Compute,
) -> dict[str, AimsRecord | DecisionRecord | None]:
    """See :func:`experiments.parts.decision.judge_by_decision`."""
    aims = judge_aims(setting, evaluations, compute=compute)
    parts: dict[str, AimsRecord | DecisionRecord | None] = {"aims": aims}
    if name_or_path:
        judge = load_entry("experiments.parts.decision_judging:judge_by_decision")
        parts["decision"] = judge(name_or_path, setting, evaluations, compute=compute)
    return parts


def words(
    aims: AimsRecord | None, choice: LocatedChoice | None, *, baseline: str = ""
) -> list[str]:
    """What the aims decide, and how a layout was chosen that locates.

    `baseline` is the name of the study's layout, where it is told beside the first one.
    """
    found = []
    if aims is not None:
        found.append(_aims_sentence(aims, baseline))
    if choice is not None:
        found.append(_choice_sentence(choice))
    return found


def _aims_sentence(aims: AimsRecord, baseline: str) -> str:
    known, by_eye = aims.layouts[0].located
    by_name = {one.name: one.located for one in aims.layouts[1:]}
    values = {
        "limit": aims.limit_m,
        "known": percent(known),
        "by_eye": percent(by_eye),
        "small": aims.tilt_sd_deg[0],
        "large": aims.tilt_sd_deg[1],
        "beside": "",
    }
    if baseline in by_name:
        values["beside"] = tr(
            "; {name} in {known} and {by_eye}",
            name=layout_words(baseline),
            known=percent(by_name[baseline][0]),
            by_eye=percent(by_name[baseline][1]),
        )
    if known - by_eye < _CALIBRATE:
        return tr(
            "With aims known to {small:g}°, cars locate the impact within {limit:g} "
            "m at the last moment in {known} of the runs; with aims known to "
            "{large:g}°, in {by_eye}{beside}.",
            **values,
        )
    return tr(
        "Calibrate the aims: with aims known to {small:g}°, cars locate the "
        "impact within {limit:g} m at the last moment in {known} of the runs; "
        "with aims known to {large:g}°, only in {by_eye}{beside}.",
        **values,
    )


def _choice_sentence(choice: LocatedChoice) -> str:
    """How many runs the chosen layout locates, and of how many layouts it is best."""
    values = {
        "limit": choice.limit_m,
        "share": percent(choice.share),
        "before": percent(choice.share_before),
        "n": choice.n_judged,
    }
    if choice.share <= choice.share_before:
        return tr(
            "With aims known to 1 degree, the impact is located within {limit:g} m "
            "at the last moment in {share} of the runs. None of the {n} layouts "
            "evaluated locates more; this is not proven for all layouts.",
            **values,
        )
    return tr(
        "With aims known to 1 degree, the impact is located within {limit:g} m "
        "at the last moment in {share} of the runs; the layout that keeps most "
        "when a sensor fails reaches {before}. This layout is the best of the "
        "{n} evaluated; this is not proven for all layouts.",
        **values,
    )
