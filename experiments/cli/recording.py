"""Answers from recorded detections, for commands that are given ``--recording``."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..language import tr
from ..parts import Part
from ..results.numbers import percent
from . import options
from .running import QuestionCall
from .terminal import answer_text, sentences, wide_table

if TYPE_CHECKING:
    from ..parts.recording import DetectedShareRecord, RecordedAprRecord, RecordedResult

_WITH_RECORDING = frozenset(
    ("recording", "min_confidence", "out", "sign", "as_json", "quiet")
    + ("question", "save_question_to")
    + ("budget", "fusion", "solver", "time_limit_s", "gap")
    + (
        "deceleration_mps2",
        "build_up_s",
        "latency_s",
        "latency_budget",
        "n_confirmations",
    )
    + ("track_memory_s",)
)


def evaluate_recording(job: QuestionCall, *, out: Path | None, **asked: Any) -> None:
    """Judge the units of a recording, and end the command.

    See :func:`.recording.run_recording`.

    Options that say nothing next to a recording are refused, by click.UsageError.
    """
    for param in click.get_current_context().command.params:
        if param.name not in _WITH_RECORDING and options.is_given(str(param.name)):
            raise click.UsageError(
                f"{options.option_name(param)}: got it beside --recording; expected one"
                " of them: a recording has units and drives of its own"
            )
    job.start()
    from ..parts.recording import run_recording

    summary = run_recording(job.question, out=out, progress=job.progress, **asked)
    job.print(summary, lambda: recording_text(summary, out))


def recording_text(summary: "RecordedResult", out: Path | None) -> str:
    """The result of a recording for a terminal.

    The units that were chosen, if any, and all.
    """
    from ..parts.proof import stage_conditions, stage_table
    from ..parts.recording import ALL_UNITS

    lines = sentences(
        tr("{recording} on {n} drives:", recording=summary.recording, n=summary.runs)
    )
    parties = _parties_text(summary.evaluation, summary.detected_share, summary.cases)
    if summary.stages is not None and summary.baseline is not None:
        chosen = ", ".join(unit.id for unit in summary.layout)
        words = tr(
            "Best {n} of {all} recorded units on {drives} drives (fusion {fusion}):"
            " {chosen}",
            n=len(summary.layout),
            all=summary.candidates,
            drives=summary.runs,
            fusion=tr(summary.fusion),
            chosen=chosen,
        )
        conditions = stage_conditions(summary.stages)
        best = Part(words=[words], table=stage_table(summary.stages), notes=conditions)
        lines = [answer_text([best], is_verbose=True), ""]
        all_units = tr(
            "{fused} of all {n} recorded units: {share} of the accidents prevented.",
            fused=ALL_UNITS,
            n=summary.candidates,
            share=percent(summary.baseline.rsu_all.all),
        )
        parties.append(f"  {all_units}")
    return "\n".join([*lines, *parties, *_footer(summary, out)])


def _parties_text(
    evaluation: "RecordedAprRecord", shares: "DetectedShareRecord", cases: Sequence[str]
) -> list[str]:
    """A row per party.

    Columns: APR over all drives, share of frames, and APR by case.
    """
    from ..parts.recording import ALL_UNITS

    parties = [
        *(
            (name, evaluation.units[name], share)
            for name, share in shares.units.items()
        ),
        (ALL_UNITS, evaluation.rsu_all, shares.rsu_all),
        (tr("car"), evaluation.vut, shares.vut),
        (
            tr("car + {units}", units=ALL_UNITS),
            evaluation.vut_and_rsus,
            shares.vut_and_rsus,
        ),
    ]
    rows = [
        (name, ratios, share) for name, ratios, share in parties if ratios is not None
    ]
    columns = {
        tr("accidents prevented"): [percent(ratios.all) for _, ratios, _ in rows],
        tr("frames detected"): [percent(share) for _, _, share in rows],
    }
    for case in cases:
        columns[case.replace("-", " ")] = [
            percent(ratios.by_case[case]) for _, ratios, _ in rows
        ]
    return wide_table("", [name for name, _, _ in rows], columns)


def _footer(summary: "RecordedResult", out: Path | None) -> list[str]:
    """Lines on what was read, and what was left out and why."""
    frames = summary.frames
    read = tr(
        "Read: {recorded} frames; {drives} drives with {frames} frames, of which"
        " {missing} are missing and count as not detected.",
        recorded=frames.recorded,
        drives=summary.runs,
        frames=frames.in_drives,
        missing=frames.missing_in_drives,
    )
    if frames.several_vrus_in_view:
        read += " " + tr(
            "In {n} frames, a roadside unit has several VRUs of the drive's class in"
            " view: such a frame counts only if every VRU is detected.",
            n=frames.several_vrus_in_view,
        )
    reasons = "; ".join(
        f"{number} {tr(reason)}" for reason, number in summary.skipped.items()
    )
    if reasons:
        skipped = tr("Skipped: {reasons}.", reasons=reasons)
    else:
        skipped = tr("Skipped: nothing.")
    lines = [
        "",
        *sentences(
            read,
            skipped,
            tr(
                "Unit folder 3 is RSU3, car is the VUT's camera. In Eval, cam_index"
                " is a unit's folder; 12 (where no unit has that number) and -1 also"
                " mean car. The last moment follows from speeds and distances alone:"
                " a turning VUT is treated as crossing."
            ),
        ),
    ]
    if out is not None:
        lines += ["", tr("Written to {out}: {files}.", out=out, files="summary.json")]
    return lines
