"""The report: one self-contained HTML page with the answer, its proof, figures, and every run."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from geometry.errors import InputError, Unquoted
from geometry.files import write_atomically
from placement.evaluation import Evaluation
from placement.setting import Setting

from ..figures.axes import unit_labels
from ..figures.evaluation import heatmap_indices
from ..parts.coverage import coverage_section
from ..parts.explanation import explanation_sections
from ..parts.front import front_section
from ..parts.margins import margins_section
from ..parts.player import interactive_part
from ..parts.private_ground import private_ground_section
from ..parts.sampled_worlds import sampled_picture, sampled_section
from ..parts.section import Picture, Section
from ..parts.sensitivity import sensitivity_section
from ..results.result import Result
from .accidents import accidents_section, alone_section, apr_picture
from .answer import answer, models_section, proof_section, title
from .assumptions import again_section, assumption_sentences, assumptions_section
from .beside import Beside, Part
from .bill_of_materials import BillOfMaterials, bill_section, build_bill
from .comparison import EXPERT, GREEDY, comparison_section, study_cases_section
from .failures import failures_section
from .next_unit import next_unit_section
from .positions import positions_section
from .runs import build_heatmaps, cases_section, heatmaps_section, runs_section
from .units import build_plans, units_section

FILE_NAME = "report.html"


def write_report(
    folder: Path,
    result: Result,
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    command: str,
    heatmap_runs: Sequence[str] = (),
    sampled_figure: Axes | Figure | None = None,
    bill: BillOfMaterials | None = None,
    beside: Beside | None = None,
) -> Path:
    """Write :func:`render_report`'s page to ``report.html`` in `folder`, which must exist.

    The plan, the APR by case, the heatmaps of the first layout and the APR in sampled worlds are
    written beside it as PNG files.
    """
    page, pictures = _build_report(
        result,
        setting,
        evaluations,
        command=command,
        heatmap_runs=heatmap_runs,
        sampled_figure=sampled_figure,
        bill=bill,
        beside=beside,
    )
    for name, picture in pictures.items():
        write_atomically(folder / f"{name}.png", base64.b64decode(picture.png))
    path = folder / FILE_NAME
    write_atomically(path, page)
    return path


def render_report(
    result: Result,
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    command: str,
    heatmap_runs: Sequence[str] = (),
    sampled_figure: Axes | Figure | None = None,
    bill: BillOfMaterials | None = None,
) -> str:
    """A result as one HTML page that loads nothing from elsewhere.

    Parameters
    ----------
    result : Result
        With stages: an optimised layout; without: one layout evaluated, or several compared.
    setting : Setting
        What the layouts were evaluated in.
    evaluations : mapping of str to Evaluation
        By display name; the first one is the subject. One named "greedy" appears in tables and
        bars only.
    command : str
        Command line that makes the result again.
    heatmap_runs : sequence of str
        Ids of the runs to draw; else see :func:`experiments.figures.evaluation.pick_heatmap_runs`.
    sampled_figure : Axes or Figure, optional
        Of the APR in sampled worlds, where they were asked for.
    bill : BillOfMaterials, optional
        What the first layout takes, where more is known of its costs than the scene tells.

    Returns
    -------
    page : str
        HTML.

    Raises
    ------
    InputError
        There is no evaluation, or a run is unknown.
    """
    page, _ = _build_report(
        result,
        setting,
        evaluations,
        command=command,
        heatmap_runs=heatmap_runs,
        sampled_figure=sampled_figure,
        bill=bill,
    )
    return page


def _build_report(
    result: Result,
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    command: str,
    heatmap_runs: Sequence[str],
    sampled_figure: Axes | Figure | None,
    bill: BillOfMaterials | None,
    beside: Beside | None = None,
) -> tuple[str, dict[str, Picture]]:
    """The page, and those of its pictures that are worth a file, by name."""
    beside = beside or Beside()
    parts = begin_parts(beside, result, setting, evaluations, heatmap_runs=heatmap_runs)
    subject_name, subject = next(iter(evaluations.items()))
    shown, detailed = _shown(result, evaluations)
    layouts = {name: item.layout for name, item in detailed.items()}
    labels = unit_labels(subject.layout)
    run_ids = parts.run_ids
    interactive = interactive_part(setting, shown, first_runs=run_ids)
    for part in reversed(parts.in_order):
        part.take()
    heatmaps, plans, of_apr = parts.heatmaps.result(), parts.plans.result(), parts.apr.result()
    sampled = None
    if result.sampled and sampled_figure is not None:
        sampled = sampled_picture(result.sampled, sampled_figure)
    pictures = {"plan": plans[0], "apr_by_case": of_apr}
    for run_id, picture in zip(run_ids, heatmaps[subject_name], strict=True):
        pictures[f"heatmap_{run_id.replace('/', '_')}"] = picture
    if sampled is not None:
        pictures["sampled_apr"] = sampled

    sections = [
        units_section(layouts, plans, setting.scene),
        proof_section(result),
        parts.front.result(),
        next_unit_section(result),
        *explanation_sections(result.explained, labels),
        accidents_section(evaluations, of_apr, is_optimised=bool(result.stages)),
        parts.dangers.result(),
        comparison_section(result, evaluations),
        study_cases_section(result.study_cases),
        parts.margins.result(),
        failures_section(subject, setting.rule, labels),
        None if sampled is None else sampled_section(sampled),
        parts.what_if.result(),
        alone_section(detailed),
        parts.coverage.result(),
        heatmaps_section(heatmaps, setting.rule, [*layouts.values()]),
        models_section(result),
    ]
    details = [
        private_ground_section(result.private_ground, labels),
        bill_section(bill or build_bill(subject.layout, setting.scene)),
        assumptions_section(result, setting, {name: item.layout for name, item in shown.items()}),
        cases_section(setting),
        runs_section(evaluations),
        again_section(result, command),
    ]
    page = page_template().render(
        title=title(result, setting, shown),
        answer=answer(result, shown),
        assumed=assumption_sentences(result),
        sections=_present(sections),
        interactive=interactive,
        details=_present(details),
    )
    return page, pictures


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """What a second process may make of a report."""

    run_ids: list[str]  # of the heatmaps
    plans: Part[list[Picture]]
    heatmaps: Part[dict[str, list[Picture]]]
    dangers: Part[Section | None]
    margins: Part[Section | None]
    what_if: Part[Section | None]
    apr: Part[Picture]
    coverage: Part[Section | None]
    front: Part[Section | None]

    @property
    def in_order(self) -> list[Part[Any]]:
        """As they were begun."""
        return [getattr(self, field.name) for field in fields(self) if field.name != "run_ids"]


def begin_parts(
    beside: Beside,
    result: Result,
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    heatmap_runs: Sequence[str] = (),
) -> Parts:
    """Begin what takes long to draw; once begun, the report that is written takes it from there.

    Arguments as for :func:`render_report`.
    """
    if not evaluations:
        raise InputError("evaluations", Unquoted("none"), "at least one")
    subject = next(iter(evaluations.values()))
    shown, detailed = _shown(result, evaluations)
    layouts = {name: item.layout for name, item in detailed.items()}
    others = [item.layout for item in [*shown.values()][1:]] if len(detailed) == 1 else []
    run_indices = heatmap_indices(subject, setting, heatmap_runs)
    return Parts(  # what takes the longest comes first
        run_ids=[subject.axis.run_ids[index] for index in run_indices],
        plans=beside.begin("plans", build_plans, setting, layouts, others),
        heatmaps=beside.begin("heatmaps", build_heatmaps, detailed, run_indices),
        dangers=beside.begin("dangers", positions_section, setting, shown, fusion=result.fusion),
        margins=beside.begin("margins", margins_section, shown),
        what_if=beside.begin("sensitivity", sensitivity_section, result.sensitivity),
        apr=beside.begin("apr", apr_picture, evaluations),
        coverage=beside.begin("coverage", coverage_section, setting.scene, subject.layout),
        front=beside.begin("front", front_section, result.front),
    )


def _shown(
    result: Result, evaluations: Mapping[str, Evaluation]
) -> tuple[dict[str, Evaluation], dict[str, Evaluation]]:
    """Those that are more than a row of a table or a bar; of these, those told of in detail."""
    shown = {name: item for name, item in evaluations.items() if name not in (GREEDY, EXPERT)}
    is_comparison = not result.stages and len(evaluations) > 1
    return shown, shown if is_comparison else dict([next(iter(evaluations.items()))])


def _present(sections: Sequence[Section | None]) -> list[Section]:
    return [section for section in sections if section is not None]


@cache
def page_environment() -> Environment:
    """How all pages are made from templates: text of others is shown as text."""
    return Environment(
        loader=PackageLoader("experiments.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


@cache
def page_template() -> Template:
    """The template of all pages: title, answer, sections, details; and what can be played."""
    return page_environment().get_template("report.html.j2")
