"""The report: one HTML page with the answer, its proof and every run.

It loads nothing from elsewhere.
"""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined, Template

from geometry.writing import write_atomically
from placement.evaluation import Evaluation
from placement.layout import Layout
from placement.setting import Setting

from ..figures.axes import unit_labels
from ..language import language, mark, tr, trn
from ..parts import (
    added,
    answer,
    comparison,
    dangers,
    decision,
    proof,
    road_users,
    study_cases,
)
from ..parts.accidents import (
    accidents_section,
    cases_section,
    runs_section,
    unit_apr_table,
)
from ..parts.alternatives import failures_section
from ..parts.assumptions import again_section, assumption_sentences, assumptions_section
from ..parts.bill_of_materials import BillOfMaterials, bill_section, build_bill
from ..parts.camera_views import camera_views
from ..parts.comparison import EXPERT, GREEDY, HIGHEST
from ..parts.explanation import missed_section
from ..parts.first_screen import build_first_screen
from ..parts.player import interactive_part
from ..parts.result import PlacementResult, Result
from ..parts.sampled_worlds import sampled_section
from ..parts.section import Picture, Section
from ..parts.units import build_plans, private_ground_section, units_section

FILE_NAME = "report.html"
# What to mount where, what it adds to today's cars, what if a unit fails, what it
# costs, who remains at risk; and what has to be asked for.
_IN_SIGHT = (
    *("units", "added", "failures", "bill", "accidents", "dangers"),
    *("decision", "sampled", "private-ground"),
)
_FOLDED = (
    *("proof", "comparison", "models", "study-cases", "missed"),
    *("road-users", "alone", "assumptions", "cases", "runs", "again"),
)


@cache
def page_environment() -> Environment:
    """How all pages are made from templates: text of others is shown as text."""
    environment = Environment(
        loader=ChoiceLoader(
            [
                PackageLoader("experiments.report"),
                PackageLoader("experiments.scene", ""),
            ]
        ),
        autoescape=True,
        undefined=StrictUndefined,
        extensions=["jinja2.ext.do"],
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals |= {"tr": tr, "trn": trn, "mark": mark, "language": language}
    return environment


@cache
def page_template() -> Template:
    """The template of all pages.

    Title, answer, sections, details; and what can be played.
    """
    return page_environment().get_template("report.html.j2")


def write_report(
    folder: Path,
    result: Result,
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    **options: Any,
) -> Path:
    """Write the page of :func:`build_report`, and its plan as a file."""
    page, plan = build_report(result, setting, evaluations, **options)
    write_atomically(folder / "plan.png", base64.b64decode(plan.image))
    path = folder / FILE_NAME
    write_atomically(path, page)
    return path


def build_report(
    result: Result,
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    command: str,
    bill: BillOfMaterials | None = None,
    cache_folder: Path | None = None,
) -> tuple[str, Picture]:
    """A result as one HTML page, and its plan.

    The page loads nothing.

    The first evaluation is the subject. `command` makes the result again; `bill` knows
    more of the costs than the scene; pictures are kept in `cache_folder`.
    """
    shown, detailed = _shown(result, evaluations)
    subject = next(iter(evaluations.values()))
    others: list[Layout] = []
    if len(detailed) == 1:
        others = [item.layout for item in [*shown.values()][1:]]
    drawn = {name: item.layout for name, item in detailed.items()}
    plan, *plans = build_plans(
        setting, drawn, others, result.existing, cache_folder=cache_folder
    )
    bill = bill or build_bill(subject.layout, setting.scene)
    labels = unit_labels(subject.layout)
    layouts = {name: item.layout for name, item in shown.items()}
    sections: list[Section | None] = [
        units_section(
            {name: layouts[name] for name in detailed},
            plans,
            setting.scene,
            result.existing,
        ),
        accidents_section(detailed, is_optimised=isinstance(result, PlacementResult)),
        added.section(result.added),
        road_users.section(result.road_users),
        dangers.section(
            setting, shown, fusion=result.fusion, cache_folder=cache_folder
        ),
        study_cases.section(result.study_cases),
        decision.section(result.decision),
        failures_section(subject, setting.rule, labels),
        Section(
            "alone",
            tr("What each unit achieves alone"),
            [unit_apr_table(name, item) for name, item in detailed.items()],
        ),
        private_ground_section(result.private_ground, labels),
        bill_section(bill),
        assumptions_section(result, setting, layouts),
        cases_section(setting),
        runs_section(evaluations),
        again_section(result, command),
        comparison.section(
            evaluations,
            setting.rule,
            result.baselines,
            result.sampled,
            result.existing,
        ),
    ]
    if isinstance(result, PlacementResult):
        sections += [
            missed_section(result.explained),
            proof.section(result),
            proof.agreement_section(result),
        ]
    if result.sampled:
        sections.append(sampled_section(result.sampled))
    page = page_template().render(
        title=answer.title(result, setting, shown),
        first=build_first_screen(
            result,
            setting,
            subject,
            bill=bill,
            plan=plan,
            views=camera_views(setting, subject.layout, cache_folder=cache_folder),
            warnings=answer.warnings(result),
        ),
        answer=answer.words(result),
        assumed=assumption_sentences(result),
        sections=_in_order(sections),
        interactive=interactive_part(setting, shown, cache_folder=cache_folder),
    )
    return page, plan


def _shown(
    result: Result, evaluations: Mapping[str, Evaluation]
) -> tuple[dict[str, Evaluation], dict[str, Evaluation]]:
    """Those that are more than a row of a table or a bar.

    Of these, the ones in detail.
    """
    rows_alone = (GREEDY, EXPERT, HIGHEST)
    shown = {name: item for name, item in evaluations.items() if name not in rows_alone}
    is_comparison = not isinstance(result, PlacementResult) and len(evaluations) > 1
    return shown, shown if is_comparison else dict([next(iter(evaluations.items()))])


def _in_order(sections: Sequence[Section | None]) -> list[Section]:
    """Those that there are.

    First those in sight, then those of which the title alone is.
    """
    found = {section.id: section for section in sections if section is not None}
    return [
        *(found[name] for name in _IN_SIGHT if name in found),
        *(replace(found[name], is_folded=True) for name in _FOLDED if name in found),
    ]
