"""One self-contained HTML page: the answer, its proof, figures, and every run."""

import base64
import math
from collections.abc import Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from geometry.errors import InputError, Unquoted
from geometry.files import write_atomically
from placement.evaluation import Evaluation
from placement.ground_coverage import find_ground_coverage
from placement.layout import Layout
from placement.setting import Setting

from ..cli.tables import added_sentences
from ..figures.axes import NARROW_IN, WIDTH_IN, describe_run, unit_labels
from ..figures.evaluation import heatmap_indices, plot_apr_by_case, plot_heatmap, units_in_heatmap
from ..figures.plan import plot_plan
from ..figures.sensors import looking_words
from ..results.numbers import NOTHING, number
from .answer import (
    answer,
    assumptions,
    describe_hopeless,
    describe_refusals,
    disagreement,
    is_weighted,
    latency_in_short,
    proof,
    title,
)
from .bill_of_materials import BillOfMaterials, bill_part, build_bill
from .comparison import comparison_part
from .coverage import coverage_rows, coverage_sentence, plot_coverage
from .explanation import report_part
from .failures import failures_part
from .front import front_part
from .interactive.part import interactive_part
from .margins import margins_part
from .pictures import Picture, build_picture
from .private_ground import private_ground_part
from .sampled_worlds import MAX_STAIRCASES, uncertainty_sentences, what_is_uncertain
from .sensitivity import sensitivity_part
from .tables import (
    apr_group_tables,
    apr_table,
    case_table,
    disagreement_rows,
    run_table,
    stage_rows,
    unit_apr_table,
    unit_table,
)

FILE_NAME = "report.html"
GREEDY = "greedy"
_PLAN_RANGE_M = 35.0
_MAX_UNITS_IN_WORDS = 40
_MAX_NARROW_UNITS = 6  # labels of more would lie on one another


def write_report(
    folder: Path,
    summary: Mapping[str, Any],
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    command: str,
    heatmap_runs: Sequence[str] = (),
    sampled_figure: Axes | Figure | None = None,
    bill: BillOfMaterials | None = None,
) -> Path:
    """Write :func:`render_report`'s page to ``report.html`` in `folder`, which must exist.

    The plan, the APR by case, the heatmaps of the first layout and the APR in sampled worlds are
    written beside it as PNG files.
    """
    page, pictures = _build_report(
        summary,
        setting,
        evaluations,
        command=command,
        heatmap_runs=heatmap_runs,
        sampled_figure=sampled_figure,
        bill=bill,
    )
    for name, picture in pictures.items():
        (folder / f"{name}.png").write_bytes(base64.b64decode(picture.png))
    path = folder / FILE_NAME
    write_atomically(path, lambda file: file.write(page.encode()))
    return path


def render_report(
    summary: Mapping[str, Any],
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
    summary : mapping
        As :mod:`..summary` builds it. With "stages": an optimised layout; without: one
        layout evaluated, or several compared.
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
        summary,
        setting,
        evaluations,
        command=command,
        heatmap_runs=heatmap_runs,
        sampled_figure=sampled_figure,
        bill=bill,
    )
    return page


def _build_report(
    summary: Mapping[str, Any],
    setting: Setting,
    evaluations: Mapping[str, Evaluation],
    *,
    command: str,
    heatmap_runs: Sequence[str],
    sampled_figure: Axes | Figure | None,
    bill: BillOfMaterials | None,
) -> tuple[str, dict[str, Picture]]:
    """The page, and those of its pictures that are worth a file, by name."""
    if not evaluations:
        raise InputError("evaluations", Unquoted("none"), "at least one")
    subject_name, subject = next(iter(evaluations.items()))
    shown = {name: item for name, item in evaluations.items() if name != GREEDY}
    is_comparison = "stages" not in summary and len(evaluations) > 1
    labels = unit_labels(subject.layout)
    detailed = shown if is_comparison else {subject_name: subject}
    run_indices = heatmap_indices(subject, setting, heatmap_runs)
    plans = _plans(setting, detailed, [] if is_comparison else [*shown.values()][1:])
    apr_picture, sampled = _apr_figure(evaluations), _sampled_figure(sampled_figure, summary)
    heatmaps: list[dict[str, Any]] = [
        {"name": name, "figures": [_heatmap(item, index) for index in run_indices]}
        for name, item in detailed.items()
    ]
    pictures = {"plan": plans[0], "apr_by_case": apr_picture}
    for run_index, picture in zip(run_indices, heatmaps[0]["figures"], strict=True):
        pictures[f"heatmap_{subject.axis.run_ids[run_index].replace('/', '_')}"] = picture
    if sampled is not None:
        pictures["sampled_apr"] = sampled
    page = _template().render(
        title=title(summary, setting, evaluations),
        answer=[*answer(summary, shown), *added_sentences(summary)],
        layouts=[unit_table(name, item.layout) for name, item in detailed.items()],
        plans=plans,
        proof=proof(summary),
        stages=stage_rows(summary),
        solver=summary.get("solver", NOTHING),
        front=front_part(summary.get("front")),
        comparison=comparison_part(summary, evaluations),
        sensitivity=sensitivity_part(summary.get("sensitivity")),
        explained=report_part(summary.get("explained"), labels),
        is_weighted=is_weighted(subject.axis),
        apr_table=apr_table(evaluations),
        apr_figure=apr_picture,
        apr_groups=apr_group_tables(evaluations),
        margins=margins_part(shown),
        failures=failures_part(subject, setting.rule, labels),
        private_ground=private_ground_part(summary.get("private_ground"), labels),
        bill=bill_part(bill or build_bill(subject.layout, setting.scene)),
        sampled_figure=sampled,
        ground=_ground(setting, subject),
        interactive=interactive_part(
            setting, shown, first_runs=[subject.axis.run_ids[index] for index in run_indices]
        ),
        alone=[unit_apr_table(name, item) for name, item in detailed.items()],
        heatmaps=heatmaps,
        rule=setting.rule,
        latency=latency_in_short(setting.rule, [item.layout for item in detailed.values()]),
        disagreement=disagreement(summary),
        disagreements=disagreement_rows(summary),
        assumptions=assumptions(
            summary, setting, {name: item.layout for name, item in shown.items()}
        ),
        cases=case_table(setting),
        hopeless=describe_hopeless(setting),
        not_driven=describe_refusals(setting),
        run_table=run_table(evaluations),
        n_hit=int((~subject.rsu_all.is_avoided).sum()),
        command=command,
        seconds=[(stage, f"{value:.1f}") for stage, value in summary.get("seconds", {}).items()],
        versions=list(summary.get("versions", {}).items()),
    )
    return page, pictures


@cache
def _template() -> Template:
    environment = Environment(
        loader=PackageLoader("experiments.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html.j2")


# ---------------------------------------------------------------- figures


def _plans(
    setting: Setting, detailed: Mapping[str, Evaluation], others: Sequence[Evaluation]
) -> list[Picture]:
    draw = partial(
        plot_plan,
        setting,
        others=[other.layout for other in others],
        max_range_m=_PLAN_RANGE_M,
    )
    are_few = all(len(item.layout.units) <= _MAX_NARROW_UNITS for item in detailed.values())
    are_side_by_side = len(detailed) > 1 and are_few
    return [
        build_picture(
            draw(item.layout, width_in=NARROW_IN if are_side_by_side else WIDTH_IN),
            narrow=draw(item.layout, width_in=NARROW_IN)
            if are_few and not are_side_by_side
            else None,
            title=f"Plan of {setting.scene.name} with {name}",
            caption=(
                "Coloured outlines: the ground in each sensor's field of view, up to "
                f"{_PLAN_RANGE_M:g} m; they see farther. Walls and parked cars hide parts "
                "of it, which is taken into account in the numbers but not drawn here."
            ),
            alt="Plan of the junction, north up. " + _units_in_words(item.layout),
        )
        for name, item in detailed.items()
    ]


def _units_in_words(layout: Layout) -> str:
    if len(layout.units) > _MAX_UNITS_IN_WORDS:
        return f"{len(layout.units)} units: where each is says the table above."
    labels = unit_labels(layout)
    return " ".join(
        f"{labels[unit.id]} at {number(unit.pose.position_m[0], 1)} m east, "
        f"{number(unit.pose.position_m[1], 1)} m north, {looking_words(unit)}."
        for unit in layout.units
    )


def _apr_figure(evaluations: Mapping[str, Evaluation]) -> Picture:
    table = apr_table(evaluations)
    # The table's first columns: every layout, the car alone, the car with the subject.
    n_drawn = len(evaluations) + 2
    over_all = [*zip(table["columns"][1:], table["rows"][0][1:], strict=True)][:n_drawn]
    return build_picture(
        plot_apr_by_case(evaluations),
        title="Accident prevention ratio by case",
        caption="Numbers from the table above.",
        alt="Shaded table. Over all runs: "
        + "; ".join(f"{name} {share}" for name, share in over_all)
        + ".",
    )


def _ground(setting: Setting, subject: Evaluation) -> dict[str, Any]:
    """What cameras see of the roads: a sentence, a table, a map."""
    coverage = find_ground_coverage(setting.scene, subject.layout.units)
    sentence, rows = coverage_sentence(coverage), coverage_rows(coverage.shares())
    return {
        "sentence": sentence,
        "rows": rows,
        "figure": build_picture(
            plot_coverage(coverage, setting.scene, subject.layout),
            title="Pixel density on the road",
            caption="Of the camera that sees a place most finely, one metre above the road; "
            "nothing parks or drives. Bands of EN IEC 62676-4. Triangles: cameras.",
            alt=f"Map of the roads by pixel density. {sentence} "
            + "; ".join(f"{name}: {share}" for name, _, share in rows)
            + ".",
        ),
    }


def _sampled_figure(figure: Axes | Figure | None, summary: Mapping[str, Any]) -> Picture | None:
    if figure is None:
        return None
    kind = "Staircases" if len(summary["sampled"]["layouts"]) <= MAX_STAIRCASES else "Intervals"
    return build_picture(
        figure,
        title="APR in sampled worlds",
        caption="Worlds that were not used for the choice. Drawn at random: "
        f"{what_is_uncertain(summary['sampled'])}.",
        alt=f"{kind}. {' '.join(uncertainty_sentences(summary['sampled']))}",
    )


def _heatmap(evaluation: Evaluation, run_index: int) -> Picture:
    axis, labels = evaluation.axis, unit_labels(evaluation.layout)
    rows = {
        "the VUT": evaluation.vut,
        **{
            labels[unit_id]: evaluation.units[unit_id]
            for unit_id in units_in_heatmap(evaluation, [run_index])
        },
        "all RSUs": evaluation.rsu_all,
    }
    run = describe_run(axis, run_index)
    last_moment = number(axis.last_brake_time_s[run_index])
    confirmed = [
        f"{name} at {number(verdict.confirmation_time_s[run_index], 1)} s"
        if math.isfinite(verdict.confirmation_time_s[run_index])
        else f"{name} never"
        for name, verdict in rows.items()
    ]
    return build_picture(
        plot_heatmap(evaluation, run_index, width_in=NARROW_IN),  # several stand side by side
        title=run,
        caption=f"Detections in each frame; the last moment to brake is at {last_moment} s.",
        alt=f"Heatmap of {run}. Last moment to brake {last_moment} s. Confirmed by: "
        + ", ".join(confirmed)
        + ".",
    )
